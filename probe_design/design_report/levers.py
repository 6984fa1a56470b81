"""What each improvement of the readings would bring with the probe that was found, by the closed form."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry.scenes.scene import Scene
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.optimisation.design_space import variables
from probe_design.populations.design_file import Design
from probe_design.populations.tables import MOST_POSITIONS

HALVED = {
    "white": "half the ratio's white noise", "gain": "half the gain error", "stiffness_white": "half the stiffness's white noise",
    "stiffness_gain": "half the stiffness's gain error", "charge": "half the charge noise",
}  # fmt: skip


def levers(design: Design, scene: Scene) -> dict[str, float]:
    """Return the objective of a scene's probe by what is done, ``as it is`` first."""
    asked = {"as it is": design}
    for key, words in HALVED.items():
        value = getattr(design.noise, key)
        if value > 0 and not (design.protocol.blank and key.endswith("gain")):
            asked[words] = _with(design, "noise", **{key: value / 2})
    protocol = design.protocol
    asked["without the stiffness" if protocol.stiffness else "stiffness read, too"] = _with(
        design, "protocol", stiffness=not protocol.stiffness
    )
    asked["without a blank" if protocol.blank else "with a blank"] = _with(design, "protocol", blank=not protocol.blank)
    places = protocol.places
    if 1 < len(places) <= MOST_POSITIONS // 2:
        more = np.linspace(places.min(), places.max(), 2 * len(places) - 1)
        asked["twice the positions"] = _with(design, "protocol", positions=tuple(more.tolist()))
    force = design.scene.load.force or design.limits.force
    if force:
        doubled = _with(design, "limits", force=2 * force)
        asked["twice the force allowed"] = doubled
    return {words: _value(one, scene) for words, one in asked.items()}


def _with(design: Design, table: str, **changes: Any) -> Design:
    return design.model_copy(update={table: getattr(design, table).model_copy(update=changes)})


def _value(design: Design, scene: Scene) -> float:
    probe = scene.probe
    steered = SteeredDesigns.of(design, probe.tube_radius)
    poisson = probe.inner.poisson_ratio, probe.outer.poisson_ratio
    return float(steered.real_values(variables(scene)[:, None], poisson)[0])
