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
from geometry.scenes.variables import list_loss_factors
from probe_design.estimation.measurements import Measurements
from probe_design.estimation.predictions import Predictions
from solver.phase.losses import compute_angle_spread, compute_log_growths, compute_loss_angles, scale_moduli

THIRD_ORDER_FACTOR = 0.25  # of the cube of the spread, rad: the largest in tests was 0.16, under a skin
UNUSED_REASON = "left out: every loss factor of the scene is 0, so that nothing can be concluded from a phase"


def select_usable(scene: Scene, data: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """Return the data without phases that the model cannot use, with notes: no losses, or too large loss angles."""
    if not data.is_phase.any():
        return data, ()
    if not any(list_loss_factors(scene).values()):
        return data.select(~data.is_phase), (f"{data.is_phase.sum()} phases {UNUSED_REASON}",)
    third_order_bound = THIRD_ORDER_FACTOR * compute_angle_spread(scene) ** 3
    is_useless = data.is_phase & (data.noise < third_order_bound)
    if not is_useless.any():
        return data, ()
    reason = f"at these loss factors the model's is good to {third_order_bound:.2g} rad only, which is more than their sd"
    return data.select(~is_useless), (f"{is_useless.sum()} phases left out: {reason}",)


def build_turned_scenes(scene: Scene) -> tuple[Scene, Scene]:
    """Return the stiffer and the softer scene of eq. ES.9."""
    grown_scene = scale_moduli(scene, compute_log_growths(scene), 1.0)
    return scale_moduli(grown_scene, compute_loss_angles(scene), 1.0), scale_moduli(grown_scene, compute_loss_angles(scene), -1.0)


def build_turned_bodies(scene: Scene, target: Mapping[str, Floats]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return the bodies in the target's place for the stiffer and the softer scene of eq. ES.9."""
    number = scene.target
    if number is None or "youngs_modulus" not in target:
        return dict(target), dict(target)
    name = "inclusion" if len(scene.inclusion) == 1 else f"inclusion[{number}]"
    growth, turn = compute_log_growths(scene)[name], compute_loss_angles(scene)[name]
    moduli = target["youngs_modulus"] * np.exp(growth)
    stiffer, softer = (dict(target) | {"youngs_modulus": moduli * np.exp(sign * turn)} for sign in (1, -1))
    return stiffer, softer


def insert_phases(
    predicted: Predictions, stiffer: Predictions, softer: Predictions, is_phase: Bools, angle_spread: float
) -> Predictions:
    """Return predictions in which phases, eq. ES.9, replace the ratios that were predicted in their place.

    Parameters
    ----------
    predicted
        For the scene itself.
    stiffer
        Predictions for the stiffer scene.
    softer
        Predictions for the softer scene.
    is_phase
        Which of the data are phases, shape (k,).
    angle_spread
        Spread of the loss angles, rad.
    """
    is_known = stiffer.resolved & softer.resolved
    is_known_phase = is_known[:, None] & is_phase

    def combine(key: str) -> Floats:
        values = np.where(is_phase, 0.0, getattr(predicted, key))
        return np.where(is_known_phase, (getattr(stiffer, key) - getattr(softer, key)) / 2, values)

    bound = np.where(
        is_known_phase,
        (stiffer.bound + softer.bound) / 2 + THIRD_ORDER_FACTOR * angle_spread**3,
        np.where(is_phase, 0.0, predicted.bound),
    )
    return replace(
        predicted,
        value=combine("value"),
        by_modulus=combine("by_modulus"),
        by_diameter=combine("by_diameter"),
        bound=bound,
        resolved=predicted.resolved & is_known,
    )
