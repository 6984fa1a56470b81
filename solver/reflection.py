"""What surface, blocks, side and floor send back of the fields that spheres scatter.

Scattered fields are known in closed form anywhere (``multipoles.py``), so that the finite elements never see the sphere: they
are told the tractions and displacements that the field leaves on the tissue's boundary, one azimuthal order at a time, and answer
with what must be added, eq. (B1) of ``boundary.py``: its regular modes at the spheres are the next incident field.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from geometry.grading import Floats
from geometry.section import Body
from solver.azimuthal import Harmonics
from solver.base_states import BaseStates
from solver.boundary import Boundary, Data, Response
from solver.fields import TissueField
from solver.multipoles import Modes
from solver.numbering import Interface
from solver.projection import Projection
from solver.quadrilateral import dilations
from solver.samples import Rounds, Samples, Source
from solver.shapes import Ints, functions, pressures

NEARLY = 0.48  # Poisson's ratio from which the mode of degree 0 is taken from the dilation


@dataclass(frozen=True)
class Arrived:
    """A field at the q points of a sphere.

    Attributes:
        displacement: m, shape (q, 3, k).
        dilation: shape (q, k), or None where the displacement tells it well enough.
    """

    displacement: Floats
    dilation: Floats | None

    def __add__(self, other: Arrived) -> Arrived:
        """Return the sum of two fields."""
        dilation = None if self.dilation is None or other.dilation is None else self.dilation + other.dilation
        return Arrived(self.displacement + other.displacement, dilation)

    def times(self, weights: Arrived) -> Floats:
        """Return the products of all columns with all columns of some weights, (weights, k)."""
        k = self.displacement.shape[-1]
        total = weights.displacement.reshape(-1, weights.displacement.shape[-1]).T @ self.displacement.reshape(-1, k)
        if self.dilation is not None and weights.dilation is not None:
            total += weights.dilation.T @ self.dilation
        return np.asarray(total)


@dataclass(frozen=True)
class Sphere:
    """A sphere in the axes of the probe, with the modes in which fields about it are told.

    Attributes:
        centre: x, y and z, m, shape (3,).
        radius: m.
        modes, projection: of displacements on its surface.
    """

    centre: Floats
    radius: float
    modes: Modes
    projection: Projection

    @property
    def source(self) -> Source:
        """The sphere as a source of outgoing modes."""
        return Source(self.centre, self.radius, self.modes)

    @cached_property
    def points(self) -> Floats:
        """Where displacements are projected, m, shape (q, 3)."""
        return np.asarray(self.centre + self.radius * self.projection.points)

    def coefficients(self, field: Arrived) -> Floats:
        """Regular coefficients (modes, k) of a field.

        The mode of degree 0, u = c x / R, is taken from the dilation where that is known: in a field that balances it is
        harmonic, so that its mean over the surface is that over the ball, 3 c / R. In nearly incompressible tissue an error
        of the displacement's flux would count times the bulk modulus.
        """
        out = self.projection.coefficients(field.displacement)
        if field.dilation is not None:
            out[self.modes.ell == 0] = self._mean @ field.dilation
        return np.asarray(out)

    def weights(self, left: Floats) -> Arrived:
        """Weights of a field's values in left^T coefficients, for left (modes, k): see ``Arrived.times``."""
        nearly, lowest = bool(np.real(self.modes.nu) >= NEARLY), self.modes.ell == 0
        kept = left * np.logical_not(nearly & lowest)[:, None]
        flat = self.projection.matrix.reshape(len(left), -1).T @ kept
        return Arrived(flat.reshape(-1, 3, left.shape[1]), np.outer(self._mean, left[lowest]) if nearly else None)

    @cached_property
    def _mean(self) -> Floats:
        return np.asarray(self.radius * np.sqrt(4 * np.pi) / 3 * self.projection.weights / (4 * np.pi))


@dataclass(frozen=True)
class _Place:
    """Where a sphere's q points lie: elements, their functions and pressures there, angle about the probe's axis."""

    element: Ints
    value: Floats
    pressure: Floats
    angle: Floats


@dataclass(frozen=True)
class Reflector:
    """The boundary of one probe's tissue, with a factorised system for each azimuthal order that was asked for.

    Attributes:
        states: base states without a sphere.
        interface: between blocks and tissue.
    """

    states: BaseStates
    interface: Interface
    _responses: dict[int, Response] = field(default_factory=dict, repr=False)

    def response(self, m: int) -> Response:
        """Return what an order answers; its system is factorised the first time."""
        if m not in self._responses:
            self._responses[m] = Response(self._harmonics.of_order(m), self.boundary)
        return self._responses[m]

    @cached_property
    def _harmonics(self) -> Harmonics:
        return Harmonics(self.states.model, self.interface)

    @cached_property
    def boundary(self) -> Boundary:
        """Edges of the mesh."""
        return Boundary.of(self.states.model)

    @cached_property
    def field(self) -> TissueField:
        """Where points lie in the mesh."""
        return TissueField(self.states)

    def exchange(self, spheres: Sequence[Sphere], rounds: Rounds) -> Exchange:
        """Return what spheres and boundary send to each other; all that does not depend on the fields is found once."""
        tissue = self.states.model.materials[Body.TISSUE]
        two_mu = tissue.youngs_modulus / (1 + tissue.poisson_ratio)
        samples = Samples([one.source for one in spheres], self.boundary, rounds, two_mu)
        return Exchange(self, spheres, rounds, samples, [self._place(one) for one in spheres])

    def _place(self, sphere: Sphere) -> _Place:
        x, y, z = sphere.points.T
        shapes = self.states.model.shapes
        element, places, _ = self.field.locate(np.stack([np.hypot(x, y), z], axis=1))
        angle = np.arctan2(y, x)
        return _Place(element, functions(places, shapes.degrees)[0], pressures(places, shapes.order), angle)


@dataclass(frozen=True)
class Exchange:
    """Some spheres before one boundary.

    Attributes:
        reflector: the boundary.
        spheres: they.
        rounds: angles at which fields are sampled; with fewer than two only order 0.
        samples: their fields on the boundary.
        places: where their points lie in the mesh.
    """

    reflector: Reflector
    spheres: Sequence[Sphere]
    rounds: Rounds
    samples: Samples
    places: Sequence[_Place]
    _rows: dict[int, Any] = field(default_factory=dict, repr=False)

    def reflect(self, scattered: Sequence[Floats]) -> Iterator[list[Arrived]]:
        """Yield for each azimuthal order what comes back to each sphere.

        Args:
            scattered: outgoing coefficients about each, (modes, k), m.

        Raises:
            SolveError: a system could not be solved.
        """
        samples = self.samples.values(scattered)
        if self.reflector.interface == "frictionless":
            samples[2][..., :2, :] = 0.0
        for m in range(max(1, self.rounds.count - 1)):
            data = Data(*(self.rounds.amplitudes(values, m) for values in samples))
            response = self.reflector.response(m)
            if min(m, 2) not in self._rows:
                self._rows[min(m, 2)] = response.harmonic.gathered(self._elements)
            found = response.to(data, self._elements, self._rows[min(m, 2)])
            yield [self._arrived(place, m, found) for place in self.places]

    @cached_property
    def _elements(self) -> Ints:
        return np.unique(np.concatenate([place.element for place in self.places]))

    def _arrived(self, place: _Place, m: int, found: Floats) -> Arrived:
        """Values of one order (e, 3, s, families k) at a sphere's points."""
        waves, angle, model = self.rounds.waves(m, place.angle), place.angle, self.reflector.states.model
        found = found.reshape(*found.shape[:3], len(waves), -1)
        row = np.searchsorted(self._elements, place.element)
        at = (place.value[:, None, None] @ found.reshape(*found.shape[:3], -1)[row]).reshape(len(row), 3, len(waves), -1)
        u = (waves.transpose(2, 1, 0)[:, :, None] @ at)[:, :, 0]
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        cartesian = np.stack([cos * u[:, 0] - sin * u[:, 1], sin * u[:, 0] + cos * u[:, 1], u[:, 2]], axis=1)
        if model.materials[Body.TISSUE].poisson_ratio < NEARLY:
            return Arrived(cartesian, None)
        strains = dilations(model.at.of(self._elements), model.shapes, m)
        pressed = np.einsum("ekcs,ecsfj->ekfj", strains, found, optimize=True)
        return Arrived(cartesian, np.einsum("qk,fq,qkfj->qj", place.pressure, waves[:, 0], pressed[row], optimize=True))
