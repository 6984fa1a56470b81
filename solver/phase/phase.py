"""Compute the phase of the ratio to first order in the loss angles, with a bound on the error.

f is ln(ratio) as a function of the logarithms x of all moduli, real where x is real. With v and delta of eq. PH.1 the phase is

    arg ratio = Im f(x + v + j delta) = Df[delta] + D2f[delta, v] - D3f[delta, delta, delta] / 6 + ...    (PH.2)

Each term is odd in all loss factors together: v is even, delta odd, and Im keeps the odd powers of j delta. So the error of
the first term is of third order, and falls to an eighth as all loss factors are halved. As f is known with its gradient, those
terms, and the derivative of the first by a number p of the scene, are differences of gradients along delta,

    d Df[delta] / dp = (f_p(x + h delta) - f_p(x - h delta)) / 2h + O(h^2)                                (PH.3)

with f_p the derivative of f by p and h a small number. f does not change where all moduli grow by the same factor: only
differences between loss angles count. The same holds for the error e of ln(ratio) by the mesh and by what the model leaves out.
It adds De[delta] to the phase, which is bounded by RATIO_ERROR_FACTOR |e| times the spread of the loss angles. Inertia relative
to stiffness, eq. PH.4, is bounded likewise with INERTIA_ERROR_FACTOR.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from geometry.common.errors import ProbeError, SolveError
from geometry.scenes.scene import Scene
from geometry.scenes.variables import loss_factors, values
from solver.phase.inertia import check_frequency, inertia, swinging
from solver.phase.losses import angles, spread, stiffened, stretches
from solver.phase.slopes import MODULUS, Slopes, sloped
from solver.results.result import Result
from solver.results.warnings import Note

STEP = 1e-2  # h of eq. PH.3 times the largest loss angle
HIGHER = 1.5  # times the sizes of the terms of third order: allows for higher orders
LOGARITHMIC, INERTIAL = 2.0, 2.0
CONTACT = "contact"  # the evaluator for whose results no phase is computed
LARGEST = 0.5  # above this error bound no phase is reported
LOSSLESS = Note("null", "all loss factors are 0, and with them ratio_phase")


class NotTold(ProbeError):  # noqa: N818 - says why
    """Raised where no phase can be computed; the text is the reason."""


@dataclass(frozen=True)
class RatioPhase:
    """The phase by which stress_inner leads stress_outer, counted from the sign of their elastic ratio.

    Attributes:
        value: rad.
        error: bound on its absolute error, rad.
        derivatives: by the scene's numbers and loss factors, rad per SI unit; keys as in ``geometry.scenes.variables``.
        notes: warnings.
    """

    value: float
    error: float
    derivatives: dict[str, float]
    notes: tuple[Note, ...] = ()

    @property
    def parts(self) -> dict[str, Any]:
        """The values by the suffix that is appended to the name ``ratio_phase``."""
        return {"": self.value, "_error": self.error, "_derivatives": self.derivatives}


def ratio_phase(scene: Scene, result: Result, accuracy: float, frequency: float) -> RatioPhase:
    """Compute the phase of the ratio under a small sinusoidal load, for which linear elasticity holds.

    Args:
        scene: with loss factors that hold at the frequency.
        result: the scene's result; its error, and its difference from the ratio computed here, count in the phase's error.
        accuracy: of the result; it sets the mesh's fineness.
        frequency: Hz; inertia depends on it, loss factors do not.

    Raises:
        InputError: a frequency at which inertia is not small.
        PhaseUnknown: the derivatives of this kind of scene are not known, or the error bound is above ``MAX_PHASE_ERROR_RAD``.
        LimitReached: see ``solver.evaluate``.
    """
    check_frequency(scene, frequency)
    moving = swinging(scene, frequency)
    if moving is not None:
        raise NotTold(moving)
    if result.ratio is None or result.error_estimate is None:
        raise NotTold("the ratio has to be known with its error")
    if result.evaluator == CONTACT:  # derivatives change with the load more than the ratio, which may return to its value
        raise NotTold("nothing is known of phases at finite strain and with contact")
    why, at = sloped(scene, accuracy)
    if why is not None:
        raise NotTold(why)
    turns, growth = angles(scene), stretches(scene)
    with threadpool_limits(1, user_api="blas"):
        try:
            middle = at(scene, (turns, growth))
            by, third = _changes(scene, middle, lambda times: at(stiffened(scene, turns, times), (turns, growth)))
        except SolveError as fault:
            raise NotTold(f"its derivatives cannot be solved for: {fault}") from fault
    apart = result.ratio / middle.ratio
    off = abs(math.log(apart)) + math.log1p(result.error_estimate) if apart > 0 else math.inf
    spreading = spread(scene) * (LOGARITHMIC * off + INERTIAL * inertia(scene, frequency)) if spread(scene) else 0.0
    error = HIGHER * third + spreading
    if not error <= LARGEST:
        raise NotTold(f"its error would be {error:.2g} rad, above the allowed {LARGEST:g} rad")
    notes = () if any(turns.values()) else (LOSSLESS,)
    return RatioPhase(float(middle.along[0]), float(error), by | _by_losses(scene, middle), notes)


def _changes(scene: Scene, middle: Slopes, at: Callable[[float], Slopes]) -> tuple[dict[str, float], float]:
    """Return the phase's derivatives by eq. PH.3, and the sum of the sizes of the third-order terms of eq. PH.2.

    Args:
        scene: the scene itself.
        middle: its derivatives.
        differentiate: returns the derivatives after the logarithms of the moduli moved by a multiple of the loss angles.
    """
    largest = max(angles(scene).values())
    if largest == 0:
        return dict.fromkeys(middle.by, 0.0), 0.0
    h, numbers = STEP / largest, values(scene)
    above, below = at(h), at(-h)
    by = {name: (above.by[name] - below.by[name]) / (2 * h) for name in middle.by}
    by = {name: slope / (numbers[name] if name.endswith(MODULUS) else 1.0) for name, slope in by.items()}
    stretched = (above.along[1] - below.along[1]) / (2 * h)
    cubic = (above.along[0] - 2 * middle.along[0] + below.along[0]) / h**2
    return by, abs(float(stretched)) + abs(float(cubic)) / 6


def _by_losses(scene: Scene, middle: Slopes) -> dict[str, float]:
    """Return the phase's derivatives by the loss factors t = tan delta: d delta / dt = 1 / (1 + t^2)."""
    losses = loss_factors(scene)
    slopes = {key: middle.by.get(key.replace(".loss_factor", MODULUS)) for key in losses}
    return {key: slope / (1 + losses[key] ** 2) for key, slope in slopes.items() if slope is not None}
