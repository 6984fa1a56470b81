"""Predictions of the measured data, with derivatives and error bounds, for many bodies in the target's place.

A phase of the ratio, in a scene with lossy materials, is predicted from the ratios of two scenes without losses. With f, v and
delta of eq. PH.2 of ``solver.phase``, the phase of a ratio r over any body u in the target's place is

    (f(x + v + delta) - f(x + v - delta)) / 2 = arg r(u) + D3f[delta, delta, delta] / 3 + ...              (ES.9)

where f(x + v +- delta) are ln ratios of scenes without losses, whose real moduli are larger or smaller; the body's modulus
changes with them. Both are predictions with error bounds, whose mean bounds the error of the half difference. The remainder is of
third order in the spread of the loss angles, and is taken as at most ``THIRD_ORDER_FACTOR`` times the cube of the spread; a phase
whose standard deviation is smaller is left out. The frequency must be so low that inertia is negligible, which readings do not
state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_loss_factors
from probe_design.estimation.measurements import Measurements
from solver.equivalent_inclusion.readings import Readings
from solver.phase.losses import compute_angle_spread, compute_log_growths, compute_loss_angles, scale_moduli

MAX_LOG_RATIO_ERROR = 0.3  # bodies with a larger error bound of ln ratio are not searched
THIRD_ORDER_FACTOR = 0.25  # of the cube of the spread, rad: the largest in tests was 0.16, under a skin


@dataclass(frozen=True)
class Predictions:
    """Predictions for n bodies.

    Attributes
    ----------
    value
        Ln |ratio|, ln stiffness or phase, in the order of ``Measurements``, shape (n, k); 0 where ``resolved`` is false.
    by_modulus
        Derivatives of ``value`` with respect to ln E_object, shape (n, k).
    by_diameter
        Derivatives with respect to ln diameter, 0 unless requested, shape (n, k).
    bound
        Bound on the model's error of ``value``, shape (n, k).
    resolved
        Whether the error bounds of all ratios are at most ``MAX_LOG_RATIO_ERROR``, shape (n,).
    agrees
        Whether all ratios have the sign that was measured, shape (n,).
    """

    value: Floats
    by_modulus: Floats
    by_diameter: Floats
    bound: Floats
    resolved: Bools
    agrees: Bools

    @property
    def usable(self) -> Bools:
        """Whether both ``resolved`` and ``agrees`` hold, shape (n,)."""
        return self.resolved & self.agrees

    @classmethod
    def empty(cls, n: int, k: int, resolved: bool = True) -> Predictions:
        """Return zeros for n bodies and k data, to be filled in; ``resolved=False`` for bodies that cannot be predicted."""
        value, by_modulus, by_diameter, bound = np.zeros((4, n, k))
        return cls(value, by_modulus, by_diameter, bound, resolved=np.full(n, resolved), agrees=np.ones(n, dtype=bool))

    def select_rows(self, which: Ints) -> Predictions:
        """Return the predictions for the bodies with indices ``which``."""
        return Predictions(*(getattr(self, field.name)[which] for field in fields(self)))

    def transform_columns(self, function: Callable[[Floats], Floats]) -> Predictions:
        """Return the predictions with a function applied to each array of shape (n, k), such as a selection of columns."""
        value, by_modulus, by_diameter, bound = map(function, (self.value, self.by_modulus, self.by_diameter, self.bound))
        return replace(self, value=value, by_modulus=by_modulus, by_diameter=by_diameter, bound=bound)

    @classmethod
    def join(cls, parts: Sequence[Predictions]) -> Predictions:
        """Return the predictions for all bodies of all parts."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def fill(self, k: int, film_readings: Readings, rows: slice, data: Measurements, observable: Readings) -> None:
        """Set datum k of all bodies from computed readings.

        Parameters
        ----------
        k
            Index of the datum.
        film_readings
            Computed for several bodies and places.
        rows
            Which of them belong to the datum's place: n, or one for all bodies.
        data
            Give the kind and the sign of the datum.
        observable
            What ratios are read of: the readings themselves, or their charges.
        """
        is_stiffness = bool(data.is_stiffness[k])
        for key, derivatives in (("youngs_modulus", self.by_modulus), ("diameter", self.by_diameter)):
            if key in film_readings.derivatives:
                derivatives[:, k] = (
                    film_readings.compute_log_stiffness_derivative(key)[rows]
                    if is_stiffness
                    else observable.compute_log_ratio_derivative(key)[rows]
                )
        if is_stiffness:
            self.value[:, k] = np.log(film_readings.stiffness)[rows]
            self.bound[:, k] = (film_readings.bound.sum(axis=1) / film_readings.stiffness)[rows]
            return
        resolved, ratio = (observable.log_ratio_bound <= MAX_LOG_RATIO_ERROR)[rows], observable.ratio[rows]
        self.value[:, k] = np.log(np.abs(np.where(resolved, ratio, 1.0)))
        self.bound[:, k] = np.where(resolved, observable.log_ratio_bound[rows], 0.0)
        self.resolved[:] &= resolved
        # a sign of 0 is unknown, and agrees with any
        self.agrees[:] &= np.where(resolved & (data.sign[k] != 0), np.sign(ratio) == data.sign[k], True)


def select_usable(scene: Scene, data: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """Return the data without the phases that the model cannot use, and notes that say why.

    Phases are useless in a scene without losses, and where the loss angles are too different for eq. ES.9.
    """
    if not data.is_phase.any():
        return data, ()
    if not any(list_loss_factors(scene).values()):
        reason = "left out: every loss factor of the scene is 0, so that nothing can be concluded from a phase"
        return data.select(~data.is_phase), (f"{data.is_phase.sum()} phases {reason}",)
    third_order_bound = THIRD_ORDER_FACTOR * compute_angle_spread(scene) ** 3
    is_useless = data.is_phase & (data.noise < third_order_bound)
    if not is_useless.any():
        return data, ()
    reason = f"at these loss factors a phase is predicted within {third_order_bound:.2g} rad only, which is more than their sd"
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

    def insert(key: str, of_phases: Floats) -> Floats:
        """Return an array of ``predicted`` in which the values of phases replace those in their columns; 0 if unknown."""
        return np.where(is_known_phase, of_phases, np.where(is_phase, 0.0, getattr(predicted, key)))

    value, by_modulus, by_diameter = (
        insert(key, (getattr(stiffer, key) - getattr(softer, key)) / 2) for key in ("value", "by_modulus", "by_diameter")
    )
    bound = insert("bound", (stiffer.bound + softer.bound) / 2 + THIRD_ORDER_FACTOR * angle_spread**3)
    resolved = predicted.resolved & is_known
    return Predictions(value, by_modulus, by_diameter, bound, resolved, predicted.agrees)
