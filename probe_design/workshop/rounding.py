"""Round sizes of a probe to a step that can be machined; compare ratio and log-sensitivity before and after."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.base_sizes import find_base_sizes, has_flange
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_from_dict, scene_to_dict
from solver import Result, evaluate
from solver.results.record import Record

MIN_WALL_M = 0.5e-3
"""m: a wall is not rounded below this thickness, a thinner one not below its own; the limit of `optimize`."""

COST_EVALUATORS = (("axisymmetric", 1e-3), ("equivalent-inclusion", 1e-2), ("auto", 1e-2), ("closed-form", 1e-2))
"""Evaluators for the cost of a rounding, with their accuracy: the first that takes both scenes is used. What they leave out, such
as a groove, is in their errors and the same before and after, so that a solid of several minutes would add nothing."""


@dataclass(frozen=True)
class SizeChange:
    """A rounded size: its key in the scene file, and both values in m."""

    key: str
    before: float
    after: float


@dataclass(frozen=True)
class RoundingCost:
    """Results of a design that show the cost of rounding; None where there is no such result."""

    ratio: float | None
    log_sensitivity: float | None
    error_estimate: float | None
    evaluator: str


@dataclass(frozen=True, repr=False)
class Rounding(Record):
    """A rounded scene.

    Attributes
    ----------
    step
        Length, m; all rounded sizes are multiples of it.
    scene
        The rounded scene.
    changes
        Rounded sizes in the order of the scene file, without those that were multiples of the step already.
    before, after
        Results before and after rounding; None if no evaluator takes the scenes.
    remark
        Reason why there are no results.
    """

    INTERNAL = ("scene",)
    step: float
    scene: Scene
    changes: tuple[SizeChange, ...]
    before: RoundingCost | None = None
    after: RoundingCost | None = None
    remark: str = ""


def round_sizes(scene: Scene, step: float) -> Rounding:
    """Round radii, gap, heights, groove and base of a scene's probe to multiples of ``step`` (m).

    The results before and after are added by ``add_cost``.

    The outer radius replaces ``area_ratio``. The wall keeps its limit, see ``MIN_WALL_M``; the groove stays inside its block. The
    thickness of the film is given by its maker and the round edges by the tool: they are not rounded.

    Raises
    ------
    InputError
        A size is below half the step, or the rounded scene is not valid.
    """
    step = LENGTH_QUANTITY.read("step", step, units_required=False)
    sizes = _list_sizes(scene.probe)
    smallest = min(sizes, key=sizes.__getitem__)
    if sizes[smallest] < step / 2 or not math.isfinite(step):
        raise InputError(
            "step", format_mm(step), f"at most {format_mm(2 * sizes[smallest])}: {smallest} is {format_mm(sizes[smallest])}"
        )
    new_sizes = _restore_limits(scene, {key: _round_to_step(size, step) for key, size in sizes.items()}, step)
    changes = tuple(
        SizeChange(key, size, new_sizes[key])
        for key, size in sizes.items()
        if not math.isclose(size, new_sizes[key], rel_tol=1e-9)
    )
    return Rounding(step, _replace_sizes(scene, new_sizes), changes)


def add_cost(rounding: Rounding, scene: Scene) -> Rounding:
    """Return a rounding of ``scene`` with the results before and after.

    They are computed by the first of ``COST_EVALUATORS`` that can evaluate both scenes; a remark gives the reason if none can.
    """
    for name, accuracy in COST_EVALUATORS:
        try:
            old_result, new_result = (evaluate(design, name, accuracy, linear=True) for design in (scene, rounding.scene))
        except Refusal as fault:
            remark = f"what the rounding costs is not known: {fault}"
            continue
        return Rounding(rounding.step, rounding.scene, rounding.changes, _build_cost(old_result), _build_cost(new_result))
    return Rounding(rounding.step, rounding.scene, rounding.changes, remark=remark)


def _build_cost(result: Result) -> RoundingCost:
    """Return the numbers of a result that show the cost of rounding."""
    return RoundingCost(result.ratio, result.log_sensitivity, result.error_estimate, result.evaluator)


def _list_sizes(probe: Probe) -> dict[str, float]:
    """Return the sizes to be rounded by key, m; those of the base only where the probe has or needs them."""
    base = find_base_sizes(probe)
    sizes = {"probe.inner_radius": probe.inner_radius, "probe.gap": probe.gap, "probe.outer_radius": probe.tube_radius}
    if probe.height is not None:
        sizes["probe.height"] = probe.height
    else:
        sizes |= {"probe.inner_height": probe.core_height, "probe.outer_height": probe.tube_height}
    if probe.groove is not None:
        sizes |= {"probe.groove.width": probe.groove.width, "probe.groove.depth": probe.groove.depth}
    flange = {"probe.base.flange_radius": base.flange_radius, "probe.base.step_height": base.step_height}
    return {**sizes, **(flange if has_flange(probe) else {}), "probe.base.thickness": base.thickness}


def _round_to_step(size: float, step: float) -> float:
    """Return the multiple of the step nearest to a size, at least one step."""
    return _multiply_step(max(1, round(size / step)), step)


def _multiply_step(count: int, step: float) -> float:
    """Return a multiple of the step without rounding noise: 3 times 0.1 mm is 0.3 mm, not 0.30000000000000004 mm."""
    return float(f"{count * step:.12g}")


def _restore_limits(scene: Scene, sizes: dict[str, float], step: float) -> dict[str, float]:
    """Return rounded sizes, by key, moved by whole steps where needed so that the limits between them hold again.

    They are the thickness of the wall, the flange outside the wall, and the groove inside its block; ``scene`` is not rounded.
    """
    probe = scene.probe
    hole = sizes["probe.inner_radius"] + sizes["probe.gap"]
    wall = min(MIN_WALL_M, probe.tube_radius - probe.hole_radius)
    radius, flange = "probe.outer_radius", "probe.base.flange_radius"
    sizes[radius] = max(sizes[radius], _round_up(hole + wall, step))
    if flange in sizes:
        sizes[flange] = max(sizes[flange], sizes[radius])
    if probe.groove is not None:
        height = sizes.get("probe.height", sizes.get("probe.outer_height", 0.0)) - scene.contact.edge_radius
        for key, limit in (("probe.groove.width", 2 * hole), ("probe.groove.depth", height)):
            sizes[key] = min(sizes[key], _round_below(limit, step))
            if sizes[key] <= 0:
                raise InputError("step", format_mm(step), f"a step below {format_mm(limit)}, so that {key} has room")
    return sizes


def _round_up(size: float, step: float) -> float:
    """Return a size rounded up to a multiple of the step; 1e-9 keeps a size that is a multiple but for rounding."""
    return _multiply_step(math.ceil(size / step * (1 - 1e-9)), step)


def _round_below(limit: float, step: float) -> float:
    """Return the largest multiple of the step strictly below a limit; 1e-9 allows for rounding of the limit."""
    return _multiply_step(math.ceil(limit / step * (1 - 1e-9)) - 1, step)


def _replace_sizes(scene: Scene, sizes: dict[str, float]) -> Scene:
    """Return the scene with new sizes, checked as a file is."""
    tables = scene_to_dict(scene)
    tables["probe"].pop("area_ratio", None)
    for key, size in sizes.items():
        *places, name = key.split(".")
        table = tables
        for place in places:
            # a base that the scene does not state is rigid
            table = table.setdefault(place, {"rigid": True} if place == "base" else {})
        table[name] = LENGTH_QUANTITY.format_value(size)
    try:
        return scene_from_dict(tables)
    except InputError as fault:
        raise InputError("step", Words("a rounded scene"), f"a smaller step ({fault})") from None
