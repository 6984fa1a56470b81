"""Compute the phase of the ratio to first order in the loss angles, with a bound on the error.

f is ln of the ratio that the scene reads, of charges or of stresses, as a function of the logarithms x of all moduli, real where
x is real. The vectors v and delta hold the changes of ln E by losses and the loss angles of all materials, bonds of films
included, eq. PH.1. With j the imaginary unit and Df, D2f and D3f the first three
derivatives of f at x along the directions in brackets, the phase is

    arg ratio = Im f(x + v + j delta) = Df[delta] + D2f[delta, v] - D3f[delta, delta, delta] / 6 + ...    (PH.2)

Each term is odd in all loss factors together: v is even, delta odd, and Im keeps the odd powers of j delta. So the error of the
first term is of third order, and falls to an eighth if all loss factors are halved. The gradient of f is computed exactly. The
higher terms, and the derivative of the first by a number p of the scene, are differences of gradients along delta,

    d Df[delta] / dp = (f_p(x + h delta) - f_p(x - h delta)) / 2h + O(h^2)                                (PH.3)

with f_p the derivative of f with respect to p and h a small number. f does not change if all moduli grow by the same factor: only
differences between loss angles count. The same holds for the error e of ln(ratio) due to the mesh and to omitted features.
It adds De[delta] to the phase, which is bounded by RATIO_ERROR_FACTOR |e| times the spread of the loss angles. Inertia relative
to stiffness, eq. PH.4, is bounded likewise with INERTIA_ERROR_FACTOR.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from geometry.common.errors import ProbeError, SolveError
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_loss_factors, list_values
from solver.phase.inertia import check_frequency, compute_inertia_number, find_swing_refusal
from solver.phase.log_derivatives import MODULUS_SUFFIX, LogDerivatives, choose_derivatives
from solver.phase.losses import compute_angle_spread, compute_log_growths, compute_loss_angles, scale_moduli
from solver.results.result import Result
from solver.results.warnings import Note

STEP_RAD = 1e-2  # h of eq. PH.3 times the largest loss angle
HIGHER_ORDER_FACTOR = 1.5  # times the sizes of the terms of third order: allows for higher orders
RATIO_ERROR_FACTOR, INERTIA_ERROR_FACTOR = 2.0, 2.0
CONTACT_EVALUATOR = "contact"  # the evaluator for whose results no phase is computed
MAX_PHASE_ERROR_RAD = 0.5  # above this error bound no phase is reported
LOSSLESS_NOTE = Note("null", "all loss factors are 0, and with them ratio_phase")


class PhaseUnknown(ProbeError):  # noqa: N818 - says why
    """No phase can be computed; the text is the reason."""


@dataclass(frozen=True)
class RatioPhase:
    """The phase by which the inner film's stress or charge, whichever the scene reads, leads that of the outer film.

    It is counted from the sign of their elastic ratio.

    Attributes
    ----------
    value
        rad.
    error
        Bound on its absolute error, rad.
    derivatives
        By the scene's numbers and loss factors, rad per SI unit; keys as in ``geometry.scenes.variables``.
    notes
        warnings.
    """

    value: float
    error: float
    derivatives: dict[str, float]
    notes: tuple[Note, ...] = ()


def compute_ratio_phase(scene: Scene, result: Result, accuracy: float, frequency: float) -> RatioPhase:
    """Compute the phase of the ratio under a small sinusoidal load, for which linear elasticity holds.

    Parameters
    ----------
    scene
        With loss factors that hold at the frequency.
    result
        The scene's result; its error, and its difference from the ratio computed here, count in the phase's error.
    accuracy
        Of the result; it sets the mesh's fineness.
    frequency
        Hz; inertia depends on it, loss factors do not.

    Raises
    ------
    InputError
        A frequency at which inertia is not small.
    PhaseUnknown
        The derivatives of this kind of scene are not known, or the error bound is above ``MAX_PHASE_ERROR_RAD``.
    LimitReached
        See ``solver.evaluate``.
    """
    check_frequency(scene, frequency)
    swing_refusal = find_swing_refusal(scene, frequency)
    if swing_refusal is not None:
        raise PhaseUnknown(swing_refusal)
    read = result.reading
    if read.ratio is None or read.error is None:
        raise PhaseUnknown("the ratio has to be known with its error")
    if result.evaluator == CONTACT_EVALUATOR:  # derivatives change with the load more than the ratio, which may return
        raise PhaseUnknown("nothing is known of phases at finite strain and with contact")
    reason, differentiate = choose_derivatives(scene, accuracy)
    if reason is not None:
        raise PhaseUnknown(reason)
    deltas, growth = compute_loss_angles(scene), compute_log_growths(scene)
    with threadpool_limits(1, user_api="blas"):
        try:
            middle = differentiate(scene, (deltas, growth))
            derivatives, third_order = _differentiate_phase(
                scene, middle, lambda times: differentiate(scale_moduli(scene, deltas, times), (deltas, growth))
            )
        except SolveError as fault:
            raise PhaseUnknown(f"its derivatives cannot be solved for: {fault}") from fault
    # the result may come from a finer model than the derivatives: the difference of both ratios counts as an error
    ratio_factor, spread = read.ratio / middle.ratio, compute_angle_spread(scene)
    error = HIGHER_ORDER_FACTOR * third_order
    if spread:
        log_error = abs(math.log(ratio_factor)) + math.log1p(read.error) if ratio_factor > 0 else math.inf
        inertia_error = INERTIA_ERROR_FACTOR * compute_inertia_number(scene, frequency)
        error += spread * (RATIO_ERROR_FACTOR * log_error + inertia_error)
    if not error <= MAX_PHASE_ERROR_RAD:  # also where it is NaN
        raise PhaseUnknown(f"its error would be {error:.2g} rad, above the allowed {MAX_PHASE_ERROR_RAD:g} rad")
    notes = () if any(deltas.values()) else (LOSSLESS_NOTE,)
    return RatioPhase(float(middle.directional[0]), float(error), derivatives | _differentiate_by_losses(scene, middle), notes)


def _differentiate_phase(
    scene: Scene, middle: LogDerivatives, differentiate: Callable[[float], LogDerivatives]
) -> tuple[dict[str, float], float]:
    """Return the phase's derivatives by eq. PH.3, and the sum of the sizes of the third-order terms of eq. PH.2.

    Parameters
    ----------
    scene
        The scene itself.
    middle
        Its derivatives, along the directions delta and v of eq. PH.2 in this order.
    differentiate
        Returns the derivatives after the logarithms of the moduli moved by the given multiple of the loss angles.
    """
    max_delta = max(compute_loss_angles(scene).values())
    if max_delta == 0:
        return dict.fromkeys(middle.derivatives, 0.0), 0.0
    h, numbers = STEP_RAD / max_delta, list_values(scene)
    plus, minus = differentiate(h), differentiate(-h)
    derivatives = {name: (plus.derivatives[name] - minus.derivatives[name]) / (2 * h) for name in middle.derivatives}
    derivatives = {
        name: derivative / (numbers[name] if name.endswith(MODULUS_SUFFIX) else 1.0) for name, derivative in derivatives.items()
    }
    # D2f[delta, v] and D3f[delta, delta, delta] as differences of Df[v] and Df[delta] along delta
    growth_term = (plus.directional[1] - minus.directional[1]) / (2 * h)
    cubic_term = (plus.directional[0] - 2 * middle.directional[0] + minus.directional[0]) / h**2
    return derivatives, abs(float(growth_term)) + abs(float(cubic_term)) / 6


def _differentiate_by_losses(scene: Scene, middle: LogDerivatives) -> dict[str, float]:
    """Return the phase's derivatives by the loss factors t = tan delta, rad.

    The phase's first term Df[delta] has the derivatives of f = ln(ratio) by ln E as factors, and d delta / dt = 1 / (1 + t^2).
    """
    losses = list_loss_factors(scene)
    derivatives = {key: middle.derivatives.get(key.replace(".loss_factor", MODULUS_SUFFIX)) for key in losses}
    return {key: derivative / (1 + losses[key] ** 2) for key, derivative in derivatives.items() if derivative is not None}
