"""The objective: the standard deviation of ln E_object that one reading of the ratio leaves.

With Q_j = |d33| F_j the charge of channel j under the force F (PHYSICS section 2),

    v_j = g^2 + (q0 / Q_j)^2                        (OP.1)
    I   = S^2 / (v_inner + v_outer)                 (OP.2)
    objective = I^(-1/2), smaller is better         (OP.3)

with S the log-sensitivity of the ratio; over a set of scenarios, I is averaged. A raw slope
d(ratio)/dE would reward designs whose outer film feels nothing, and so nothing but noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from geometry.scenes.scene import Scene
from solver.results.result import Result


@dataclass(frozen=True)
class Noise:
    """What limits a reading.

    Attributes:
        gain: relative error of each channel; the default is the paper's "about 5 %".
        charge: charge noise of each channel, C.
        force: force on the base, N.
        charge_per_force: |d33| of the films, C/N.
    """

    gain: float = 0.05
    charge: float = 0.01e-12
    force: float = 0.1
    charge_per_force: float = 20e-12

    @classmethod
    def of(cls, scene: Scene) -> Noise:
        """Return the defaults with the scene's own force and film where it has them."""
        force = scene.load.force or cls.force
        film = scene.probe.film
        return cls(force=force, charge_per_force=abs(film.d33) or cls.charge_per_force if film else cls.charge_per_force)

    def information(self, sensitivity: Any, share_inner: Any, share_outer: Any) -> Any:
        """Eqs. OP.1, OP.2 for the films' shares of the force, which add up to 1; floats, arrays or casadi."""
        full = self.charge / (self.charge_per_force * self.force)
        variance = 2 * self.gain**2 + (full / share_inner) ** 2 + (full / share_outer) ** 2
        return sensitivity**2 / variance


def objective(information: Iterable[float]) -> float:
    """Eq. OP.3 over a set of scenarios; inf where nothing can be told."""
    values = list(information)
    mean = sum(values) / len(values)
    return 1 / math.sqrt(mean) if mean > 0 else math.inf


def objective_of(scene: Scene, result: Result) -> float:
    """Return the objective of one evaluated scene; inf where the evaluator could not tell the sensitivity."""
    if result.log_sensitivity is None or not result.ratio:
        return math.inf
    forces = result.ratio * scene.probe.inner_area / scene.probe.outer_area  # inner over outer, also at zero load
    shares = (forces / (1 + forces), 1 / (1 + forces))
    return objective([Noise.of(scene).information(result.log_sensitivity, *shares)])
