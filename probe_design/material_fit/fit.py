r"""Fit neo-Hookean and Yeoh's laws to a curve by least squares, stable over the curve's range.

Stress is linear in the constants. With x = I - 3 and P = W' dI/ds of eq. MF.1,

    W = C1 x + C2 x^2 + C3 x^3,   W' = C1 + 2 C2 x + 3 C3 x^2                                    (MF.2)

so that the constants are a linear least-squares problem; D. C. Drucker's condition, eq. LW.4, at each x is linear in them, too.
Where the fit violates it within the curve's range, the constants with the least squares that do not are taken.

The number of constants is the one of the least

    B = n' ln(mean square residual) + k ln n',   n' = n (1 - r) / (1 + r)                        (MF.3)

(G. Schwarz, Ann. Statist. 6, 1978, 461) with k constants and n' independent ones among n points, r being the correlation of
neighbouring residuals of the law with all constants. The covariance of the constants counts its law's n': neighbouring points of
a smooth curve repeat each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint, minimize

from geometry.common.arrays import Floats
from probe_design.material_fit.curve import StressCurve
from solver.materials.strain_energies import StableRange, Yeoh, list_modes

STABILITY_POINTS = 400  # strains of each mode at which eq. LW.4 is enforced
STABILITY_MARGIN_RELATIVE = 1e-3  # of C1: the condition holds between the tested strains, too
MIN_RESIDUAL_RELATIVE = 1e-10  # of the largest stress: rounding of an exact curve, whose logarithm would be minus infinity


@dataclass(frozen=True)
class Constants:
    """Yeoh's constants of a curve; those that the law does not have are 0.

    Attributes
    ----------
    values
        C1, C2, C3, Pa, shape (3,).
    covariance
        Of these, Pa^2, shape (3, 3); of the fit without the limit of stability.
    count
        Number of constants that were fitted: 1 is a neo-Hookean law.
    residual
        Root mean square of the misfit of the nominal stress, Pa.
    misfit
        The same over the largest stress.
    independent
        Number of independent residuals, n' of eq. MF.3.
    is_limited
        Whether the limit of stability changed the constants.
    """

    values: Floats
    covariance: Floats
    count: int
    residual: float
    misfit: float
    independent: float
    is_limited: bool

    @property
    def ratios(self) -> tuple[float, float]:
        """C2 / C1 and C3 / C1."""
        return float(self.values[1] / self.values[0]), float(self.values[2] / self.values[0])

    def predict(self, curve: StressCurve) -> Floats:
        """Return the nominal stress at the points of a curve, Pa."""
        return np.asarray(build_columns(curve) @ self.values)


def build_columns(curve: StressCurve) -> Floats:
    """Return the nominal stress of C1, C2 and C3 of 1 Pa at each point, from W' of eq. MF.2, shape (n, 3)."""
    x = curve.distortion
    return np.asarray(curve.stress_factor[:, None] * np.stack([np.ones_like(x), 2 * x, 3 * x**2], axis=1))


def fit_constants(curve: StressCurve, count: int) -> Constants:
    """Return the first ``count`` constants that fit a curve best, the law being stable over the curve's range."""
    largest, largest_stress = float(curve.distortion.max()), float(np.abs(curve.stress).max())
    scale = largest_stress / largest ** np.arange(count)  # so that all unknowns are of order 1
    A, b = build_columns(curve)[:, :count] * scale / largest_stress, curve.stress / largest_stress
    unknowns = np.linalg.lstsq(A, b, rcond=None)[0]
    limits = _build_stability(largest)[:, :count] * scale
    limits /= np.abs(limits).max(axis=1, keepdims=True)
    is_limited = bool((limits @ unknowns < 0).any())
    if is_limited:
        first = np.eye(count)[0] * float(A[:, 0] @ b / (A[:, 0] @ A[:, 0]))  # neo-Hookean, which is stable
        margin = STABILITY_MARGIN_RELATIVE * first[0]

        def square_misfit(z: Floats) -> tuple[float, Floats]:
            misfit = A @ z - b
            return float(misfit @ misfit), np.asarray(2 * A.T @ misfit)

        solution = minimize(
            square_misfit, first, jac=True, method="SLSQP",
            constraints=LinearConstraint(limits, lb=margin), options={"maxiter": 500, "ftol": 1e-14},
        )  # fmt: skip
        unknowns = solution.x if (limits @ solution.x >= 0).all() else first
    residuals = (b - A @ unknowns) * largest_stress
    independent = _count_independent(residuals, count)
    square = float(np.mean(residuals**2))
    variance = square * b.size / max(b.size - count, 1) * b.size / independent
    transform = np.diag(scale) / largest_stress
    covariance = np.zeros((3, 3))
    covariance[:count, :count] = variance * transform @ np.linalg.inv(A.T @ A) @ transform
    values = np.concatenate([unknowns * scale, np.zeros(3 - count)])
    residual = float(np.sqrt(square))
    return Constants(values, covariance, count, residual, residual / largest_stress, independent, is_limited)


def choose_constants(curve: StressCurve, candidates: tuple[Constants, ...]) -> Constants:
    """Return the candidate of the least B, eq. MF.3; the last one has the most constants."""
    independent, floor = candidates[-1].independent, MIN_RESIDUAL_RELATIVE * float(np.abs(curve.stress).max())

    def compute_evidence(law: Constants) -> float:
        return float(2 * independent * np.log(max(law.residual, floor)) + law.count * np.log(independent))

    return min(candidates, key=compute_evidence)


def find_stable_strain(constants: Constants) -> float:
    """Return the strain in uniaxial tension up to which the law is stable; infinite if none is known."""
    stable = StableRange.from_law(Yeoh(*constants.ratios))
    return stable.stretch - 1 if np.isfinite(stable.x) else np.inf


def find_tension_strain(distortion: float) -> float:
    """Return the strain in uniaxial tension with this I - 3."""
    s = np.linspace(1.0, 12.0, 22001)  # wider than any curve, in steps of 0.0005
    return float(np.interp(distortion, s**2 + 2 / s - 3, s)) - 1


def _build_stability(largest: float) -> Floats:
    """Return rows whose products with C1, C2, C3 are above 0 where a law is stable up to I - 3 = ``largest``, eq. LW.4."""
    s = np.linspace(1.0, 1 + find_tension_strain(largest), STABILITY_POINTS + 1)[1:]
    rows = [np.array([[1.0, 0.0, 0.0]])]
    for stretches in (s, 1 / s):
        for invariant, first, second in list_modes(stretches):
            x = np.minimum(invariant - 3, largest * (1 + 1e-3))
            derivative = np.stack([np.ones_like(x), 2 * x, 3 * x**2], axis=1)
            bend = np.stack([np.zeros_like(x), np.full_like(x, 2.0), 6 * x], axis=1)
            inside = invariant - 3 <= largest * (1 + 1e-3)
            rows += [derivative[inside], (derivative * second[:, None] + bend * first[:, None] ** 2)[inside]]
    return np.concatenate(rows)


def _count_independent(residuals: Floats, count: int) -> float:
    """Return how many of the residuals are independent, n' of eq. MF.3; at least one more than there are constants."""
    power = float(residuals @ residuals)
    r = float(residuals[1:] @ residuals[:-1]) / power if power > 0 else 0.0
    r = min(max(r, 0.0), 1 - 1 / residuals.size)
    return max(residuals.size * (1 - r) / (1 + r), count + 1.0)
