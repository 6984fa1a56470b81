"""Measure what accuracy costs on the user's scenes: time, stated error and true error of every evaluator and setting.

True errors are differences from the finest converged result of any evaluator. This reference has a stated error itself, below
which true errors are not resolved. Times are wall clock; only their ratios carry over to other machines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
from probe_design.tradeoffs.rows import Row, Setting, cheapest, distinct, judged, pareto
from probe_design.tradeoffs.timing import first, no_kept_meshes, timed
from solver.levels import BUILT
from solver.planning.load_check import check_load, load_notes
from solver.planning.load_limits import load_rule

SETTINGS = (
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
FINEST = (Setting("axisymmetric", 1e-5), Setting("equivalent-inclusion", 1e-4))
FINE_ENOUGH = 1e-5  # a reference with a smaller stated error is fine enough
SOLID = (Setting("solid", 0.03), Setting("solid", 0.01), Setting("solid", 0.003))
CONVERGING = ("equivalent-inclusion", "axisymmetric", "solid")
SKIPPED = {
    "published": "gives an equivalent modulus, no ratio to compare",
    "contact": "is for loads beyond linear elasticity, where the other evaluators are not accurate",
    "solid": "takes minutes: used only with --solid, or where no other evaluator takes the scene",
}
LINEAR = 0.01  # error of linear elasticity up to which a load is allowed
UNCERTAIN = 0.01  # a reference with a larger stated error gives a warning
TOLERANCES = (0.05, 0.01, 0.001)  # relative errors for which the fastest setting is listed
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Tradeoff:
    """Speed against accuracy of all evaluators on some scenes.

    Attributes:
        scenes: by name.
        rows: one for each scene and setting, in that order.
        skipped: evaluators that were not used for every scene, with the reason.
        warnings: of loads for which linear elasticity, to which all errors refer, is not accurate.
    """

    scenes: Mapping[str, Scene]
    rows: tuple[Row, ...]
    skipped: Mapping[str, str]
    warnings: tuple[str, ...] = ()

    def of(self, scene: str) -> tuple[Row, ...]:
        """Return the rows of one scene."""
        return tuple(row for row in self.rows if row.scene == scene)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """The settings that were used, by evaluator, coarse ones first."""
        settings = {row.setting for row in self.rows}
        return tuple(sorted(settings, key=lambda one: (BUILT.index(one.evaluator), -(one.accuracy or 1.0))))

    @property
    def broken(self) -> tuple[Row, ...]:
        """Rows whose stated error is below the lower limit of the true one: defects of their evaluator."""
        return tuple(row for row in self.rows if not row.held)

    @property
    def uncertain(self) -> tuple[Row, ...]:
        """References with a stated error above 1 %: the true errors of their scenes are not known."""
        return tuple(row for row in self.rows if row.reference and (row.stated_error or 0.0) > UNCERTAIN)

    def choices(self) -> Iterator[tuple[str, float, Row | None, Row | None]]:
        """Yield scene, tolerance and the fastest rows within it: by stated error, and by true error."""
        for name in self.scenes:
            rows = distinct(self.of(name))
            for tolerance in TOLERANCES:
                yield name, tolerance, cheapest(rows, tolerance), cheapest(rows, tolerance, "true_error_most")

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design tradeoff``, without ``files``; SI units."""
        fronts = {
            error: {id(row) for name in self.scenes for row in pareto(distinct(self.of(name)), error)}
            for error in ("stated_error", "true_error_most")
        }
        return {
            "scenes": {name: scene_to_dict(scene) for name, scene in self.scenes.items()},
            "rows": [
                asdict(row)
                | {"held": row.held, "resolved": row.resolved}
                | {"pareto_stated": id(row) in fronts["stated_error"], "pareto_true": id(row) in fronts["true_error_most"]}
                for row in self.rows
            ],
            "cheapest": [
                {"scene": name, "tolerance": tolerance, "by_stated_error": _choice(stated), "by_true_error": _choice(true)}
                for name, tolerance, stated, true in self.choices()
            ],
            "skipped": dict(self.skipped),
            "warnings": list(self.warnings),
        }


def tradeoff(
    scenes: Mapping[str, Scene],
    solid: bool = False,
    progress: Progress = lambda scene, done, total: None,
    settings: Sequence[Setting] = SETTINGS,
    finest: Sequence[Setting] = FINEST,
    *,
    linear: bool = False,
) -> Tradeoff:
    """Evaluate scenes with every evaluator and setting, time them, and compare the results with the finest one.

    Args:
        scenes: by name.
        solid: whether to use the three-dimensional evaluator too, which takes minutes per scene. It is used anyway where no
            other converging evaluator takes the scene.
        progress: called with a scene's name, the number of finished settings and the total.
        settings: the timed settings.
        finest: settings tried in turn until one states an error of at most 1e-5, for the reference; timed once.
        linear: whether to accept loads for which linear elasticity, to which all errors refer, is less accurate than 1 %.

    Raises:
        InputError: there is no scene.
        Refusal: no evaluator takes any of the scenes, or a load is beyond the limit of linear elasticity.
    """
    if not scenes:
        raise InputError("SCENE", Words("none"), "one scene or more")
    notes = tuple(f"{name}: {note}" for name, scene in scenes.items() for note in _of_load(scene, linear))
    rows = tuple(
        row
        for name, scene in scenes.items()
        for row in _of_scene(name, scene, solid, progress=progress, settings=settings, finest=finest)
    )
    if all(row.ratio is None for row in rows):
        raise Refusal("SCENE", Words(", ".join(scenes)), f"a scene that some evaluator takes ({rows[-1].reason})")
    return Tradeoff(scenes, rows, {name: why for name, why in SKIPPED.items() if not (name == "solid" and solid)}, notes)


def _of_load(scene: Scene, linear: bool) -> tuple[str, ...]:
    """Return the warnings about a scene's load; raise ``Refusal`` beyond the limit of linear elasticity unless ``linear``."""
    rule, promise = load_rule(scene), scene.target is not None
    if not linear:
        check_load(scene, rule, LINEAR, promise)
    return load_notes(scene, rule, LINEAR, promise)


def _of_scene(
    name: str, scene: Scene, solid: bool, *, progress: Progress, settings: Sequence[Setting], finest: Sequence[Setting]
) -> tuple[Row, ...]:
    """Evaluate and time one scene with all settings, then compare with the reference."""
    total = len(settings) + len(finest) + len(SOLID) + 1
    rows: list[Row] = []
    for done, setting in enumerate(settings):
        progress(name, done, total)
        rows.append(first(name, scene, setting))
    progress(name, len(settings), total)
    rows = list(timed(scene, rows))
    for done, setting in enumerate(finest, len(settings) + 1):
        progress(name, done, total)
        if _least(rows) > FINE_ENOUGH:
            rows.append(first(name, scene, setting))
    if solid or _least(rows) == math.inf:
        for done, setting in enumerate(SOLID, total - len(SOLID)):
            progress(name, done, total)
            with no_kept_meshes():
                rows.append(first(name, scene, setting))
    progress(name, total, total)
    return judged(rows, CONVERGING)


def _least(rows: list[Row]) -> float:
    """Return the smallest stated error of the converging evaluators."""
    stated = (row.stated_error for row in rows if row.evaluator in CONVERGING and row.ratio is not None)
    return min((error for error in stated if error is not None), default=math.inf)


def _choice(row: Row | None) -> dict[str, Any] | None:
    return None if row is None else {"evaluator": row.evaluator, "accuracy": row.accuracy, "seconds_probe": row.seconds_probe}
