"""Which tumours a probe sees, and of which it tells the stiffness: maps over depth and diameter.

With R the ratio over a tumour, R_0 the ratio without it, S the log-sensitivity to its Young's modulus and g the noise,

    change = R / R_0 - 1                                        seen where |change| >= seen g           (MA.1)
    sd     = g / |S|, the standard deviation of ln E_object     resolved where sd <= resolved           (MA.2)

For one reading, R_0 and everything else in the scene being known. seen = 3 with a threshold half-way, at 1.5 g, calls a tumour
missed, or a healthy place a tumour, in 6.7 % of all cases each: P(z > 1.5); 3.29 makes it 5 % (Currie, Anal. Chem. 40 (1968)
586, the limit of detection for a well-known blank). Eq. MA.2 is the Cramér-Rao bound, a linearisation: near a saturated ratio
the interval on the stiff side is wider than it says; `estimate` does without.

A verdict holds whatever the model's error within its bound is: where the bound leaves it open, the tumour is answered once
more with reflections, and where it stays open there is no verdict (None).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError
from geometry.provenance.block import Provenance, provenance
from geometry.scenes.scene import Scene
from probe_design.data.noise import NOISE, RESOLVED, checked_noise
from probe_design.maps.scan import Progress, check_accuracy, drawn, without_scene
from probe_design.maps.target_grid import Spheres, check_spheres, target_of
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings, readings
from solver.planning.load_check import DOUBT, LoadChanges, budget, check_load, load_notes, load_rule
from solver.results.notebook import Notebook
from solver.results.result import Decision

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FINEST, COARSEST = 5e-4, 0.01  # accuracies chosen by the noise
MOST = 1e6  # of thresholds: beyond it they are none
CHANGES = 2.0  # times the base states' relative error in a tumour's effect: dF grows by twice, F_0 by once what the strains do

Map = tuple[tuple[float | None, ...], ...]
Verdicts = tuple[tuple[bool | None, ...], ...]


@dataclass(frozen=True)
class Thresholds:
    """What counts as seen and resolved.

    Attributes:
        noise: relative standard deviation g of one reading of the ratio.
        seen: change of the ratio, times the noise.
        resolved: standard deviation of ln E_object.
    """

    noise: float = NOISE
    seen: float = 3.0
    resolved: float = RESOLVED

    @property
    def change(self) -> float:
        """Of the ratio that is seen, relative."""
        return self.seen * self.noise

    def __post_init__(self) -> None:
        """Raise ``InputError`` for numbers that are no thresholds."""
        checked_noise(self.noise)
        for name in ("seen", "resolved"):
            value = getattr(self, name)
            if not 0 < value < MOST:
                raise InputError(name, value, f"a number above 0 and below {MOST:g}")


@dataclass(frozen=True)
class Detectability(Notebook):
    """Maps over depths (rows) and diameters (columns); None where the sphere does not fit.

    Attributes:
        depth, diameter: m, shapes (k,) and (m,).
        change: eq. MA.1, shape (k, m); None too where a stress is below its own error.
        standard_deviation: eq. MA.2; None too where the ratio does not depend on E_object.
        error: bound on the error of ``change``, absolute.
        seen, resolved: verdicts; None too where the error leaves them open.
        above_error: whether the change is above its error bound; where it is not there may still be a verdict: not seen.
        noise, seen_threshold, resolved_threshold: of the verdicts, the second on |change|.
        ratio_without: R_0, with the other inclusions in place.
        evaluator, seconds, plan, warnings: see ``solver.results.result.Result``.
        scene: that was asked about.
        provenance: see ``geometry.provenance.block``.
    """

    DIMENSIONS = ("depth", "diameter")
    depth: tuple[float, ...]
    diameter: tuple[float, ...]
    change: Map
    standard_deviation: Map
    error: Map
    seen: Verdicts
    resolved: Verdicts
    above_error: Verdicts
    noise: float
    seen_threshold: float
    resolved_threshold: float
    ratio_without: float | None
    evaluator: str
    seconds: float
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    scene: Scene | None = field(default=None, compare=False, repr=False)
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design detectability``."""
        return asdict(replace(self, scene=None), dict_factory=without_scene)

    def plot(self) -> Figure:
        """Draw what ``probe-design detectability --plot`` draws; returns the figure, whose ``savefig`` writes it.

        Raises:
            InputError: it was made by hand, without its scene.
        """
        from probe_design.maps.detectability_plot import figure_of

        return figure_of(self, drawn(self.scene))


def detectability(
    scene: Scene, depths: Floats, diameters: Floats, limits: Thresholds | None = None, *,
    accuracy: float | None = None, linear: bool = False, progress: Progress | None = None,
) -> Detectability:  # fmt: skip
    """Exchange the scene's target for spheres of other sizes at other depths.

    Args:
        scene: with a target, whose material and place beside the probe's axis are kept.
        depths: from the surface to the centre, m, shape (k,).
        diameters: m, shape (m,).
        limits: what counts as seen and resolved.
        accuracy: relative, of the ratio; left out: the noise, from 5e-4 to 0.01.
        linear: whether to answer linearly at any load, see ``solver.evaluate``.
        progress: called with spheres done and all, of those that need reflections.

    Raises:
        InputError: no target, or sizes that are not positive.
        Refusal: the scene is of a kind that the level cannot take, or its load is beyond what linear elasticity allows.
    """
    start = perf_counter()
    limits = limits or Thresholds()
    accuracy = float(np.clip(limits.noise, FINEST, COARSEST)) if accuracy is None else accuracy
    check_accuracy(accuracy)
    target_of(scene)
    check_spheres(scene, "detectability")
    rule = load_rule(scene)
    if not linear:
        check_load(scene, rule, accuracy, True, DOUBT)
    base = EquivalentInclusion().prepared(scene, budget(rule, rule.force(scene), accuracy, True))
    spheres = Spheres(scene, depths, diameters, base.field.states.model.section.tissue_radius)
    tumours, index, alone = spheres.tumours, scene.target or 0, readings(base, spheres.without)
    effects = _effects(base, readings(base, tumours, index, reflect=False), alone)
    unsure = np.flatnonzero(effects.open(limits))
    if len(unsure):
        again = readings(base, tumours.of_index(unsure), index, progress=progress, reflect=True)
        effects = effects.replaced(unsure, _effects(base, again, alone))
    load = LoadChanges.of(scene, rule, np.append(effects.stiffness, alone.stiffness))
    if not linear:
        check_load(scene, load.weakest, accuracy, True)
    effects = effects.loaded(load)
    maps = _maps(spheres.fits, effects, limits)
    return Detectability(
        depth=tuple(depths.tolist()),
        diameter=tuple(diameters.tolist()),
        **maps,
        noise=limits.noise,
        seen_threshold=limits.change,
        resolved_threshold=limits.resolved,
        ratio_without=float(alone.ratio[0]) if alone.resolved[0] else None,
        evaluator=EquivalentInclusion().name,
        seconds=perf_counter() - start,
        plan=(*base.plan, _reflections(base, len(unsure), len(effects.change))),
        warnings=(*base.notes, *_warnings(effects, limits), *load_notes(scene, load.weakest, accuracy, True)),
        scene=scene,
        provenance=provenance(scene, evaluator=EquivalentInclusion().name, accuracy=accuracy),
    )


@dataclass(frozen=True)
class _Effects:
    """What n spheres change, shape (n,) each.

    Attributes:
        has_ratio: whether there is a ratio.
        change, error: eq. MA.1 and a bound on its error; inf where there is no ratio.
        sensitivity, sensitivity_error: S and a bound on its error.
        stiffness: N/m.
    """

    has_ratio: Bools
    change: Floats
    error: Floats
    sensitivity: Floats
    sensitivity_error: Floats
    stiffness: Floats

    def loaded(self, load: LoadChanges) -> _Effects:
        """Return these with what the load changes in their errors: of R and R_0 each, and of S."""
        ratio, slope = load.ratio[:-1], load.log_sensitivity[:-1]
        factor = (1 + ratio) * (1 + load.ratio[-1])
        error = self.error * factor + np.abs(1 + self.change) * (factor - 1)
        sensitivity_error = self.sensitivity_error * (1 + slope) + np.abs(self.sensitivity) * slope
        return replace(self, error=error, sensitivity_error=sensitivity_error)

    def replaced(self, which: Ints, others: _Effects) -> _Effects:
        """Return these with some of them exchanged."""
        table = {field.name: getattr(self, field.name).copy() for field in fields(self)}
        for key, values in table.items():
            values[which] = getattr(others, key)
        return _Effects(**table)

    @property
    def above_error(self) -> Bools:
        """Whether the change is above its error bound."""
        return np.asarray(self.error < np.abs(self.change))

    def seen(self, limits: Thresholds) -> Floats:
        """Verdicts: 1, 0, or NaN where the error leaves it open."""
        return _verdict(np.abs(self.change), self.error, limits.change)

    def resolved(self, limits: Thresholds) -> Floats:
        """Verdicts likewise: sd <= resolved is |S| >= noise / resolved."""
        return _verdict(np.abs(self.sensitivity), self.sensitivity_error, limits.noise / limits.resolved)

    def open(self, limits: Thresholds) -> Bools:
        """Whether a verdict is open."""
        return np.asarray(np.isnan(self.seen(limits)) | np.isnan(self.resolved(limits)))


def _verdict(value: Floats, error: Floats, threshold: float) -> Floats:
    return np.where(value - error >= threshold, 1.0, np.where(value + error < threshold, 0.0, np.nan))


def _effects(base: Undisturbed, together: Readings, alone: Readings) -> _Effects:
    has_ratio = np.asarray(together.resolved & alone.resolved)
    change = np.where(has_ratio, together.ratio / np.where(alone.resolved, alone.ratio, 1.0) - 1, 0.0)
    error = np.where(has_ratio, np.abs(1 + change) * np.expm1(np.minimum(_log_error(base, together, alone), 700.0)), np.inf)
    return _Effects(
        has_ratio,
        change,
        error,
        together.log_sensitivity,
        np.where(has_ratio, together.sensitivity_error, np.inf),
        together.stiffness,
    )


def _log_error(base: Undisturbed, together: Readings, alone: Readings) -> Floats:
    """Bound on the error of ln(R / R_0), shape (n,).

    The tumours' own errors, and what those of the base states do to dF / F_0: for the rest they cancel in R / R_0.
    """
    films = base.films
    own = sum(np.abs((one.bound - films.bound.totals) / one.totals) for one in (together, alone))
    effect = np.abs((together.totals - alone.totals) / together.totals)
    share = np.minimum(own + CHANGES * films.relative_errors * effect, 0.999999)
    return np.asarray(-np.log1p(-share).sum(axis=1))


def _maps(fits: Bools, effects: _Effects, limits: Thresholds) -> dict[str, Any]:
    """Return the rows of each map, with None where there is nothing to say."""

    def rows(values: Floats, good: Bools) -> Map:
        table = np.full(fits.shape, np.nan)
        table[fits] = np.where(good & np.isfinite(values), values, np.nan)
        return tuple(tuple(None if np.isnan(value) else float(value) for value in row) for row in table)

    def verdicts(values: Floats) -> Verdicts:
        return tuple(tuple(None if value is None else value > 0 for value in row) for row in rows(values, effects.has_ratio))

    strong = effects.has_ratio & (effects.sensitivity != 0)
    deviation = limits.noise / np.where(strong, np.abs(effects.sensitivity), 1.0)
    return {
        "change": rows(effects.change, effects.has_ratio),
        "standard_deviation": rows(deviation, strong),
        "error": rows(effects.error, effects.has_ratio),
        "seen": verdicts(effects.seen(limits)),
        "resolved": verdicts(effects.resolved(limits)),
        "above_error": verdicts(effects.above_error.astype(float)),
    }


def _reflections(base: Undisturbed, count: int, n: int) -> Decision:
    feature = "what surface, blocks and floor send back of the tumours' fields"
    reason = f"modelled for {count} of {n} spheres, whose verdicts need it; elsewhere counted in error"
    return Decision(feature, count > 0, 0.0, base.accuracy, reason)


def _warnings(effects: _Effects, limits: Thresholds) -> Iterator[str]:
    n = len(effects.change)
    if not n:
        yield "no sphere of these diameters fits at these depths"
    unknown = int((~effects.has_ratio).sum())
    if unknown:
        yield f"all maps are null at {unknown} of {n} spheres that fit: a stress is below its own error"
    hidden = int((effects.has_ratio & ~effects.above_error).sum())
    if hidden:
        yield f"above_error is false at {hidden} of {n} spheres that fit: the error bound is above the change of the ratio itself"
    for name, verdict in (("seen", effects.seen(limits)), ("resolved", effects.resolved(limits))):
        count = int((effects.has_ratio & np.isnan(verdict)).sum())
        if count:
            yield f"{name} is null at {count} of {n} spheres that fit: the error bound leaves the verdict open"
