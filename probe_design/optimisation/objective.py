"""The objective: the standard deviation of ln E_object that one reading of the ratio leaves.

With g the noise of the ratio, half of its variance from each channel, and Q_j = |d33| F_j the charge of channel j under the force
that ``pressing`` allows the design (PHYSICS section 2),

    v_j = g^2 / 2 + (q0 / Q_j)^2                    (OP.1)
    I   = S^2 / (v_inner + v_outer)                 (OP.2)
    objective = I^(-1/2), smaller is better         (OP.3)

with S the log-sensitivity of the ratio. A raw slope d(ratio)/dE would reward designs whose outer film feels nothing, and so
nothing but noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from geometry.scenes.scene import Scene
from probe_design.data.noise import DEFAULT_NOISE, check_noise, compute_channel_noise


@dataclass(frozen=True)
class Noise:
    """What limits a reading.

    Attributes:
        ratio: relative standard deviation of one reading of the ratio, see ``probe_design.data.noise``.
        charge: charge noise of each channel, C.
        charge_per_force: |d33| of the films, C/N.

    Raises:
        InputError: the noise of the ratio is not allowed, see ``check_noise``.
    """

    ratio: float = DEFAULT_NOISE
    charge: float = 0.01e-12
    charge_per_force: float = 20e-12

    def __post_init__(self) -> None:
        """Refuse what is no noise."""
        check_noise(self.ratio)

    @classmethod
    def from_scene(cls, scene: Scene, ratio: float = DEFAULT_NOISE) -> Noise:
        """Return the noise of a scene's probe, with its own film where it has one."""
        film = scene.probe.film
        return cls(ratio, charge_per_force=abs(film.d33) or cls.charge_per_force if film else cls.charge_per_force)

    def compute_information(self, sensitivity: Any, share_inner: Any, force: Any) -> Any:
        """Return the information of one reading about ln E_object (eqs. OP.1, OP.2); floats, arrays or casadi.

        ``share_inner`` is the inner film's fraction of ``force``, N; the outer film has the rest.
        """
        full = self.charge / (self.charge_per_force * force)
        variance = 2 * compute_channel_noise(self.ratio) ** 2 + (full / share_inner) ** 2 + (full / (1 - share_inner)) ** 2
        return sensitivity**2 / variance


def standard_deviation(information: float) -> float:
    """Return the standard deviation of ln E_object from the information (eq. OP.3); inf where that is 0."""
    return 1 / math.sqrt(information) if information > 0 else math.inf
