"""Measure what accuracy costs on the user's scenes: time, stated error and true error of every evaluator and setting.

True errors are differences from the finest converged result of any evaluator. This reference has a stated error itself, below
which true errors are not resolved. Times are wall clock; only their ratios carry over to other machines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from geometry.common.errors import InputError, Refusal, Words, import_extra
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
from probe_design.tradeoffs.rows import Row, Setting, compare_with_reference, find_cheapest, find_pareto_front, remove_duplicates
from probe_design.tradeoffs.timing import time_first_result, time_repeats, use_empty_mesh_cache
from solver.evaluators import EVALUATOR_NAMES
from solver.planning.load_check import build_load_notes, check_load
from solver.planning.load_limits import build_load_rule

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

TIMED_SETTINGS = (
    Setting("closed-form", None),
    Setting("equivalent-inclusion", 0.03),
    Setting("equivalent-inclusion", 0.01),
    Setting("equivalent-inclusion", 0.003),
    Setting("equivalent-inclusion", 0.001),
    Setting("axisymmetric", 0.05),
    Setting("axisymmetric", 0.01),
    Setting("axisymmetric", 0.001),
    Setting("axisymmetric", 0.0001),
)
REFERENCE_SETTINGS = (Setting("axisymmetric", 1e-5), Setting("equivalent-inclusion", 1e-4))
MAX_REFERENCE_ERROR = 1e-5  # a reference with a smaller stated error is fine enough
SOLID_SETTINGS = (Setting("solid", 0.03), Setting("solid", 0.01), Setting("solid", 0.003))
CONVERGING_EVALUATORS = ("equivalent-inclusion", "axisymmetric", "solid")
LOADED_SETTINGS = tuple(Setting("contact", accuracy) for accuracy in (0.1, 0.01, 0.003))  # beyond linear elasticity
SKIPPED_EVALUATORS = {
    "published": "gives an equivalent modulus, no ratio to compare",
    "contact": "is for loads beyond linear elasticity",
    "solid": "takes minutes: used only with --solid, or where no other evaluator takes the scene",
}
LOAD_ACCURACY = 0.01  # error of linear elasticity up to which a load is allowed
MAX_CERTAIN_ERROR = 0.01  # a reference with a larger stated error gives a warning
ERROR_TOLERANCES = (0.05, 0.01, 0.001)  # relative errors for which the fastest setting is listed
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, repr=False)
class Tradeoff:
    """Speed against accuracy of all evaluators on some scenes.

    Attributes
    ----------
    scenes
        The scenes by name.
    rows
        One for each scene and setting, in that order.
    skipped
        Evaluators that were not used for every scene, with the reason.
    warnings
        Warnings about loads for which linear elasticity, to which errors refer, is not accurate.
    """

    scenes: Mapping[str, Scene]
    rows: tuple[Row, ...]
    skipped: Mapping[str, str]
    warnings: tuple[str, ...] = ()

    def find_rows(self, scene: str) -> tuple[Row, ...]:
        """Return the rows of one scene."""
        return tuple(row for row in self.rows if row.scene == scene)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """The settings that were used, by evaluator, coarse ones first."""
        settings = {row.setting for row in self.rows}
        return tuple(sorted(settings, key=lambda setting: (EVALUATOR_NAMES.index(setting.evaluator), -(setting.accuracy or 1.0))))

    @property
    def understated_rows(self) -> tuple[Row, ...]:
        """Rows whose error bound is below the lower limit of the true error: defects of their evaluator."""
        return tuple(row for row in self.rows if row.error_kind == "bound" and not row.is_error_covered)

    @property
    def uncertain_references(self) -> tuple[Row, ...]:
        """References with a stated error above ``MAX_CERTAIN_ERROR``: the true errors of their scenes are not known."""
        return tuple(row for row in self.rows if row.reference and (row.stated_error or 0.0) > MAX_CERTAIN_ERROR)

    def iterate_choices(self) -> Iterator[tuple[str, float, Row | None, Row | None]]:
        """Yield scene, tolerance and the fastest rows within it: by stated error, and by true error."""
        for name in self.scenes:
            rows = remove_duplicates(self.find_rows(name))
            for tolerance in ERROR_TOLERANCES:
                yield name, tolerance, find_cheapest(rows, tolerance), find_cheapest(rows, tolerance, "true_error_most")

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame with a row for each scene and setting."""
        frame: pd.DataFrame = import_extra("pandas").DataFrame([asdict(row) for row in self.rows])
        return frame

    def to_dataset(self) -> xr.Dataset:
        """Return the numbers of ``to_frame`` for xarray."""
        dataset: xr.Dataset = import_extra("xarray").Dataset.from_dataframe(self.to_frame().rename_axis("row"))
        return dataset

    def __str__(self) -> str:
        """Return a short table: for each scene the fastest setting within each tolerance, by stated error."""
        rows = []
        for name, tolerance, choice, _ in self.iterate_choices():
            text = "none" if choice is None else f"{choice.setting}, {choice.seconds_probe or choice.seconds_first or 0.0:.2g} s"
            rows.append(f"{name}: within {format_percent(tolerance, 6)}: {text}")
        return "\n".join(["Tradeoff", *rows])

    __repr__ = __str__

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design tradeoff``, without ``files``; SI units."""
        results = [remove_duplicates(self.find_rows(name)) for name in self.scenes]
        stated_front, true_front = (
            {row for rows in results for row in find_pareto_front(rows, error)} for error in ("stated_error", "true_error_most")
        )
        return {
            "scenes": {name: scene_to_dict(scene) for name, scene in self.scenes.items()},
            "rows": [
                asdict(row)
                | {"held": row.is_error_covered, "resolved": row.is_resolved}
                | {"pareto_stated": row in stated_front, "pareto_true": row in true_front}
                for row in self.rows
            ],
            "cheapest": [
                {
                    "scene": name,
                    "tolerance": tolerance,
                    "by_stated_error": _build_choice(stated),
                    "by_true_error": _build_choice(true),
                }
                for name, tolerance, stated, true in self.iterate_choices()
            ],
            "skipped": dict(self.skipped),
            "warnings": list(self.warnings),
        }


def measure_tradeoff(
    scenes: Mapping[str, Scene],
    solid: bool = False,
    progress: Progress = lambda scene, done, total: None,
    settings: Sequence[Setting] = TIMED_SETTINGS,
    finest: Sequence[Setting] = REFERENCE_SETTINGS,
    *,
    linear: bool = False,
) -> Tradeoff:
    """Evaluate scenes with every evaluator and setting, time them, and compare the results with the finest one.

    Parameters
    ----------
    scenes
        The scenes by name.
    solid
        Whether to use the three-dimensional evaluator too, which takes minutes per scene. It is used anyway where no other
        converging evaluator takes the scene.
    progress
        Called with a scene's name, the number of finished settings and the total.
    settings
        The timed settings.
    finest
        Settings tried in turn for the reference, until one states an error of at most ``MAX_REFERENCE_ERROR``; timed once.
    linear
        Whether to compare linear evaluators also under a load for which linear elasticity is less accurate than
        ``LOAD_ACCURACY``; else ``LOADED_SETTINGS`` are compared there, with the most accurate of them.

    Raises
    ------
    InputError
        There is no scene.
    Refusal
        No evaluator takes any of the scenes under their loads.
    """
    if not scenes:
        raise InputError("SCENE", Words("none"), "one scene or more")
    limits = {name: None if linear else _find_passed_limit(scene) for name, scene in scenes.items()}
    notes = tuple(f"{name}: {note}" for name, scene in scenes.items() if limits[name] is None for note in _list_notes(scene))
    rows: list[Row] = []
    for name, scene in scenes.items():
        limit = limits[name]
        if limit is None:
            rows += _measure_scene(name, scene, solid, progress=progress, settings=settings, finest=finest)
        else:
            rows += _measure_loaded_scene(name, scene, limit, progress)
    if all(row.ratio is None for row in rows):
        raise Refusal("SCENE", Words(", ".join(scenes)), f"a scene that some evaluator takes ({rows[-1].reason})")
    used = {row.evaluator for row in rows if row.ratio is not None} | ({"solid"} if solid else set())
    skipped = {name: reason for name, reason in SKIPPED_EVALUATORS.items() if name not in used}
    return Tradeoff(scenes, tuple(rows), skipped, notes)


def _list_notes(scene: Scene) -> tuple[str, ...]:
    """Return the warnings about a scene's load, whose errors refer to linear elasticity."""
    return build_load_notes(scene, build_load_rule(scene), LOAD_ACCURACY, scene.target is not None)


def _find_passed_limit(scene: Scene) -> str | None:
    """Return up to which load linear elasticity is accurate to ``LOAD_ACCURACY``; None where the scene's load is below it."""
    try:
        check_load(scene, build_load_rule(scene), LOAD_ACCURACY, scene.target is not None)
    except Refusal as fault:
        return fault.allowed
    return None


def _measure_loaded_scene(name: str, scene: Scene, limit: str, progress: Progress) -> tuple[Row, ...]:
    """Return the rows of a scene beyond linear elasticity: ``contact`` at several accuracies, and the linear evaluators' limit.

    ``name`` is the scene's and ``limit`` the largest load for linear elasticity in words.
    """
    total = len(LOADED_SETTINGS) + 1  # steps of progress; the repeats are one
    rows = _time_settings(name, scene, LOADED_SETTINGS, lambda done: progress(name, done, total))
    progress(name, total, total)
    linear = [
        Row(name, evaluator, None, observable=scene.observable, reason=f"linear elasticity: {limit}")
        for evaluator in ("closed-form", *CONVERGING_EVALUATORS)
    ]
    return (*linear, *compare_with_reference(rows, ("contact",)))


def _measure_scene(
    name: str, scene: Scene, solid: bool, *, progress: Progress, settings: Sequence[Setting], finest: Sequence[Setting]
) -> tuple[Row, ...]:
    """Return the rows of one scene: evaluate and time it with all settings, then compare with the reference.

    ``name`` is the scene's; see ``measure_tradeoff`` for the other parameters.
    """
    total = len(settings) + len(finest) + len(SOLID_SETTINGS) + 1  # steps of progress; the repeats are one
    rows = _time_settings(name, scene, settings, lambda done: progress(name, done, total))
    for done, setting in enumerate(finest, len(settings) + 1):
        progress(name, done, total)
        if _find_min_error(rows) > MAX_REFERENCE_ERROR:
            rows.append(time_first_result(name, scene, setting))
    if solid or _find_min_error(rows) == math.inf:
        for done, setting in enumerate(SOLID_SETTINGS, total - len(SOLID_SETTINGS)):
            progress(name, done, total)
            with use_empty_mesh_cache():
                rows.append(time_first_result(name, scene, setting))
    progress(name, total, total)
    return compare_with_reference(rows, CONVERGING_EVALUATORS)


def _time_settings(name: str, scene: Scene, settings: Sequence[Setting], report: Callable[[int], None]) -> list[Row]:
    """Return a row of each setting, timed once and then again; ``report`` is called with the number of finished steps."""
    rows: list[Row] = []
    for done, setting in enumerate(settings):
        report(done)
        rows.append(time_first_result(name, scene, setting))
    report(len(settings))
    return time_repeats(scene, rows)


def _find_min_error(rows: list[Row]) -> float:
    """Return the smallest stated error of the converging evaluators; inf without a result."""
    stated = (row.stated_error for row in rows if row.evaluator in CONVERGING_EVALUATORS and row.ratio is not None)
    return min((error for error in stated if error is not None), default=math.inf)


def _build_choice(row: Row | None) -> dict[str, object] | None:
    """Return the JSON object of the fastest row within a tolerance; None if there is none."""
    return None if row is None else {"evaluator": row.evaluator, "accuracy": row.accuracy, "seconds_probe": row.seconds_probe}
