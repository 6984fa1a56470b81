"""Compute coefficients of regular modes from a displacement on a sphere's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.inclusions.eshelby import build_sphere_rule, place_on_sphere
from solver.inclusions.mode_sums import Values
from solver.inclusions.vector_modes import Modes

OVERSAMPLING_DEGREES = 6


@dataclass(frozen=True)
class Projection:
    """Points on the unit sphere, on latitudes and longitudes, and the projection of displacements there on modes.

    Attributes
    ----------
    points
        Shape (q, 3): the whole sphere for parity "both", its half y > 0 for "even", one meridian (y = 0, x > 0) for axisymmetric
        modes. Longitudes vary first.
    weights
        Each point's part of the whole sphere's 4 pi, its images' included, shape (q,).
    axes
        Matrices from components along x, y and z to those along r, phi and z on each longitude, shape (3, 3, longitudes).
    waves
        The cosines and sines of m phi by which components vary, shape (2, orders, longitudes).
    families
        For each order and each of its two symmetries: the order, the numbers of the waves of r, phi and z, shape (3,), the
        numbers of the modes, and their coefficients per component times wave, summed over longitudes, (modes, 3, latitudes).
    """

    points: Floats
    weights: Floats
    axes: Floats
    waves: Floats
    families: tuple[tuple[int, Ints, Ints, Values], ...]

    def compute_coefficients(self, displacement: Values) -> Values:
        """Return coefficients (modes, k) for ``Modes.evaluate_regular`` from displacements (q, 3, k) in the sphere's axes."""
        longitudes, k = self.waves.shape[-1], displacement.shape[-1]
        local = np.einsum("axl,nlxk->lank", self.axes, displacement.reshape(-1, longitudes, 3, k))
        summed = (self.waves.reshape(-1, longitudes) @ local.reshape(longitudes, -1)).reshape(*self.waves.shape[:2], 3, -1, k)
        out = np.empty((sum(len(family[2]) for family in self.families), k), np.result_type(displacement, self.families[0][3]))
        for m, wave, numbers, coefficients in self.families:
            out[numbers] = coefficients.reshape(len(numbers), -1) @ summed[wave, m, np.arange(3)].reshape(-1, k)
        return out


def build_projection(modes: Modes, oversample: int = OVERSAMPLING_DEGREES) -> Projection:
    """Build the projection that is exact for fields of degree up to ``modes.degree + oversample``.

    Higher degrees of a field are aliased to lower modes, in latitude and in azimuth: oversample more where fields vary strongly
    over the sphere. Only the displacement is needed, not the traction. Components along r, phi and z vary as cos m phi or
    sin m phi, so that those on one meridian, where none of these waves vanishes, determine all.
    """
    points, weights = build_quadrature(modes, oversample)
    longitudes = _count_points(modes, oversample)[1]
    phi, meridian = np.arctan2(points[:longitudes, 1], points[:longitudes, 0]), np.array([np.pi / 2 / (modes.order + 1)])
    on_meridian = place_on_sphere(points[::longitudes, 2], meridian)
    fields = _convert_to_regular(modes, _evaluate_orthonormal(modes, on_meridian)) * weights[::longitudes, None, None]
    components = np.einsum("ax,nxm->man", _build_axes(meridian)[..., 0], fields)
    kind, _, m, sine = modes.labels
    mirrors = (kind == 2) == (sine == 1)  # in the plane y = 0: along r and z as cos m phi, else as sin m phi
    families = []
    for order, symmetry in sorted(set(zip(m.tolist(), mirrors.tolist(), strict=True))):
        numbers, wave = np.flatnonzero((m == order) & (mirrors == symmetry)), np.array([0, 1, 0] if symmetry else [1, 0, 1])
        sizes = _evaluate_waves(order, meridian)[wave, 0]  # sin 0 vanishes, and with it the component
        coefficients = components[numbers] * np.divide(1.0, sizes, out=np.zeros(3), where=sizes != 0)[:, None]
        families.append((order, wave, numbers, coefficients))
    waves = np.stack([_evaluate_waves(order, phi) for order in range(int(m.max()) + 1)], axis=1)
    return Projection(points, weights, _build_axes(phi), waves, tuple(families))


def _build_axes(phi: Floats) -> Floats:
    """Return the matrices from components along x, y and z to those along r, phi and z on n longitudes, shape (3, 3, n)."""
    cos, sin, none = np.cos(phi), np.sin(phi), np.zeros(len(phi))
    return np.array([[cos, sin, none], [-sin, cos, none], [none, none, none + 1]])


def _evaluate_waves(m: int, phi: Floats) -> Floats:
    """Return cos m phi and sin m phi on n longitudes, shape (2, n)."""
    return np.array([np.cos(m * phi), np.sin(m * phi)])


def build_quadrature(modes: Modes, oversample: int) -> tuple[Floats, Floats]:
    """Return points (q, 3) and weights (q,) on the unit sphere: Gauss in cos theta, uniform in phi.

    They are those of the whole sphere, of its half y > 0 or of one meridian, see ``Projection.points``.
    """
    latitudes, longitudes = _count_points(modes, oversample)
    if modes.parity == "both":
        phi = 2 * np.pi * np.arange(longitudes) / longitudes
    else:
        phi = np.pi * (np.arange(longitudes) + 0.5) / longitudes * (modes.order > 0)  # axisymmetric modes: phi = 0 alone
    points, weights = build_sphere_rule(latitudes, phi)
    return points, 4 * np.pi * weights


def _count_points(modes: Modes, oversample: int) -> tuple[int, int]:
    """Return the numbers of latitudes and longitudes that integrate products of a mode and a field exactly.

    The field has degrees up to ``oversample`` above the modes'. On n points of the circle cos m phi sums to 0 unless n divides m;
    n longitudes of the half sphere count as 2 n, with their mirror images.
    """
    high = modes.degree + oversample
    longitudes = modes.order + high + 1 if modes.parity == "both" else (modes.order + high) // 2 + 1 if modes.order else 1
    return (modes.degree + high) // 2 + 1, longitudes


def _evaluate_orthonormal(modes: Modes, points: Floats) -> Values:
    """Evaluate vector harmonics, orthonormal on the unit sphere, at its points, shape (q, 3, modes).

    Gradients of regular and of irregular solid harmonics of one l and m are orthogonal on the unit sphere: with (a, b) =
    (l, 1) and (-l-1, 1) the integral a a' + l(l+1) b b' is zero. Modes of kind 0 are the former, outgoing ones of
    kind 1 the latter; toroidal ones are alike on both sides.
    """
    fields = np.where(modes.kind == 1, modes.evaluate_shapes(points, "outgoing"), modes.evaluate_shapes(points, "regular"))
    out: Values = np.where(modes.kind == 2, np.sqrt(modes.ell + 0.5) * fields, fields)
    return out


def _convert_to_regular(modes: Modes, fields: Values) -> Values:
    """Convert components along the orthonormal harmonics, shape (..., modes), to those along the regular modes.

    A regular mode of kind 1 has (sqrt(l(l+1)) / 2, (3l+1 - 2 nu (2l+1)) / (2l+3)) / ((2l+1) (1-nu)) along the
    harmonics of kinds 0 and 1 (IN.10); the other modes are multiples of one.
    """
    kind, nu = modes.kind, modes.nu
    out = fields * np.where(kind == 2, np.sqrt(modes.ell + 0.5), np.ones(len(modes), np.result_type(nu, float)))
    (ones,) = np.nonzero((kind == 1) & (modes.ell > 0))  # modes of kind 1; the only one without a partner has l = 0
    ell = modes.ell[ones]
    # eq. IN.10: two harmonics from which the mode and its partner of kind 0 follow
    out[..., ones] *= (2 * ell + 3) * (2 * ell + 1) * (1 - nu) / (3 * ell + 1 - 2 * nu * (2 * ell + 1))
    out[..., modes.partner[ones]] -= np.sqrt(ell * (ell + 1)) / (2 * (2 * ell + 1) * (1 - nu)) * out[..., ones]
    return out
