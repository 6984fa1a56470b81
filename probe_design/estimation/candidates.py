"""List the candidates for the next reading: on or off the target's axis, with stiffness, baseline readings, the target's size.

In linear elasticity a reading at another load is the same reading, so that other loads are no candidates; a repetition is one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.common.errors import InputError
from geometry.scenes import fit_check
from geometry.scenes.scene import Placement, Scene
from probe_design.estimation.measurements import Reading
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel

RELATIVE_OFFSETS = (0.0, 0.4, 0.8, 1.2, 1.8)  # of the probe's axis from the target's, over the sum of depth and outer radius
ULTRASOUND_RELATIVE_SD = 0.05  # of a diameter or depth by ultrasound, 1 sd: assumed
ULTRASOUND_NUMBERS = ("inclusion.diameter", "inclusion.depth")


@dataclass(frozen=True)
class NextCandidate:
    """A reading or measurement that may be made next.

    Attributes
    ----------
    kind
        "ratio", "ratio and stiffness", "blank", "blank with stiffness", or "size from ultrasound".
    reading
        Its place and noise; its values are placeholders. None for a size.
    learned
        Names of the scene's numbers that ultrasound measures.
    """

    kind: str
    reading: Reading | None = None
    learned: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """The candidate in words."""
        if self.reading is None:
            keys = " and ".join(name.removeprefix("inclusion.") for name in self.learned)
            return f"{keys} from ultrasound, to {100 * ULTRASOUND_RELATIVE_SD:g} %"
        quantity = "ratio and stiffness" if self.reading.stiffness else "ratio"
        if self.reading.blank:
            return f"{quantity} over tumour-free tissue (blank = true)"
        return f"{quantity} at x = {1e3 * self.reading.x:.4g} mm, y = {1e3 * self.reading.y:.4g} mm"


def list_candidates(model: TargetModel, unknown: str, nuisances: Mapping[str, float]) -> tuple[NextCandidate, ...]:
    """Return the candidates for the next reading; their noise is the smallest of the present readings.

    Parameters
    ----------
    model
        With the present readings.
    unknown
        As in ``probe_design.estimation.estimate``.
    nuisances
        Relative standard deviations by name.
    """
    data = model.data
    noise = float(data.noise[data.is_ratio].min())
    stiffness_noise = float(data.noise[data.is_stiffness].min()) if data.is_stiffness.any() else noise
    stiffness_choices = (False, True) if model.stiffness_error <= stiffness_noise else (False,)
    choices = []
    for has_stiffness in stiffness_choices:
        stiffness_pair: tuple[float | None, float | None] = (1.0, stiffness_noise) if has_stiffness else (None, None)
        if unknown in TARGET_UNKNOWNS:
            spots = (Reading(x, y, 1.0, noise, stiffness_pair[0], stiffness_pair[1]) for x, y in _list_places(model))
            choices += [NextCandidate("ratio and stiffness" if has_stiffness else "ratio", spot) for spot in spots]
        if nuisances or unknown not in TARGET_UNKNOWNS:
            x, y = data.places[0]
            blank = Reading(float(x), float(y), 1.0, noise, stiffness_pair[0], stiffness_pair[1], blank=True)
            choices.append(NextCandidate("blank with stiffness" if has_stiffness else "blank", blank))
    learned = tuple(name for name in ULTRASOUND_NUMBERS if nuisances.get(name, 0.0) > ULTRASOUND_RELATIVE_SD)
    return (*choices, NextCandidate("size from ultrasound", None, learned)) if learned else tuple(choices)


def _list_places(model: TargetModel) -> list[tuple[float, float]]:
    """Return places of the probe on the tissue along x, with several inclusions also along y; present places come first."""
    target, scene = model.target, model.scene
    reach = target.depth + scene.probe.tube_radius
    is_alone = len(scene.inclusion) == 1  # then readings depend on the distance alone
    directions = [(1.0, 0.0), (-1.0, 0.0)] if is_alone else [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    read = [(float(x), float(y)) for x, y in model.data.places]
    grid = [(target.x + a * offset * reach, target.y + b * offset * reach) for offset in RELATIVE_OFFSETS for a, b in directions]
    places: list[tuple[float, float]] = []
    for place in (*read, *grid):
        distinct = [_compute_separation(place, target.x, target.y, is_alone, chosen) > 1e-3 * reach for chosen in places]
        if all(distinct) and _is_on_tissue(scene, place):
            places.append(place)
    return places


def _compute_separation(
    place: tuple[float, float], x: float, y: float, is_alone: bool, other_place: tuple[float, float]
) -> float:
    """Return the distance between two places, or the difference of their distances from a single target, m."""
    if is_alone:
        return float(abs(np.hypot(place[0] - x, place[1] - y) - np.hypot(other_place[0] - x, other_place[1] - y)))
    return float(np.hypot(place[0] - other_place[0], place[1] - other_place[1]))


def _is_on_tissue(scene: Scene, place: tuple[float, float]) -> bool:
    """Return whether the whole probe stands on the tissue at a place."""
    try:
        fit_check.check_bodies_fit(scene.model_copy(update={"placement": Placement(x=place[0], y=place[1])}))
    except InputError:
        return False
    return True
