"""What would help most: a lesser noise, another channel or more positions, each alone, for the same probe and tumours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.scenes.scene import Scene
from probe_design.populations.design_file import Design
from probe_design.populations.examination import Examination
from probe_design.populations.judge import Progress, examined
from probe_design.populations.judgement import Judgement
from probe_design.populations.tables import MOST_POSITIONS

NOISES = ("white", "gain", "stiffness_white", "stiffness_gain", "charge", "tilt")


@dataclass(frozen=True)
class Lever:
    """One thing that is done better.

    Attributes:
        name: what, such as ``white halved``.
        value: of the objective then.
        gain, error: how much more than without it, and the standard error of that.
    """

    name: str
    value: float
    gain: float
    error: float


def levers(scene: Scene, design: Design, *, unseen: bool = False, progress: Progress | None = None) -> tuple[Lever, ...]:
    """Compute the gain of each single improvement of the readings for a scene's probe; the first entry changes nothing.

    Args:
        scene: the design's scene, perhaps with another probe and load.
        design: what it is judged by.
        unseen: whether to ask the judge's level, of tumours that no search has seen; the formulas otherwise.
        progress: called with levers done and all.

    Raises:
        InputError: see ``judge.examine``.
        Refusal: likewise.
    """
    asked = list(_changed(design))
    whole = design if unseen else _widest(design, [other for _, other in asked])
    scan = examined(scene, whole, unseen=unseen)
    start = _under(scan, whole, design).judgement(design)
    found = [Lever("as it is", _value(start, design), 0.0, 0.0)]
    for number, (name, other) in enumerate(asked):
        if progress is not None:
            progress(number, len(asked))
        again = examined(scene, other, unseen=True) if unseen and other.protocol.positions != design.protocol.positions else scan
        better = (again if unseen else _under(scan, whole, other)).judgement(other)
        found.append(Lever(name, _value(better, design), *better.gain_over(start, design.objective)))
    if progress is not None:
        progress(len(asked), len(asked))
    return tuple(found)


def _widest(design: Design, asked: list[Design]) -> Design:
    """The design file with every position that is asked for: the formulas compute all changes at once."""
    return _with(design, "protocol", positions=max((one.protocol.positions for one in (design, *asked)), key=len))


def _under(scan: Examination, whole: Design, design: Design) -> Examination:
    """Return the part of a scan that is read at the positions of a design's protocol."""
    apart = np.abs(design.protocol.places[:, None] - whole.protocol.places)
    return scan.part(apart.argmin(axis=1), "both")


def _value(judgement: Judgement, design: Design) -> float:
    return float(getattr(judgement, design.objective.maximise))


def _changed(design: Design) -> Iterator[tuple[str, Design]]:
    """Name each lever and yield the design with it."""
    noise, protocol = design.noise, design.protocol
    for key in NOISES:
        counts = not (protocol.blank and key.endswith("gain")) and (protocol.stiffness or not key.startswith("stiffness"))
        if getattr(noise, key) and counts and not (key == "gain" and noise.calibration):
            yield f"{key} halved", _with(design, "noise", **{key: getattr(noise, key) / 2})
    if not protocol.stiffness:
        yield "stiffness read", _with(design, "protocol", stiffness=True)
    if not protocol.blank:
        yield "blank read", _with(design, "protocol", blank=True)
    places, more = protocol.places, 2 * len(protocol.positions) - 1
    if len(places) > 1 and more <= MOST_POSITIONS:
        between = np.interp(np.arange(more) / 2, np.arange(len(places)), places)
        yield f"{more} positions", _with(design, "protocol", positions=tuple(between.tolist()))


def _with(design: Design, table: str, **new: Any) -> Design:
    return design.model_copy(update={table: getattr(design, table).model_copy(update=new)})
