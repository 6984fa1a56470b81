"""Compute coefficients of regular modes from a displacement on a sphere's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from solver.inclusions.eshelby import place_on_sphere
from solver.inclusions.mode_sums import Values
from solver.inclusions.vector_modes import Modes

OVERSAMPLING_DEGREES = 6
POINTS_PER_BATCH = 128  # points at a time: work arrays are ten times as large as the result


@dataclass(frozen=True)
class Projection:
    """Points on the unit sphere, and the matrix from displacements there to coefficients of modes.

    Attributes
    ----------
    points
        Shape (q, 3): the whole sphere for parity "both", its half y > 0 for "even", one meridian (y = 0, x > 0) for axisymmetric
        modes.
    weights
        Each point's part of the whole sphere's 4 pi, its images' included, shape (q,).
    matrix
        Coefficients per displacement, shape (modes, q, 3).
    """

    points: Floats
    weights: Floats
    matrix: Values

    def compute_coefficients(self, displacement: Values) -> Values:
        """Return coefficients (modes, k) for ``Modes.evaluate_regular`` from displacements (q, 3, k) in the sphere's axes."""
        rows = self.matrix.reshape(len(self.matrix), -1)
        out: Values = rows @ displacement.reshape(rows.shape[1], -1)
        return out


def build_projection(modes: Modes, oversample: int = OVERSAMPLING_DEGREES) -> Projection:
    """Build the projection that is exact for fields of degree up to ``modes.degree + oversample``.

    Higher degrees of a field are aliased to lower modes, in latitude and in azimuth: oversample more where fields vary strongly
    over the sphere. Only the displacement is needed, not the traction.
    """
    points, weights = build_quadrature(modes, oversample)
    matrix = np.empty((len(modes), len(points), 3), np.result_type(modes.nu, float))
    for low in range(0, len(points), POINTS_PER_BATCH):
        part = slice(low, low + POINTS_PER_BATCH)
        fields = _evaluate_orthonormal(modes, points[part]) * weights[part, None, None]
        matrix[:, part] = np.moveaxis(_convert_to_regular(modes, fields), -1, 0)
    return Projection(points, weights, matrix)


def count_projection_bytes(modes: Modes) -> int:
    """Return how many bytes the projection of these modes takes."""
    latitudes, longitudes = _count_points(modes, OVERSAMPLING_DEGREES)
    return 8 * 3 * len(modes) * latitudes * longitudes


def build_quadrature(modes: Modes, oversample: int) -> tuple[Floats, Floats]:
    """Return points (q, 3) and weights (q,) on the unit sphere: Gauss in cos theta, uniform in phi.

    They are those of the whole sphere, of its half y > 0 or of one meridian, see ``Projection.points``.
    """
    latitudes, longitudes = _count_points(modes, oversample)
    x, w = np.polynomial.legendre.leggauss(latitudes)
    if modes.parity == "both":
        phi = 2 * np.pi * np.arange(longitudes) / longitudes
    else:
        phi = np.pi * (np.arange(longitudes) + 0.5) / longitudes * (modes.order > 0)  # axisymmetric modes: phi = 0 alone
    return place_on_sphere(x, phi), np.repeat(w, len(phi)) * 2 * np.pi / len(phi)


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
    out[..., ones] *= (2 * ell + 3) * (2 * ell + 1) * (1 - nu) / (3 * ell + 1 - 2 * nu * (2 * ell + 1))
    out[..., modes.partner[ones]] -= np.sqrt(ell * (ell + 1)) / (2 * (2 * ell + 1) * (1 - nu)) * out[..., ones]
    return out
