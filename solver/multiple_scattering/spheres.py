"""The spheres of a set, in the modes in which fields about them are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from solver.inclusions.projection import Projection
from solver.inclusions.sphere_scattering import Scattering, scattering
from solver.inclusions.tumours import Tumours
from solver.inclusions.vector_modes import Modes
from solver.multiple_scattering.rings import ModeSource


@dataclass(frozen=True)
class ScatteringSphere:
    """A sphere in the axes of the probe, with the modes in which fields about it are told.

    Attributes:
        centre: x, y and z, m, shape (3,).
        radius: m.
        modes, projection: of displacements on its surface.
        matrix: the material about it.
        layer: the number of the tissue's layer in which it lies.
    """

    centre: Floats
    radius: float
    modes: Modes
    projection: Projection
    matrix: Material
    layer: int = 0

    @property
    def two_mu(self) -> float:
        """Of the material about it, Pa."""
        return self.matrix.youngs_modulus / (1 + self.matrix.poisson_ratio)

    @property
    def source(self) -> ModeSource:
        """The sphere as a source of outgoing modes."""
        return ModeSource(self.centre, self.radius, self.modes)

    @cached_property
    def points(self) -> Floats:
        """Where displacements are projected, m, shape (q, 3)."""
        return np.asarray(self.centre + self.radius * self.projection.points)

    def coefficients(self, displacement: Floats, dilation: Floats | None = None) -> Floats:
        """Regular coefficients (modes, k) of a field at the sphere's q points, displacement (q, 3, k), m, and dilation (q, k).

        The mode of degree 0, u = c x / R, is taken from the dilation where that is known: in a field that balances it is
        harmonic, so that its mean over the surface is that over the ball, 3 c / R. In nearly incompressible tissue an error
        of the displacement's flux would count times the bulk modulus.
        """
        out = self.projection.coefficients(displacement)
        if dilation is not None:
            mean = self.radius * np.sqrt(4 * np.pi) / 3 * self.projection.weights / (4 * np.pi)
            out[self.modes.ell == 0] = mean @ dilation
        return np.asarray(out)


@dataclass(frozen=True)
class SphereSet:
    """What the spheres of a set make of fields about all of them: arrays (modes of all, k), one sphere after the other.

    Attributes:
        scatterings: of the spheres.
        parts: where their modes stand.
    """

    scatterings: Sequence[Scattering]
    parts: Sequence[slice]

    @classmethod
    def of(cls, spheres: Sequence[ScatteringSphere], tumours: Tumours) -> SphereSet:
        """Scattering by tumours, shape (t,), each in the material about it."""
        moduli = zip(spheres, tumours.youngs_modulus, tumours.poisson_ratio, strict=True)
        scatterings = [scattering(one.modes, one.matrix.youngs_modulus, float(E), float(nu), one.radius) for one, E, nu in moduli]
        ends = np.cumsum([0, *(len(one.modes) for one in spheres)]).tolist()
        return cls(scatterings, [slice(*pair) for pair in pairwise(ends)])

    def scattered(self, c: Floats) -> list[Floats]:
        """Outgoing coefficients S c about each sphere."""
        return [one.S @ c[part] for one, part in zip(self.scatterings, self.parts, strict=True)]

    def work(self, c: Floats) -> Floats:
        """T c, of the shape of c."""
        return np.concatenate([one.T @ c[part] for one, part in zip(self.scatterings, self.parts, strict=True)])

    def slopes(self, c: Floats) -> Floats:
        """c^T (dT / d ln E) c of every sphere, shape (t, k, k)."""
        pairs = zip(self.scatterings, self.parts, strict=True)
        return np.array([c[part].T @ (one.by_log_modulus[1] @ c[part]) for one, part in pairs])
