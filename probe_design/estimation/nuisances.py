"""Numbers of the scene that are known only roughly, such as a skin's thickness: what they add to the readings' errors.

The logarithm of such a number theta_j is normal about the scene's with standard deviation t_j. Where it is eta_j of them off, the
predictions m(u, theta) are parabolas through three scenes,

    y = m(u) + J(u) eta + C(u) eta^2 + noise,   J_j = (m(u, theta_j e^t_j) - m(u, theta_j e^-t_j)) / 2,
    C_j = (m(u, theta_j e^t_j) + m(u, theta_j e^-t_j)) / 2 - m(u)                                       (ES.7)

so that readings at several places, a tumour-free spot among them, share errors: ``shared_errors.py``. What two of these numbers
do together beyond the sum of both is left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, ProbeError, Words, one_of
from geometry.scenes.scene import Scene
from geometry.scenes.units import fraction
from geometry.scenes.variables import loss_factors, values
from probe_design.estimation.model import TargetModel
from probe_design.estimation.shared_errors import SharedErrors

LARGEST = 1.0  # standard deviation of a logarithm: a straight line says nothing of more
ALLOWED = f"a relative standard deviation above 0 and up to {LARGEST:g}, such as 0.2 or 20 %"


@dataclass(frozen=True)
class Spread:
    """What nuisances add along an unknown.

    Attributes:
        x: coordinates of the unknown, increasing, shape (n,); between them lie straight lines.
        errors: eq. ES.7 there, shapes (n, k, q).
    """

    x: Floats
    errors: SharedErrors

    def at(self, x: Floats) -> SharedErrors:
        """Return eq. ES.7 at points of shape (s,): shapes (s, k, q)."""
        weights = np.stack([np.interp(x, self.x, row) for row in np.eye(len(self.x))], axis=1)
        return SharedErrors(*(np.tensordot(weights, part, axes=1) for part in (self.errors.line, self.errors.bend)))


def deviation(key: str, value: Any) -> float:
    """Read a relative standard deviation, 0.2 or "20 %".

    Raises:
        InputError: it is none.
    """
    deviation = fraction(key, value, ALLOWED)
    if not 0 < deviation <= LARGEST:
        raise InputError(key, value, ALLOWED)
    return deviation


def checked(scene: Scene, given: Mapping[str, Any], unknown: str) -> dict[str, float]:
    """Return relative standard deviations by names of the scene's numbers.

    Raises:
        InputError: the scene has no such number, or it is the unknown, or what is said of it is no standard deviation.
    """
    asked = f"inclusion.{unknown}" if len(scene.inclusion) == 1 else unknown
    lossy = [name for name, loss in loss_factors(scene).items() if loss]
    allowed = [name for name in (*values(scene), *lossy) if name not in (asked, unknown) and not name.endswith("poisson_ratio")]
    for name in given:
        if name not in allowed:
            raise InputError("nuisance", name, one_of(name, allowed))
    return {name: deviation(f"nuisance.{name}", value) for name, value in given.items()}


def spread(model: TargetModel, nuisances: Mapping[str, float], x: Floats, target: dict[str, Floats]) -> Spread:
    """Return what nuisances add to predictions of a model for targets whose coordinates along the unknown are x.

    Raises:
        InputError: one standard deviation off there is no such scene, or the model cannot tell what is read.
    """
    middle = model.predict(target)
    line, bend = [], []
    for name, sd in nuisances.items():
        above, below = (_varied(model, name, sd * sign).predict(target) for sign in (1.0, -1.0))
        alike = (above.agrees == middle.agrees) & (below.agrees == middle.agrees)  # or logarithms are of ratios of either sign
        if not (above.resolved & below.resolved & alike).all():
            raise InputError(f"nuisance.{name}", sd, "a smaller one: the model cannot tell what is read where it is so far off")
        line.append((above.value - below.value) / 2)
        bend.append((above.value + below.value) / 2 - middle.value)
    return Spread(x, SharedErrors(np.stack(line, axis=-1), np.stack(bend, axis=-1)))


def _varied(model: TargetModel, name: str, logarithm: float) -> TargetModel:
    """The model of a scene with one number larger or smaller."""
    value = (values(model.scene) | loss_factors(model.scene))[name] * math.exp(logarithm)
    try:
        return model.changed({name: value})
    except (ProbeError, ValueError) as fault:
        why = f"one that leaves {name} = {value:.4g} possible ({fault})"
        raise InputError(f"nuisance.{name}", Words(f"{abs(logarithm):g}"), why) from None
