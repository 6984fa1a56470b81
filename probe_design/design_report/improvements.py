"""Compute the gain of each single improvement (less noise, another channel, more positions) for the same probe and tumours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.populations.design_file import Design
from probe_design.populations.examination import examine
from probe_design.populations.performance import Performance
from probe_design.populations.tables import MAX_POSITIONS, MAX_RASTER_LINES

NOISE_LABELS = {
    "white": "the noise of the ratio", "gain": "the error of the gains", "stiffness_white": "the noise of the stiffness",
    "stiffness_gain": "the error of all stiffnesses together", "charge": "the noise of the charges", "tilt": "the error by tilt",
}  # fmt: skip


@dataclass(frozen=True)
class Improvement:
    """A single improvement of the readings.

    Attributes
    ----------
    name
        Name of the improvement, such as ``white halved``.
    value
        Value of the objective with it.
    gain, error
        Gain in the objective, and its standard error.
    label
        The improvement in plain words.
    resolved
        Fraction of the tumours whose stiffness is resolved with it.
    """

    name: str
    value: float
    gain: float
    error: float
    label: str = ""
    resolved: float = 0.0


def compute_improvements(scene: Scene, design: Design) -> tuple[Improvement, ...]:
    """Compute by the closed form the gain of each single improvement of a probe's readings; the first changes nothing.

    Parameters
    ----------
    scene
        The design's scene, perhaps with another probe and load.
    design
        Design with population, protocol, noise and objective.

    Raises
    ------
    InputError, Refusal
        See ``examination.examine``.
    """
    changes = {name: (label, changed) for name, label, changed in _iterate_changes(design)}
    positions = max(
        (changed.protocol.positions for changed in (design, *(changed for _, changed in changes.values()))), key=len
    )  # contain all others
    widest = _replace_table(design, "protocol", positions=positions)
    scan, maximise = examine(scene, widest), design.objective.maximise

    def evaluate(changed: Design, force_factor: float = 1.0) -> Performance:
        """Return the performance with a changed design, from the readings at those of the scan's positions that it uses."""
        y = scene.placement.y
        distances = np.linalg.norm(changed.protocol.list_places(y)[:, None] - widest.protocol.list_places(y), axis=-1)
        load = Load(force=force_factor * (scene.load.force or 0.0)) if scene.load.force else scene.load
        changed = _replace_table(changed, "protocol", loads=tuple(force_factor * force for force in changed.protocol.loads))
        pressed = replace(scan, draw=replace(scan.draw, scene=scan.draw.scene.model_copy(update={"load": load})))
        return pressed.select(distances.argmin(axis=1), "both").evaluate(changed)

    start = evaluate(design)

    def compare(name: str, label: str, better: Performance) -> Improvement:
        """Return an improvement from the performance with it."""
        gain, error = better.compute_gain(start, design.objective)
        return Improvement(name, better.means[maximise], gain, error, label, better.means["resolved"])

    results = [Improvement("as it is", start.means[maximise], 0.0, 0.0, "as it is", start.means["resolved"])]
    results += [compare(name, label, evaluate(changed)) for name, (label, changed) in changes.items()]
    # charges grow with the load, their noise does not; whether a probe bears that load, only its verification shows
    if scene.load.force and design.noise.charge:
        results.append(compare("force doubled", f"twice the force, {2 * scene.load.force:.3g} N", evaluate(design, 2.0)))
    return tuple(results)


def _iterate_changes(design: Design) -> Iterator[tuple[str, str, Design]]:
    """Yield the name of each improvement, its label in plain words, and the design with it."""
    noise, protocol = design.noise, design.protocol
    for key, label in NOISE_LABELS.items():
        # gains cancel against a baseline reading, and a calibration replaces gain
        counts = not (protocol.blank and key.endswith("gain")) and (protocol.stiffness or not key.startswith("stiffness"))
        if getattr(noise, key) and counts and not (key == "gain" and noise.calibration):
            half = getattr(noise, key) / 2
            size = f"{half * 1e12:g} pC" if key == "charge" else format_percent(half, 6)
            yield f"{key} halved", f"half {label}, {size}", _replace_table(design, "noise", **{key: half})
    if not protocol.stiffness:
        yield "stiffness read", "the stiffness read, too", _replace_table(design, "protocol", stiffness=True)
    if not protocol.blank:
        yield "blank read", "a baseline reading", _replace_table(design, "protocol", blank=True)
    places, count = protocol.places, 2 * len(protocol.positions) - 1
    if len(places) > 1 and count <= (MAX_RASTER_LINES if protocol.raster else MAX_POSITIONS):
        # one position added in the middle between each two
        positions = np.interp(np.arange(count) / 2, np.arange(len(places)), places)
        changed = _replace_table(design, "protocol", positions=tuple(positions.tolist()))
        yield f"{changed.protocol.count} positions", f"{changed.protocol.count} positions, not {protocol.count}", changed


def _replace_table(design: Design, table: str, **new: Any) -> Design:
    """Return a design with new values of keys in one of its tables."""
    return design.model_copy(update={table: getattr(design, table).model_copy(update=new)})
