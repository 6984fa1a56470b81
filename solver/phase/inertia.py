"""Whether a sinusoidal load is so slow that inertia, which is left out, does not matter.

Beside stiffness inertia is

    N = rho (2 pi f r)^2 / mu,   r the tube's radius, mu the softest tissue's shear modulus                (PH.4)

What moves far from the probe lifts or lowers the surface under both blocks alike, which their ratio does not show, as long as the
tissue as a whole does not swing: a wide layer of depth H begins to at a quarter of a shear wave's length,

    k H = pi / 2,   k = 2 pi f sqrt(rho / mu)                                                             (PH.5)
"""

from __future__ import annotations

import math

from geometry.common.errors import InputError, Words
from geometry.common.limits import most
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import FREQUENCY

DENSITY = 1100.0  # kg/m^3: tissue and elastomers
LARGEST = 0.5  # the largest N that is answered
STILL = 0.8  # of eq. PH.5: up to there the tissue does not swing


def inertia(scene: Scene, frequency: float) -> float:
    """Return N of eq. PH.4 at a frequency, Hz."""
    return (_wave_number(scene, frequency) * scene.probe.tube_radius) ** 2


def swinging(scene: Scene, frequency: float) -> str | None:
    """Return why the phase is not told where the tissue as a whole may swing at a frequency, Hz; None where it may not."""
    if scene.tissue.shape == "half-space":
        return None
    share = _wave_number(scene, frequency) * scene.tissue.depth / (math.pi / 2)
    if share <= STILL:
        return None
    limit = most(frequency * STILL / share, 2)
    return f"at {frequency:.4g} Hz tissue {mm(scene.tissue.depth)} deep may swing as a whole; up to {limit} Hz a phase is told"


def with_inertia(error: float | None, scene: Scene, frequency: float) -> float | None:
    """Return a ratio's relative error with what inertia may change of it, at most N: complex solutions with masses find 0.6 N."""
    return None if error is None else (1 + error) * (1 + inertia(scene, frequency)) - 1


def _wave_number(scene: Scene, frequency: float) -> float:
    """Of shear waves in the softest tissue, 1/m."""
    tissue = scene.tissue
    softest = min(one.youngs_modulus / (2 * (1 + one.poisson_ratio)) for one in (tissue, *tissue.layer))
    return 2 * math.pi * frequency * math.sqrt(DENSITY / softest)


def check_frequency(scene: Scene, frequency: float) -> None:
    """Raise ``InputError`` for a frequency (Hz) that is none, or at which inertia matters."""
    try:
        FREQUENCY.checked(frequency)
    except ValueError:
        raise InputError("frequency", frequency, FREQUENCY.allowed) from None
    number = inertia(scene, frequency)
    if number > LARGEST:
        limit = most(frequency * math.sqrt(LARGEST / number), 3)
        text = f"up to {limit} Hz: beyond it inertia, which is left out, matters beside the tissue's stiffness"
        raise InputError("frequency", Words(f"{frequency:.6g} Hz"), text)
