"""Compute readings of a probe along a line over the tissue."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Words
from geometry.provenance.block import Provenance, provenance
from geometry.scenes.scene import Scene
from probe_design.maps.scan_line import ScanLine
from probe_design.maps.target_grid import check_spheres
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.equivalent_inclusion.readings import Readings, readings
from solver.planning.load_check import LoadChanges, budget, check_load, load_notes
from solver.planning.load_limits import limits_of, load_rule
from solver.results.film_forces import ratio
from solver.results.load_limits import LoadLimits, limits_dict
from solver.results.notebook import Notebook
from solver.results.result import Decision

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]
Column = tuple[float | None, ...]


@dataclass(frozen=True)
class Scan(Notebook):
    """Readings at positions along a line, at the scene's load; None where a warning gives the reason.

    Attributes:
        along: "x" or "y", the axis along which the probe moves.
        at: coordinate of the line along the other axis, m.
        position: of the probe's axis along the line, m.
        ratio, stiffness, stress_inner, stress_outer, log_sensitivity, error_estimate: see ``Result``, one per position.
        ratio_without: the ratio without any inclusion.
        evaluator, seconds, load_limits, plan, warnings: see ``Result``.
        scene: the scene with its inclusions.
        provenance: see ``geometry.provenance.block``.
    """

    DIMENSIONS = ("position",)
    along: str
    at: float
    position: tuple[float, ...]
    ratio: Column
    stiffness: tuple[float, ...]
    stress_inner: tuple[float, ...]
    stress_outer: tuple[float, ...]
    log_sensitivity: Column
    error_estimate: Column
    ratio_without: float | None
    evaluator: str
    seconds: float
    load_limits: LoadLimits | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    scene: Scene | None = field(default=None, compare=False, repr=False)
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design scan``."""
        return asdict(replace(self, scene=None), dict_factory=without_scene) | limits_dict(self.load_limits)

    def plot(self) -> Figure:
        """Draw the picture of ``probe-design scan --plot``; return the figure, whose ``savefig`` writes it.

        Raises:
            InputError: the result has no scene.
        """
        from probe_design.maps.scan_plot import figure_of

        return figure_of(self, drawn(self.scene))


def scan(
    scene: Scene, along: str, positions: Floats, at: float | None = None, *, accuracy: float = 0.01,
    linear: bool = False, progress: Progress | None = None,
) -> Scan:  # fmt: skip
    """Compute readings of the scene's probe along a line over its tissue; the tumours stay in place.

    Args:
        scene: spheres, bonded or frictionless, no tilt.
        along: "x" or "y".
        positions: of the probe's axis along the line, m, shape (n,).
        offset: coordinate of the line along the other axis, m; default: the scene's placement.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        linear: whether to use linear elasticity at any load, see ``solver.evaluate``.
        progress: called with the number of positions done and their total, for positions that need reflections.

    Raises:
        InputError: the probe would leave the tissue.
        Refusal: the evaluator cannot model the scene, or it is too extreme for double precision, or its load is beyond the range
            of linear elasticity.
    """
    start = perf_counter()
    check_accuracy(accuracy)
    check_spheres(scene, "scan")
    across = "y" if along == "x" else "x"
    rule, promise = load_rule(scene), scene.target is not None
    asked = budget(rule, rule.force(scene), accuracy, promise)
    line = ScanLine(scene, along, float(getattr(scene.placement, across) if at is None else at), asked)
    positions = np.asarray(positions, dtype=float)
    line.check(positions)
    if not linear:
        check_load(scene, rule, accuracy, promise)
    base = line.prepared(float(np.abs(positions).min()))  # used for all positions: only the bounds differ elsewhere
    tumours = line.tumours(positions)
    plain = readings(base, tumours, scene.target or 0, progress=progress, sensitive=scene.target is not None)
    answers = line.bounded(base, plain, positions)
    far = line.alone(float(np.abs(positions).max()))
    outside = base.inside(tumours)[1]
    targeted = ~outside[:, scene.target] if scene.target is not None else np.zeros(len(positions), dtype=bool)
    load = LoadChanges.of(scene, rule, answers.stiffness)
    if not linear:
        check_load(scene, load.weakest, accuracy, promise)
    stress = answers.totals * indentation(scene, answers)[:, None] / answers.areas
    return Scan(
        along=along,
        at=line.at,
        position=tuple(positions.tolist()),
        ratio=column(answers.ratio, answers.resolved),
        stiffness=tuple(answers.stiffness.tolist()),
        stress_inner=tuple(stress[:, 0].tolist()),
        stress_outer=tuple(stress[:, 1].tolist()),
        log_sensitivity=column(answers.log_sensitivity, answers.resolved & targeted) if answers.by else (None,) * len(positions),
        error_estimate=column(load.with_errors(answers.error_estimate), answers.resolved & load.known),
        ratio_without=ratio(scene, base.films)["ratio"],
        evaluator=EquivalentInclusion().name,
        seconds=perf_counter() - start,
        load_limits=limits_of(rule, accuracy, promise),
        plan=(*far.plan, *reflections(base, answers)),
        warnings=(
            *dict.fromkeys(_warnings(scene, far, answers, outside)),
            *load_notes(scene, load.weakest, accuracy, promise),
        ),
        scene=scene,
        provenance=provenance(scene, evaluator=EquivalentInclusion().name, accuracy=accuracy),
    )


def without_scene(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the fields of a result without its scene, for a JSON object."""
    return {key: value for key, value in pairs if key != "scene"}


def drawn(scene: Scene | None) -> Scene:
    """Return the scene of a result that is to be drawn; raise ``InputError`` if it has none."""
    if scene is None:
        raise InputError("scene", Words("missing"), "a result that the toolkit made, which carries its scene")
    return scene


def check_accuracy(accuracy: float) -> None:
    """Raise ``InputError`` for an accuracy that is not above 0 and below 1."""
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")


def indentation(scene: Scene, answers: Readings) -> Floats:
    """Return the indentation at the scene's load, m, shape (n,)."""
    imposed = scene.load.indentation
    return (scene.load.force or 0.0) / answers.stiffness if imposed is None else np.full(len(answers.forces), imposed)


def column(values: Floats, valid: Bools) -> Column:
    """Return values as a tuple for JSON, with None where they are not valid."""
    return tuple(value if good else None for value, good in zip(values.tolist(), valid.tolist(), strict=True))


def reflections(base: Undisturbed, answers: Readings) -> Iterator[Decision]:
    """Yield the line of the plan about reflections of the tumours' fields, if there are tumours."""
    if not answers.by:
        return
    count, n = int(answers.reflected.sum()), len(answers.reflected)
    effect = float(min(answers.first_share.max(), 1e9))
    size = f"changes the ratio by at most about {effect:.2g}"
    reason = f"modelled for {count} of {n}, elsewhere counted in error_estimate: {size}"
    yield Decision("what surface, blocks and floor send back of the tumours' fields", count > 0, effect, base.accuracy, reason)


def _warnings(scene: Scene, far: ProbeAlone, answers: Readings, outside: Bools) -> Iterator[str]:
    """Yield warnings about missing log-sensitivities and ratios, tumours left out, and errors above the accuracy."""
    n = len(answers.forces)
    yield from far.notes
    if scene.target is None:
        how = "several inclusions and none marked target = true" if scene.inclusion else "the scene has no inclusion"
        yield f"no log-sensitivity is given: {how}"
    elif outside[:, scene.target].any():
        count = int(outside[:, scene.target].sum())
        yield f"no log-sensitivity is given at {count} of {n} positions: the target lies outside the modelled round tissue"
    if outside.any():
        count = int(outside.any(axis=1).sum())
        left = f"left out at {count} of {n} positions, which the error counts"
        yield f"tumours outside the round tissue that is modelled are {left}"
    if not answers.resolved.all():
        where = f"{int((~answers.resolved).sum())} of {n} positions"
        yield f"no ratio is given at {where}: under one of the blocks the stress is smaller than its own error"
    for what, reached in errors(scene, answers).items():
        many = int((reached > far.accuracy).sum())
        if many:
            bound = f"{reached.max():.2g}" if reached.max() < 1 else "1 and more"
            yield f"the error of {what} is up to {bound} at {many} of {n} positions, more than the accuracy {far.accuracy:g}"
    if answers.by and scene.target is not None:
        sensitivity = np.abs(answers.log_sensitivity)
        worse = answers.resolved & (answers.sensitivity_error > np.maximum(5 * far.accuracy * sensitivity, 1e-5))
        if worse.any():
            most = f"{answers.sensitivity_error[worse].max():.1g} (absolute)"
            where = f"{int(worse.sum())} of {n} positions"
            yield f"the error of the log-sensitivity is up to {most} at {where}, more than 5 times the accuracy"


def errors(scene: Scene, answers: Readings) -> dict[str, Floats]:
    """Return the relative error bounds of ratio, stiffness and, at a given indentation, stresses, shape (n,) each."""
    bounds = {
        "the ratio": answers.error_estimate[answers.resolved],
        "the stiffness": answers.bound.sum(axis=1) / np.abs(answers.stiffness),
    }
    if scene.load.force is not None:  # the stresses add up to the force, so that the ratio's error bounds theirs
        return bounds
    with np.errstate(divide="ignore"):
        return bounds | {"the stresses": (answers.bound / np.abs(answers.totals)).max(axis=1)}
