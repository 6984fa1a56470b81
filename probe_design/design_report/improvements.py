"""Compute the gain of each single improvement (less noise, another channel, more positions) for the same probe and tumours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.populations.design_file import Design
from probe_design.populations.examination import examine
from probe_design.populations.performance import Performance
from probe_design.populations.tables import MAX_POSITIONS, MAX_RASTER_LINES

NOISE_KEYS = ("white", "gain", "stiffness_white", "stiffness_gain", "charge", "tilt")


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
    """

    name: str
    value: float
    gain: float
    error: float


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
    changes = dict(_iterate_changes(design))
    positions = max((changed.protocol.positions for changed in (design, *changes.values())), key=len)  # contain all others
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
    results = [Improvement("as it is", start.means[maximise], 0.0, 0.0)]
    for name, changed in changes.items():
        better = evaluate(changed)
        results.append(Improvement(name, better.means[maximise], *better.compute_gain(start, design.objective)))
    # charges grow with the load, their noise does not; whether a probe bears that load, only its verification shows
    if scene.load.force and design.noise.charge:
        better = evaluate(design, 2.0)
        results.append(Improvement("force doubled", better.means[maximise], *better.compute_gain(start, design.objective)))
    return tuple(results)


def _iterate_changes(design: Design) -> Iterator[tuple[str, Design]]:
    """Yield the name of each improvement and the design with it."""
    noise, protocol = design.noise, design.protocol
    for key in NOISE_KEYS:
        # gains cancel against a baseline reading, and a calibration replaces gain
        counts = not (protocol.blank and key.endswith("gain")) and (protocol.stiffness or not key.startswith("stiffness"))
        if getattr(noise, key) and counts and not (key == "gain" and noise.calibration):
            yield f"{key} halved", _replace_table(design, "noise", **{key: getattr(noise, key) / 2})
    if not protocol.stiffness:
        yield "stiffness read", _replace_table(design, "protocol", stiffness=True)
    if not protocol.blank:
        yield "blank read", _replace_table(design, "protocol", blank=True)
    places, count = protocol.places, 2 * len(protocol.positions) - 1
    if len(places) > 1 and count <= (MAX_RASTER_LINES if protocol.raster else MAX_POSITIONS):
        # one position added in the middle between each two
        positions = np.interp(np.arange(count) / 2, np.arange(len(places)), places)
        changed = _replace_table(design, "protocol", positions=tuple(positions.tolist()))
        yield f"{changed.protocol.count} positions", changed


def _replace_table(design: Design, table: str, **new: Any) -> Design:
    """Return a design with new values of keys in one of its tables."""
    return design.model_copy(update={table: getattr(design, table).model_copy(update=new)})
