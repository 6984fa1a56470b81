"""Time one setting on one scene: the first evaluation, a new probe, another tumour under the same probe.

Each timing has a workspace of its own, so that nothing is cached by another one.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from statistics import median
from time import perf_counter

from geometry.common.cached_arrays import CACHE_VARIABLE
from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from probe_design.tradeoffs.rows import Row, Setting
from solver import Result, Workspace, evaluator
from solver.linalg.workspace import use_workspace
from solver.results.warnings import select_notes

MAX_REPEATS = 9  # at most
MAX_REPEAT_TIME_S = 0.75  # s: no repeats after this total time


def time_first_result(name: str, scene: Scene, setting: Setting) -> Row:
    """Evaluate a scene with a setting for the first time; return its row, or the row of its refusal."""
    row = Row(name, setting.evaluator, setting.accuracy, observable=scene.observable)
    try:
        with use_workspace(Workspace()):
            result, seconds = _time_setting(scene, setting)
    except ProbeError as fault:
        return replace(row, reason=str(fault))
    timed_row = replace(row, seconds_first=seconds, seconds_probe=seconds)
    read = result.reading
    if read.ratio is None:
        reasons = select_notes(result.warnings, "null") or result.warnings
        return replace(timed_row, reason=next(iter(reasons[::-1]), "no ratio"))  # the note on charges comes last
    return replace(
        timed_row, ratio=read.ratio, log_sensitivity=read.log_sensitivity, stated_error=read.error,
        error_kind=result.error_kind, charge_per_force_inner=result.charge_per_force_inner,
        charge_per_force_outer=result.charge_per_force_outer,
    )  # fmt: skip


def time_repeats(scene: Scene, rows: Sequence[Row]) -> list[Row]:
    """Return the rows with median times of repeated evaluations, for a new probe and for another tumour.

    Settings take turns, so that other load on the machine slows all of them equally.
    """
    probe_times: list[list[float]] = [[] for _ in rows]
    tumour_times: list[list[float]] = [[] for _ in rows]
    for _ in range(MAX_REPEATS):
        for row, probes, tumours in zip(rows, probe_times, tumour_times, strict=True):
            if row.ratio is None or sum(probes) + sum(tumours) >= MAX_REPEAT_TIME_S:
                continue
            with use_workspace(Workspace()), suppress(ProbeError):  # the scene is at a limit of what the evaluator takes
                probes.append(_time_setting(scene, row.setting)[1])
                if scene.inclusion:
                    # in the same workspace: the solution of the probe is cached
                    tumours.append(_time_setting(change_tumours(scene), row.setting)[1])
    return [
        replace(
            row,
            seconds_probe=median(probes) if probes else row.seconds_probe,
            seconds_tumour=median(tumours) if tumours else None,
        )
        for row, probes, tumours in zip(rows, probe_times, tumour_times, strict=True)
    ]


def change_tumours(scene: Scene) -> Scene:
    """Return the same probe over tumours that are 2 % smaller, a little higher and 1 % stiffer: each lies inside the old one."""
    return scene.model_copy(update={"inclusion": tuple(_change_tumour(body) for body in scene.inclusion)})


def _change_tumour(body: Inclusion) -> Inclusion:
    """Return a smaller and stiffer tumour that lies inside the old one."""
    # its top sinks by 0.5 % of its height and its bottom rises by 1.5 %: it comes closer to no face of a layer
    update: dict[str, object] = {"youngs_modulus": 1.01 * body.youngs_modulus}
    if body.diameter is not None:
        update |= {"diameter": 0.98 * body.diameter, "depth": body.depth - 0.005 * body.diameter}
    if body.diameters is not None:
        smaller = tuple(0.98 * size for size in body.diameters)
        update |= {"diameters": smaller, "depth": body.depth - 0.005 * min(body.diameters)}
    return body.model_copy(update=update)


def _time_setting(scene: Scene, setting: Setting) -> tuple[Result, float]:
    """Evaluate a scene with a setting; return the result and the seconds it took."""
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
