"""Check that a sinusoidal load is so slow that inertia, which the model leaves out, is small.

The ratio of inertia to stiffness is, with density rho and frequency f,

    N = rho (2 pi f r)^2 / mu,   r the tube's radius, mu the softest tissue's shear modulus                (PH.4)

Motion far from the probe lifts or lowers the surface under both blocks equally, which does not change their ratio, unless the
tissue as a whole resonates. A wide layer of depth H resonates where H is a quarter of the shear wave's length, 2 pi / k,

    k H = pi / 2,   k = 2 pi f sqrt(rho / mu)                                                             (PH.5)
"""

from __future__ import annotations

import math

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_maximum
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import FREQUENCY_QUANTITY
from solver.materials.linear import Isotropic
from solver.results.result import combine_errors

TISSUE_DENSITY_KG_M3 = 1100.0  # kg/m^3: tissue and elastomers
MAX_INERTIA_NUMBER = 0.5  # of eq. PH.4: larger ones are refused
MAX_SWING_SHARE = 0.8  # of the frequency of eq. PH.5: up to there the tissue does not swing


def compute_inertia_number(scene: Scene, frequency: float) -> float:
    """Return the ratio of inertia to stiffness, N of eq. PH.4, at a frequency, Hz."""
    return (_compute_wave_number(scene, frequency) * scene.probe.tube_radius) ** 2


def find_swing_refusal(scene: Scene, frequency: float) -> str | None:
    """Return why no phase is computed if the tissue as a whole may resonate at a frequency, Hz; None if it cannot."""
    if scene.tissue.shape == "half-space":
        return None
    resonance_fraction = _compute_wave_number(scene, frequency) * scene.tissue.depth / (math.pi / 2)
    if resonance_fraction <= MAX_SWING_SHARE:
        return None
    limit = format_maximum(frequency * MAX_SWING_SHARE / resonance_fraction, 2)
    return f"at {frequency:.4g} Hz tissue {format_mm(scene.tissue.depth)} deep may swing as a whole; allowed is up to {limit} Hz"


def add_inertia_error(error: float | None, scene: Scene, frequency: float) -> float | None:
    """Add the effect of inertia, at most N of eq. PH.4, to a ratio's relative error bound.

    Solutions with complex moduli and masses give changes of up to 0.6 N. ``frequency`` is in Hz; an ``error`` of None is unknown.
    """
    return combine_errors(error, compute_inertia_number(scene, frequency))


def _compute_wave_number(scene: Scene, frequency: float) -> float:
    """Return k of eq. PH.5, the wave number of shear waves in the softest tissue, 1/m."""
    tissue = scene.tissue
    softest = min(Isotropic.from_material(material).shear_modulus for material in (tissue, *tissue.layer))
    return 2 * math.pi * frequency * math.sqrt(TISSUE_DENSITY_KG_M3 / softest)


def check_frequency(scene: Scene, frequency: float) -> None:
    """Raise ``InputError`` for an invalid frequency (Hz), or one at which inertia is not small."""
    try:
        FREQUENCY_QUANTITY.check(frequency)
    except ValueError:
        raise InputError("frequency", frequency, FREQUENCY_QUANTITY.allowed) from None
    number = compute_inertia_number(scene, frequency)
    if number > MAX_INERTIA_NUMBER:
        limit = format_maximum(frequency * math.sqrt(MAX_INERTIA_NUMBER / number), 3)
        text = f"up to {limit} Hz: above it inertia, which is left out, is not small compared with the tissue's stiffness"
        raise InputError("frequency", Words(f"{frequency:.6g} Hz"), text)
