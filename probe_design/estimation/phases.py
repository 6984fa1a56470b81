"""Predict phases of the ratio with lossy materials, from the ratios of two scenes without losses.

With f, v and delta of eq. PH.2 of ``solver.phase``, the phase of a ratio r over any body u in the target's place is

    (f(x + v + delta) - f(x + v - delta)) / 2 = arg r(u) + D3f[delta, delta, delta] / 3 + ...              (ES.9)

where f(x + v +- delta) are ln ratios of scenes without losses, whose real moduli are larger or smaller; the body's modulus
changes with them. Both are predictions with error bounds, whose mean bounds the error of the half difference. The remainder is of
third order in the spread of the loss angles, and is taken as at most ``THIRD_ORDER_FACTOR`` times the cube of the spread; a phase
whose standard deviation is smaller is left out. The frequency must be so low that inertia is negligible, which readings do not
state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.scenes.scene import Scene
from geometry.scenes.variables import loss_factors
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.readings import Measurements
from solver.phase.losses import angles, spread, stiffened, stretches

THIRD = 0.25  # of the cube of the spread, rad: the largest in tests was 0.16, under a skin
UNUSED = "left out: every loss factor of the scene is 0, so that nothing can be concluded from a phase"


def usable(scene: Scene, data: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """Return the data without phases that the model cannot use, with notes: no losses, or too large loss angles."""
    if not data.is_phase.any():
        return data, ()
    if not any(loss_factors(scene).values()):
        return data.some(~data.is_phase), (f"{data.is_phase.sum()} phases {UNUSED}",)
    known = THIRD * spread(scene) ** 3
    useless = data.is_phase & (data.noise < known)
    if not useless.any():
        return data, ()
    why = f"at these loss factors the model's is good to {known:.2g} rad only, which is more than their sd"
    return data.some(~useless), (f"{useless.sum()} phases left out: {why}",)


def turned(scene: Scene) -> tuple[Scene, Scene]:
    """Return the stiffer and the softer scene of eq. ES.9."""
    grown = stiffened(scene, stretches(scene), 1.0)
    return stiffened(grown, angles(scene), 1.0), stiffened(grown, angles(scene), -1.0)


def turned_bodies(scene: Scene, target: Mapping[str, Floats]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return the bodies in the target's place for the stiffer and the softer scene of eq. ES.9."""
    number = scene.target
    if number is None or "youngs_modulus" not in target:
        return dict(target), dict(target)
    name = "inclusion" if len(scene.inclusion) == 1 else f"inclusion[{number}]"
    growth, turn = stretches(scene)[name], angles(scene)[name]
    moduli = target["youngs_modulus"] * np.exp(growth)
    above, below = (dict(target) | {"youngs_modulus": moduli * np.exp(sign * turn)} for sign in (1, -1))
    return above, below


def with_phases(found: Predicted, above: Predicted, below: Predicted, is_phase: Bools, spreading: float) -> Predicted:
    """Return predictions in which phases, eq. ES.9, replace the ratios that were predicted in their place.

    Args:
        predicted: for the scene itself.
        stiffer: predictions for the stiffer scene.
        softer: predictions for the softer scene.
        is_phase: which of the data are phases, shape (k,).
        angle_spread: spread of the loss angles, rad.
    """
    known = above.resolved & below.resolved
    chosen = known[:, None] & is_phase

    def of(key: str) -> Floats:
        rest = np.where(is_phase, 0.0, getattr(found, key))
        return np.where(chosen, (getattr(above, key) - getattr(below, key)) / 2, rest)

    bound = np.where(chosen, (above.bound + below.bound) / 2 + THIRD * spreading**3, np.where(is_phase, 0.0, found.bound))
    return replace(
        found,
        value=of("value"),
        by_modulus=of("by_modulus"),
        by_diameter=of("by_diameter"),
        bound=bound,
        resolved=found.resolved & known,
    )
