"""Compute complex moduli of lossy materials, as changes of the logarithms of their storage moduli.

Under a sinusoidal load a storage modulus E' with the loss factor t = tan delta becomes a complex modulus E (the correspondence
principle: elastic solutions hold with complex moduli, Poisson's ratios being real),

    ln E = ln E' + v + j delta,     v = ln(1 + t^2) / 2,   delta = atan t                            (PH.1)

where j is the imaginary unit, delta the loss angle and v the growth of ln |E| by losses.
"""

from __future__ import annotations

import math

from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_bonds, list_loss_factors, list_materials

ValueOfMaterial = dict[
    str, float
]  # by the names "probe.inner", "tissue.layer[0]", "inclusion[1]", "probe.film.bond_to_base"; of all that can be lossy


def compute_loss_angles(scene: Scene) -> ValueOfMaterial:
    """Return the loss angle delta of eq. PH.1 of every material that can be lossy, rad."""
    return {_remove_key_suffix(key): math.atan(loss) for key, loss in list_loss_factors(scene).items()}


def compute_log_growths(scene: Scene) -> ValueOfMaterial:
    """Return the growth v of ln |E| by losses, eq. PH.1, of every material that can be lossy."""
    return {_remove_key_suffix(key): math.log1p(loss**2) / 2 for key, loss in list_loss_factors(scene).items()}


def compute_angle_spread(scene: Scene) -> float:
    """Return the difference of the largest and the smallest loss angle, rad; if it is 0, so is the ratio's phase.

    An elastic base and films are lossless: their loss angle is 0.
    """
    elastic = scene.probe.film is not None or not scene.probe.base.rigid
    deltas = [*compute_loss_angles(scene).values(), *([0.0] if elastic else [])]
    return max(deltas) - min(deltas)


def scale_moduli(scene: Scene, log_changes: ValueOfMaterial, times: float) -> Scene:
    """Return the scene with each material's Young's modulus E multiplied by exp(times * c), c its value in ``log_changes``."""
    moduli = {name: material.youngs_modulus for name, material in (list_materials(scene) | list_bonds(scene)).items()}
    return scene.replace(
        {
            f"{name}.youngs_modulus": (moduli[name] or 0.0) * math.exp(times * change)  # all of these have a modulus
            for name, change in log_changes.items()
        }
    )


def _remove_key_suffix(key: str) -> str:
    """Return the name of the material from the key of its loss factor."""
    return key.removesuffix(".loss_factor")
