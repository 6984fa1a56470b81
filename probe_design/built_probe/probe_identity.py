"""What makes two scenes' probes one design: the numbers that a calibration, and a ratio that was read, rest on."""

from __future__ import annotations

import math
from collections.abc import Mapping

from geometry.scenes.scene import Scene
from geometry.scenes.variables import values
from probe_design.built_probe.block_predictions import by_outer_radius

CHARGE = "probe.film charge per force"
SAME = 1e-9  # relative, within which two numbers are the same


def probe_numbers(scene: Scene) -> dict[str, float]:
    """Return a probe's dimensions and moduli by their keys, SI, and its film's charge per force, C/N, where it has one."""
    numbers = {key: value for key, value in values(by_outer_radius(scene)).items() if key.startswith("probe.")}
    film = scene.probe.film
    return numbers if film is None else numbers | {CHARGE: film.charge_per_force}


def probe_difference(numbers: Mapping[str, float], scene: Scene) -> str | None:
    """Return in words the first number by which a probe differs from the scene's, or None.

    Args:
        numbers: of the probe, as ``probe_numbers`` returns them.
        scene: with the other probe.
    """
    wanted = probe_numbers(scene)
    for key, own in wanted.items():
        if key not in numbers:
            return f"{key} is not told there"
        if not math.isclose(numbers[key], own, rel_tol=SAME):
            return f"{key} is {numbers[key]:.6g} there and {own:.6g} in the scene, SI units"
    return None if numbers.keys() == wanted.keys() else "it has parts there that the scene's has not"
