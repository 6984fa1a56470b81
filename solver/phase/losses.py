"""Complex moduli of lossy materials, as changes of the logarithms of their storage moduli.

Under a sinusoidal load a storage modulus E' with the loss factor t = tan delta becomes a complex modulus E (the correspondence
principle: elastic solutions hold with complex moduli, Poisson's ratios being real),

    ln E = ln E' + v + j delta,     v = ln(1 + t^2) / 2,   delta = atan t                            (PH.1)
"""

from __future__ import annotations

import math

from geometry.scenes.scene import Scene
from geometry.scenes.variables import BLOCKS, loss_factors

Turns = dict[str, float]  # by the materials' names, "probe.inner", "tissue.layer[0]", "inclusion[1]"; of all that can be lossy


def angles(scene: Scene) -> Turns:
    """Return the loss angle delta of eq. PH.1 of every material that can be lossy, rad."""
    return {_owner(key): math.atan(loss) for key, loss in loss_factors(scene).items()}


def stretches(scene: Scene) -> Turns:
    """Return the growth v of ln |E| by losses, eq. PH.1, of every material that can be lossy."""
    return {_owner(key): math.log1p(loss**2) / 2 for key, loss in loss_factors(scene).items()}


def spread(scene: Scene) -> float:
    """Return the largest less the smallest loss angle, rad; where it is 0, so is the ratio's phase.

    An elastic base and films are lossless: their loss angle is 0.
    """
    elastic = scene.probe.film is not None or not scene.probe.base.rigid
    every = [*angles(scene).values(), *([0.0] if elastic else [])]
    return max(every) - min(every)


def stiffened(scene: Scene, by: Turns, times: float) -> Scene:
    """Return a scene whose moduli are multiplied by exp(times * by), ``log_changes`` a number for each material."""

    def grown(name: str, body: object) -> dict[str, float]:
        return {"youngs_modulus": body.youngs_modulus * math.exp(times * by[name])}  # type: ignore[attr-defined]

    probe, tissue, alone = scene.probe, scene.tissue, len(scene.inclusion) == 1
    blocks = {key: getattr(probe, key).model_copy(update=grown(f"probe.{key}", getattr(probe, key))) for key in BLOCKS}
    layers = (one.model_copy(update=grown(f"tissue.layer[{k}]", one)) for k, one in enumerate(tissue.layer))
    bodies = (
        one.model_copy(update=grown("inclusion" if alone else f"inclusion[{k}]", one)) for k, one in enumerate(scene.inclusion)
    )
    return scene.model_copy(
        update={
            "probe": probe.model_copy(update=blocks),
            "tissue": tissue.model_copy(update={"layer": tuple(layers), **grown("tissue", tissue)}),
            "inclusion": tuple(bodies),
        }
    )


def _owner(key: str) -> str:
    return key.removesuffix(".loss_factor")
