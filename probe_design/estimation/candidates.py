"""List the candidates for the next reading: on or off the target's axis, with stiffness, baseline readings, the target's size.

In linear elasticity a reading at another load is the same reading, so that other loads are no candidates; a repetition is one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.common.errors import InputError
from geometry.scenes import fit
from geometry.scenes.scene import Placement, Scene
from probe_design.estimation.model import OF_TARGET, TargetModel
from probe_design.estimation.readings import Measurements, Reading

OFFSETS = (0.0, 0.4, 0.8, 1.2, 1.8)  # of the probe's axis from the target's, over the sum of depth and outer radius
ULTRASOUND = 0.05  # of a diameter or depth by ultrasound, 1 sd: assumed
LEARNED = ("inclusion.diameter", "inclusion.depth")


@dataclass(frozen=True)
class NextCandidate:
    """A reading or measurement that may be made next.

    Attributes:
        kind: "ratio", "ratio and stiffness", "blank", "blank with stiffness", or "size from ultrasound".
        reading: its place and noise; its values are placeholders. None for a size.
        learned: names of the scene's numbers that ultrasound measures.
    """

    kind: str
    reading: Reading | None = None
    learned: tuple[str, ...] = ()

    @property
    def told(self) -> str:
        """The candidate in words."""
        if self.reading is None:
            keys = " and ".join(name.removeprefix("inclusion.") for name in self.learned)
            return f"{keys} from ultrasound, to {100 * ULTRASOUND:g} %"
        what = "ratio and stiffness" if self.reading.stiffness else "ratio"
        if self.reading.blank:
            return f"{what} over tumour-free tissue (blank = true)"
        return f"{what} at x = {1e3 * self.reading.x:.4g} mm, y = {1e3 * self.reading.y:.4g} mm"


def candidates(model: TargetModel, unknown: str, nuisances: Mapping[str, float]) -> tuple[NextCandidate, ...]:
    """Return the candidates for the next reading; their noise is the smallest of the present readings.

    Args:
        model: with the present readings.
        unknown: as in ``probe_design.estimation.estimate``.
        nuisances: relative standard deviations by name.
    """
    data = model.data
    noise = float(data.noise[data.is_ratio].min())
    stiff = float(data.noise[data.is_stiffness].min()) if data.is_stiffness.any() else noise
    with_stiffness = (False, True) if model.stiffness_error <= stiff else (False,)
    found = []
    for also in with_stiffness:
        pair: tuple[float | None, float | None] = (1.0, stiff) if also else (None, None)
        if unknown in OF_TARGET:
            spots = (Reading(x, y, 1.0, noise, pair[0], pair[1]) for x, y in _places(model))
            found += [NextCandidate("ratio and stiffness" if also else "ratio", spot) for spot in spots]
        if nuisances or unknown not in OF_TARGET:
            x, y = data.places[0]
            blank = Reading(float(x), float(y), 1.0, noise, pair[0], pair[1], blank=True)
            found.append(NextCandidate("blank with stiffness" if also else "blank", blank))
    learned = tuple(name for name in LEARNED if nuisances.get(name, 0.0) > ULTRASOUND)
    return (*found, NextCandidate("size from ultrasound", None, learned)) if learned else tuple(found)


def _places(model: TargetModel) -> list[tuple[float, float]]:
    """Return places of the probe on the tissue along x, with several inclusions also along y; present places come first."""
    at, scene = model.target, model.scene
    reach = at.depth + scene.probe.tube_radius
    alone = len(scene.inclusion) == 1  # then readings depend on the distance alone
    ways = [(1.0, 0.0), (-1.0, 0.0)] if alone else [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    read = [(float(x), float(y)) for x, y in model.data.places]
    grid = [(at.x + a * share * reach, at.y + b * share * reach) for share in OFFSETS for a, b in ways]
    kept: list[tuple[float, float]] = []
    for place in (*read, *grid):
        distinct = [_apart(place, at.x, at.y, alone, other) > 1e-3 * reach for other in kept]
        if all(distinct) and _stands(scene, place):
            kept.append(place)
    return kept


def _apart(place: tuple[float, float], x: float, y: float, alone: bool, other: tuple[float, float]) -> float:
    """Return the distance between two places, or the difference of their distances from a single target, m."""
    if alone:
        return float(abs(np.hypot(place[0] - x, place[1] - y) - np.hypot(other[0] - x, other[1] - y)))
    return float(np.hypot(place[0] - other[0], place[1] - other[1]))


def _stands(scene: Scene, place: tuple[float, float]) -> bool:
    """Return whether the whole probe stands on the tissue at a place."""
    try:
        fit.check(scene.model_copy(update={"placement": Placement(x=place[0], y=place[1])}))
    except InputError:
        return False
    return True


def joined(data: Measurements, more: Measurements) -> Measurements:
    """Return both measurements joined; the sign of the new ratios counts as unknown."""
    places = list(dict.fromkeys([*map(tuple, data.places.tolist()), *map(tuple, more.places.tolist())]))
    place = [places.index(tuple(one.places[k].tolist())) for one in (data, more) for k in one.place]
    rest = {
        key: np.concatenate([getattr(data, key), getattr(more, key)])
        for key in ("is_stiffness", "is_phase", "is_blank", "value", "noise")
    }
    sign = np.concatenate([data.sign, np.zeros_like(more.sign)])
    return Measurements(places=np.array(places), place=np.array(place), sign=sign, **rest)
