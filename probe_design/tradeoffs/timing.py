"""Time one setting on one scene: the first evaluation, a new probe, another tumour under the same probe.

Each timing has a workspace of its own, so that nothing is cached by another one.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Inclusion, Scene
from geometry.tetra.cache import CACHE_VARIABLE
from probe_design.tradeoffs.rows import Row, Setting
from solver import Result, Workspace, evaluator
from solver.linalg.workspace import use_workspace

MAX_REPEATS = 9  # at most
MAX_REPEAT_TIME_S = 0.75  # s: no repeats after this total time


def time_first_answer(name: str, scene: Scene, setting: Setting) -> Row:
    """Evaluate a scene with a setting for the first time; return its row, or the row of its refusal."""
    row = Row(name, setting.evaluator, setting.accuracy)
    try:
        with use_workspace(Workspace()):
            result, seconds = _time_setting(scene, setting)
    except ProbeError as fault:
        return replace(row, reason=str(fault))
    timed_row = replace(row, seconds_first=seconds, seconds_probe=seconds)
    if result.ratio is None:
        return replace(timed_row, reason=next(iter(result.warnings), "no ratio"))
    return replace(
        timed_row, ratio=result.ratio, log_sensitivity=result.log_sensitivity, stated_error=result.error_estimate,
        error_kind=result.error_kind,
    )  # fmt: skip


@dataclass(frozen=True)
class Times:
    """Seconds of one setting: with a new probe, and with another tumour under it."""

    probe: tuple[float, ...] = ()
    tumour: tuple[float, ...] = ()

    @property
    def is_sufficient(self) -> bool:
        """Whether no more repeats are needed."""
        return len(self.probe) >= MAX_REPEATS or sum(self.probe + self.tumour) >= MAX_REPEAT_TIME_S


def time_repeats(scene: Scene, rows: Sequence[Row]) -> tuple[Row, ...]:
    """Repeat the settings that have a result in turns, so that other load on the machine slows all of them equally."""
    times = [Times() for _ in rows]
    for _ in range(MAX_REPEATS):
        for index, row in enumerate(rows):
            if row.ratio is not None and not times[index].is_sufficient:
                with use_workspace(Workspace()):
                    times[index] = _repeat_setting(scene, row, times[index])
    return tuple(_add_times(row, measured_times) for row, measured_times in zip(rows, times, strict=True))


def _repeat_setting(scene: Scene, row: Row, so_far: Times) -> Times:
    """Time a setting once more, with a new probe and with another tumour."""
    try:
        probe = _time_setting(scene, row.setting)[1]
        tumour = (_time_setting(change_tumours(scene), row.setting)[1],) if scene.inclusion else ()
    except ProbeError:  # the scene is at a limit of what the evaluator takes
        return so_far
    return Times((*so_far.probe, probe), (*so_far.tumour, *tumour))


def _add_times(row: Row, times: Times) -> Row:
    probe = median(times.probe) if times.probe else row.seconds_probe
    return replace(row, seconds_probe=probe, seconds_tumour=median(times.tumour) if times.tumour else None)


def change_tumours(scene: Scene) -> Scene:
    """Return the same probe over tumours that are 2 % smaller, a little higher and 1 % stiffer: each lies inside the old one."""
    return scene.model_copy(update={"inclusion": tuple(_change_tumour(body) for body in scene.inclusion)})


def _change_tumour(body: Inclusion) -> Inclusion:
    """Return a smaller and stiffer tumour that lies inside the old one."""
    update: dict[str, object] = {"youngs_modulus": 1.01 * body.youngs_modulus}
    if body.diameter is not None:
        update |= {"diameter": 0.98 * body.diameter, "depth": body.depth - 0.005 * body.diameter}
    if body.diameters is not None:
        smaller = tuple(0.98 * size for size in body.diameters)
        update |= {"diameters": smaller, "depth": body.depth - 0.005 * min(body.diameters)}
    return body.model_copy(update=update)


def _time_setting(scene: Scene, setting: Setting) -> tuple[Result, float]:
    start = perf_counter()
    result = evaluator(setting.evaluator).evaluate(scene, 0.01 if setting.accuracy is None else setting.accuracy)
    return result, perf_counter() - start


@contextmanager
def use_empty_mesh_cache() -> Iterator[None]:
    """Use an empty folder as mesh cache within the block, so that cached meshes do not falsify times."""
    old_folder = os.environ.get(CACHE_VARIABLE)
    with tempfile.TemporaryDirectory(prefix="probe-design-", ignore_cleanup_errors=True) as folder:
        os.environ[CACHE_VARIABLE] = folder
        try:
            yield
        finally:
            os.environ.pop(CACHE_VARIABLE) if old_folder is None else os.environ.update({CACHE_VARIABLE: old_folder})
