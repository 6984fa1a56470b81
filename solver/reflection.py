"""What surface, blocks, side and floor send back of the fields that spheres scatter.

Scattered fields are known in closed form anywhere (``multipoles.py``), so that the finite elements never see the sphere: they
are told the tractions and displacements that the field leaves on the tissue's boundary, one azimuthal order at a time, and answer
with what must be added, eq. (B1) of ``boundary.py``: its regular modes at the spheres are the next incident field.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geometry.grading import Floats
from geometry.section import Body
from solver.azimuthal import Harmonics
from solver.base_states import BaseStates
from solver.boundary import Boundary, Data, Edges, Response
from solver.fields import TissueField
from solver.multipoles import Modes
from solver.numbering import Interface
from solver.projection import Projection
from solver.quadrilateral import dilations
from solver.shapes import Ints, functions, pressures

NEARLY = 0.48  # Poisson's ratio from which the mode of degree 0 is taken from the dilation
STRESS = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # places of xx, yy, zz, yz, xz, xy in the tensor


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

    @cached_property
    def points(self) -> Floats:
        """Where displacements are projected, m, shape (q, 3)."""
        return np.asarray(self.centre + self.radius * self.projection.points)

    def with_dilation(self, coefficients: Floats, dilation: Floats) -> Floats:
        """Take the mode of degree 0, u = c x / R, from the dilation at the points, (q, k), in place of the displacement.

        In a field that balances the dilation is harmonic, so that its mean over the surface is that over the ball, 3 c / R.
        In nearly incompressible tissue an error of the displacement's flux would count times the bulk modulus.
        """
        mean = self.projection.weights @ dilation / (4 * np.pi)
        out = coefficients.copy()
        out[self.modes.ell == 0] = self.radius * np.sqrt(4 * np.pi) * mean / 3
        return out


@dataclass(frozen=True)
class Rounds:
    """Angles about the probe's axis at which fields are sampled: the half plane's y > 0 where they mirror, or all round.

    Attributes:
        count: number of angles.
        mirrored: whether fields are even about y = 0.
    """

    count: int
    mirrored: bool

    @cached_property
    def angles(self) -> Floats:
        """Shape (count,)."""
        return (np.arange(self.count) + 0.5) * (np.pi if self.mirrored else 2 * np.pi) / self.count

    def waves(self, m: int, angles: Floats) -> Floats:
        """Shapes round the axis of U, V and W, for the even and, unless mirrored, the odd family: (families, 3, angles)."""
        cos, sin = np.cos(m * angles), np.sin(m * angles)
        families = [[cos, sin, cos], [sin, -cos, sin]]
        return np.array(families[: 1 if self.mirrored else 2])

    def amplitudes(self, values: Floats, m: int) -> Floats:
        """Amplitudes of order m of values (e, q, count, 3, k) along r, theta and z, shape (e, q, 3, families k)."""
        share = (1 if m == 0 else 2) / self.count
        parts = share * np.einsum("fct,eqtck->eqcfk", self.waves(m, self.angles), values)
        return np.asarray(parts.reshape(*parts.shape[:3], -1))


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

    def reflect(self, spheres: Sequence[Sphere], scattered: Sequence[Floats], rounds: Rounds) -> Iterator[list[Floats]]:
        """Yield for each azimuthal order the regular coefficients of what comes back, (modes, k) for each sphere.

        Args:
            spheres: they.
            scattered: outgoing coefficients about each, (modes, k), m.
            rounds: angles; with fewer than two only order 0.

        Raises:
            SolveError: a system could not be solved.
        """
        samples = self._samples(spheres, scattered, rounds)
        places = [self._place(sphere) for sphere in spheres]
        elements = np.unique(np.concatenate([place.element for place in places]))
        for m in range(max(1, rounds.count - 1)):
            data = Data(*(rounds.amplitudes(values, m) for values in samples))
            found = self.response(m).to(data, elements)
            yield [self._coefficients(*one, m, found, elements, rounds) for one in zip(spheres, places, strict=True)]

    def _samples(self, spheres: Sequence[Sphere], scattered: Sequence[Floats], rounds: Rounds) -> list[Floats]:
        """Tractions on surface and side, displacements of ends and floor, along r, theta, z, (e, q, angles, 3, k) each."""
        b = self.boundary
        tractions = [
            sum_of(spheres, scattered, edges, rounds, normal, self._two_mu) for edges, normal in ((b.surface, 2), (b.side, 0))
        ]
        moves = [sum_of(spheres, scattered, edges, rounds) for edges in (b.ends, b.floor)]
        if self.interface == "frictionless":
            moves[0][..., :2, :] = 0.0
        return [*tractions, *moves]

    @property
    def _two_mu(self) -> float:
        tissue = self.states.model.materials[Body.TISSUE]
        return tissue.youngs_modulus / (1 + tissue.poisson_ratio)

    def _place(self, sphere: Sphere) -> _Place:
        x, y, z = sphere.points.T
        shapes = self.states.model.shapes
        element, places, _ = self.field.locate(np.stack([np.hypot(x, y), z], axis=1))
        return _Place(element, functions(places, shapes.degrees)[0], pressures(places, shapes.order), np.arctan2(y, x))

    def _coefficients(self, sphere: Sphere, place: _Place, m: int, found: Floats, elements: Ints, rounds: Rounds) -> Floats:
        """Regular coefficients (modes, k) of one order's values (e, 3, s, families k)."""
        waves, angle, model = rounds.waves(m, place.angle), place.angle, self.states.model
        found = found.reshape(*found.shape[:3], len(waves), -1)
        row = np.searchsorted(elements, place.element)
        u = np.einsum("qs,fcq,qcsfk->qck", place.value, waves, found[row], optimize=True)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        cartesian = np.stack([cos * u[:, 0] - sin * u[:, 1], sin * u[:, 0] + cos * u[:, 1], u[:, 2]], axis=1)
        c = np.asarray(sphere.projection.coefficients(cartesian))
        if self.states.model.materials[Body.TISSUE].poisson_ratio < NEARLY:
            return c
        pressed = np.einsum("ekcs,ecsfj->ekfj", dilations(model.at.of(elements), model.shapes, m), found, optimize=True)
        return sphere.with_dilation(c, np.einsum("qk,fq,qkfj->qj", place.pressure, waves[:, 0], pressed[row], optimize=True))


def sum_of(
    spheres: Sequence[Sphere],
    scattered: Sequence[Floats],
    edges: Edges,
    rounds: Rounds,
    normal: int | None = None,
    two_mu: float = 1.0,
) -> Floats:
    """Displacement or, with the normal's direction (0 r, 2 z), traction of all scattered fields on edges, (e, q, t, 3, k)."""
    cos, sin = np.cos(rounds.angles), np.sin(rounds.angles)
    r, z = edges.r[..., None], edges.z[..., None]
    points = np.stack(np.broadcast_arrays(r * cos, r * sin, z), axis=-1)
    total = np.zeros((points[..., 0].size, 3, scattered[0].shape[1]))
    flat = points.reshape(-1, 3)
    for sphere, coefficients in zip(spheres, scattered, strict=True):
        local = (flat - sphere.centre) / sphere.radius
        if normal is None:
            total += sphere.modes.displacement(local, coefficients, "outgoing")
            continue
        stress = sphere.modes.outgoing(local, coefficients)[1] * (two_mu / sphere.radius)
        tensor = stress[:, STRESS]
        if normal == 2:
            total += tensor[:, 2]
        else:
            flat_cos, flat_sin = (np.broadcast_to(part, points.shape[:-1]).reshape(-1, 1, 1) for part in (cos, sin))
            total += flat_cos * tensor[:, 0] + flat_sin * tensor[:, 1]
    shaped = total.reshape(*points.shape[:-1], 3, -1)
    x, y = shaped[..., 0, :].copy(), shaped[..., 1, :].copy()
    shaped[..., 0, :] = cos[:, None] * x + sin[:, None] * y
    shaped[..., 1, :] = cos[:, None] * y - sin[:, None] * x
    return shaped
