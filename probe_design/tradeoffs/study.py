"""What accuracy costs on the user's own scenes: every evaluator and setting, timed, its stated error held against its true one.

True errors are differences from the finest converged answer that any level reaches for the scene, which carries its own
stated error: below that a true error is not resolved. Times are wall clock: of them, ratios are what holds from machine to
machine.
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
FINE_ENOUGH = 1e-5  # stated error of a reference beyond which the next of FINEST is not asked
SOLID = (Setting("solid", 0.03), Setting("solid", 0.01), Setting("solid", 0.003))
CONVERGING = ("equivalent-inclusion", "axisymmetric", "solid")
SKIPPED = {
    "published": "gives an equivalent modulus, no ratio to compare",
    "contact": "answers loads beyond linear elasticity, where the others are not true",
    "solid": "takes minutes: asked only with --solid, or where nothing else takes the scene",
}
LINEAR = 0.01  # accuracy at which a load is allowed
UNCERTAIN = 0.01  # stated error of a reference beyond which it is said
TOLERANCES = (0.05, 0.01, 0.001)
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Tradeoff:
    """The trade of speed for accuracy on some scenes.

    Attributes:
        scenes: by name.
        rows: one for each scene and setting, in that order.
        skipped: evaluators that were not asked everywhere, with the reason.
        warnings: of loads beyond which linear elasticity, to which all errors refer, says little.
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
        """The settings that were asked, those of one level together, coarse ones first."""
        settings = {row.setting for row in self.rows}
        return tuple(sorted(settings, key=lambda one: (BUILT.index(one.evaluator), -(one.accuracy or 1.0))))

    @property
    def broken(self) -> tuple[Row, ...]:
        """Rows whose stated error is below the least that the true one can be: defects of their evaluator."""
        return tuple(row for row in self.rows if not row.held)

    @property
    def uncertain(self) -> tuple[Row, ...]:
        """References that may themselves be off by more than 1 %: the true errors of their scenes are not known."""
        return tuple(row for row in self.rows if row.reference and (row.stated_error or 0.0) > UNCERTAIN)

    def choices(self) -> Iterator[tuple[str, float, Row | None, Row | None]]:
        """Yield scene, tolerance and the fastest answers within it: by what they state, and by their true error."""
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
    """Answer scenes by every evaluator and setting; time the answers; compare them with the finest.

    Args:
        scenes: by name.
        solid: whether to ask the three-dimensional level too, which takes minutes a scene. It is asked anyway where no other
            level that converges takes the scene.
        progress: called with a scene's name, the settings that are done and their number.
        settings: what is timed.
        finest: asked in turn for a reference until one states an error of at most 1e-5; timed once.
        linear: whether to take scenes whose load is beyond what linear elasticity, to which all errors refer, allows at 1 %.

    Raises:
        InputError: there is no scene.
        Refusal: no evaluator takes any of the scenes; a load is beyond what linear elasticity allows.
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
    """What is said of a scene's load; ``Refusal`` where it is beyond the limit, unless ``linear``."""
    rule, promise = load_rule(scene), scene.target is not None
    if not linear:
        check_load(scene, rule, LINEAR, promise)
    return load_notes(scene, rule, LINEAR, promise)


def _of_scene(
    name: str, scene: Scene, solid: bool, *, progress: Progress, settings: Sequence[Setting], finest: Sequence[Setting]
) -> tuple[Row, ...]:
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
    """The least stated error of the levels that converge."""
    stated = (row.stated_error for row in rows if row.evaluator in CONVERGING and row.ratio is not None)
    return min((error for error in stated if error is not None), default=math.inf)


def _choice(row: Row | None) -> dict[str, Any] | None:
    return None if row is None else {"evaluator": row.evaluator, "accuracy": row.accuracy, "seconds_probe": row.seconds_probe}
