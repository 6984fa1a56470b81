"""Compute the fields reflected to spheres that are too close to the boundary for eq. MS.6, at points on the spheres.

Data that vary too fast for the elements would cause a large error of an energy on the boundary (``boundary_compliance.py``).
Inside the tissue this error decays. So fields are sampled at all points of the elements' edges, and the reflected field w of eq.
MS.5 is projected on the spheres' modes.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.resources import check_time
from solver.axisymmetric.dofs import Interface
from solver.axisymmetric.tissue_field import TissueField
from solver.elements.quadrilateral import compute_dilations
from solver.elements.shape_functions import evaluate_functions, evaluate_pressures
from solver.inclusions.mode_sums import Sampler, Table
from solver.inclusions.vector_modes import DISPLACEMENT_COMPONENTS, build_stack
from solver.multiple_scattering.interior_solution import LIFTED_EDGES, EdgeData, Interior
from solver.multiple_scattering.lockstep import Steps
from solver.multiple_scattering.rings import PLANE_COMPONENTS, SIDE_COMPONENTS, AzimuthalGrid, build_turn_matrices
from solver.multiple_scattering.spheres import ScatteringSphere

INCOMPRESSIBLE_POISSON_RATIO = 0.48  # from this value on the mode of degree 0 is taken from the dilation


@dataclass(frozen=True)
class _SpherePlace:
    """A sphere's q points in the mesh: elements, their functions and pressures there, angle about the probe's axis."""

    element: Ints
    value: Floats
    pressure: Floats
    angle: Floats


@dataclass(frozen=True)
class CloseExchange:
    """Exchange of fields between one boundary and spheres close to it.

    Attributes
    ----------
    interior
        Returns the response inside the tissue for an azimuthal order and a layer, by numbers.
    field
        Locates points in the mesh.
    interface
        How blocks and tissue are tied to each other: bonded or frictionless.
    spheres
        The spheres.
    rounds
        Angles at which fields are sampled.
    """

    interior: Callable[[int, int], Interior]
    field: TissueField
    interface: Interface
    spheres: Sequence[ScatteringSphere]
    rounds: AzimuthalGrid

    def iterate_reflection(
        self, scattered: Sequence[Floats], min_work: float, max_orders: int
    ) -> Steps[tuple[list[Floats], int]]:
        """Reflect fields; parameters and what is returned are those of ``Exchange.iterate_reflection``."""
        samples, negligible_orders = [self._sample_edges(layer, scattered) for layer in self._layers], 0
        total = [np.zeros_like(c) for c in scattered]
        for m in range(min(max_orders, self.rounds.orders)):
            check_time("reflections")
            loads = [
                self.interior(m, layer).compute_loads(self._compute_amplitudes(values, m, layer))
                for layer, values in zip(self._layers, samples, strict=True)
            ]
            imposed, forces = (functools.reduce(operator.add, part) for part in zip(*loads, strict=True))
            interior = self.interior(m, self._layers[0])
            v = yield interior.harmonic, forces
            displacement = interior.compute_values(v, imposed, self._elements)
            work = np.zeros((scattered[0].shape[1],) * 2)
            for k, (sphere, c, place) in enumerate(zip(self.spheres, scattered, self._places, strict=True)):
                returned = sphere.compute_coefficients(*self._evaluate_returned(sphere, place, m, displacement))
                total[k] += returned
                work += (c * (sphere.two_mu * sphere.radius * sphere.modes.work)[:, None]).T @ returned
            negligible_orders = negligible_orders + 1 if np.abs(work).max() < min_work else 0
            if negligible_orders == 2:  # two in a row, as a single order may be small by chance
                break
        return total, m + 1

    @cached_property
    def _layers(self) -> list[int]:
        """Numbers of the layers with spheres."""
        return sorted({sphere.layer for sphere in self.spheres})

    def _sample_edges(self, layer: int, scattered: Sequence[Floats]) -> dict[tuple[str, str], Floats]:
        """Sample the fields of a layer's spheres on the layer's edges, (angles, 3, k, points) each, by edges' name and kind.

        These are tractions on surface, side and interfaces, and displacements of ends, bottom and interfaces: see ``EdgeData``.
        """
        surface, side, floor = build_turn_matrices(self.rounds)
        kinds = {(name, "lifted"): (DISPLACEMENT_COMPONENTS, surface[:, 3:]) for name in LIFTED_EDGES}
        kinds |= {
            (name, "forces"): (PLANE_COMPONENTS[:3], rotation[:, :3])
            for name, rotation in (("surface", surface), ("above", surface), ("below", floor))
        }
        kinds["side", "forces"] = SIDE_COMPONENTS[:5], side[:, :3]
        samples, boundary = {}, self.interior(0, layer).boundary
        for (name, kind), (components, rotation) in kinds.items():
            edges, total = getattr(boundary, name), np.zeros(())
            if not len(edges.element):
                continue
            for sphere, c in zip(self.spheres, scattered, strict=True):
                if sphere.layer != layer:
                    continue
                points = self.rounds.repeat_points(edges.r.ravel(), edges.z.ravel())
                table = Table(sphere.modes.harmonics, "outgoing", (points - sphere.centre) / sphere.radius)
                sampler = Sampler(
                    build_stack(sphere.modes, "outgoing", components), table, slice(0, len(table.points)), name != "side"
                )
                sampled = sampler.evaluate(c).reshape(len(components), c.shape[1], self.rounds.count, -1).transpose(2, 0, 1, 3)
                unit = sphere.two_mu / sphere.radius if kind == "forces" else 1.0
                rotated = rotation[..., components] @ sampled.reshape(self.rounds.count, len(components), -1)
                total = total + unit * rotated.reshape(self.rounds.count, 3, c.shape[1], -1)
            samples[name, kind] = total
        if self.interface == "frictionless" and ("ends", "lifted") in samples:
            samples["ends", "lifted"][:, :2] = 0.0  # the tissue slides along the ends: only z strains the blocks
        return samples

    def _compute_amplitudes(self, samples: dict[tuple[str, str], Floats], m: int, layer: int) -> EdgeData:
        """Compute the amplitudes of order m on a layer's edges from the samples of ``_sample_edges``."""
        families = self.rounds.families
        waves, boundary = self.rounds.waves[:, m * families : (m + 1) * families], self.interior(0, layer).boundary
        amplitudes = {}
        for (name, kind), values in samples.items():
            amplitude = np.einsum("cft,tckn->ncfk", waves, values, optimize=True)
            amplitudes[name, kind] = np.asarray(amplitude.reshape(*getattr(boundary, name).r.shape, 3, -1))
        return amplitudes

    @cached_property
    def _places(self) -> list[_SpherePlace]:
        """For each sphere, the places of its points in the mesh."""
        places_of_spheres, shapes = [], self.field.states.model.shapes
        for sphere in self.spheres:
            x, y, z = sphere.points.T
            element, places, _ = self.field.elements.locate(np.stack([np.hypot(x, y), z], axis=1))
            value = evaluate_functions(places, shapes.degrees)[0]
            places_of_spheres.append(_SpherePlace(element, value, evaluate_pressures(places, shapes.order), np.arctan2(y, x)))
        return places_of_spheres

    @cached_property
    def _elements(self) -> Ints:
        """Numbers of all elements with points of spheres, rising."""
        return np.unique(np.concatenate([place.element for place in self._places]))

    def _evaluate_returned(
        self, sphere: ScatteringSphere, place: _SpherePlace, m: int, displacement: Floats
    ) -> tuple[Floats, Floats | None]:
        """Evaluate the reflected displacement of one order, (e, 3, s, families k), at a sphere's points.

        The displacement is along x, y, z, shape (q, 3, k). In nearly incompressible tissue its dilation, (q, k), is returned too,
        else None.
        """
        cos, sin = np.cos(m * place.angle), np.sin(m * place.angle)
        waves: Floats = np.array([[cos, sin, cos], [sin, -cos, sin]][: self.rounds.families])
        displacement = displacement.reshape(*displacement.shape[:3], len(waves), -1)
        row, model = np.searchsorted(self._elements, place.element), self.field.states.model
        local = (place.value[:, None, None] @ displacement.reshape(*displacement.shape[:3], -1)[row]).reshape(
            len(row), 3, len(waves), -1
        )
        u = (waves.transpose(2, 1, 0)[:, :, None] @ local)[:, :, 0]
        cos, sin = np.cos(place.angle)[:, None], np.sin(place.angle)[:, None]  # from r and theta to x and y
        cartesian = np.stack([cos * u[:, 0] - sin * u[:, 1], sin * u[:, 0] + cos * u[:, 1], u[:, 2]], axis=1)
        if sphere.matrix.poisson_ratio < INCOMPRESSIBLE_POISSON_RATIO:
            return cartesian, None
        strains = compute_dilations(model.geometry.select(self._elements), model.shapes, m)
        pressed = np.einsum("ekcs,ecsfj->ekfj", strains, displacement, optimize=True)
        return cartesian, np.einsum("qk,fq,qkfj->qj", place.pressure, waves[:, 0], pressed[row], optimize=True)
