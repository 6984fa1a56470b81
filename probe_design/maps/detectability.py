"""Map which tumours a probe detects, and which it resolves in stiffness, over depth and diameter.

A verdict holds for every error of the model within its bound. Where the bound leaves it open, the tumour is computed again with
reflections; where it stays open, there is no verdict (None).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance, build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Observable
from probe_design.data.noise import choose_accuracy
from probe_design.maps.scan import Progress
from probe_design.maps.sphere_effects import SphereEffects, Thresholds, compute_effects
from probe_design.maps.target_grid import Spheres, check_spheres, find_target
from solver.contact.evaluator import ContactEvaluator
from solver.equivalent_inclusion.evaluator import REFLECTIONS_FEATURE, EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.evaluators import check_accuracy
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import (
    LoadChanges,
    build_load_notes,
    check_known_load,
    compute_budget,
    is_load_linear,
    refuse_load,
)
from solver.planning.load_limits import build_limits, build_load_rule
from solver.results.film_charges import warn_of_read_bonds
from solver.results.load_limits import LoadedRecord, LoadLimits
from solver.results.result import Decision

Map = tuple[tuple[float | None, ...], ...]
Verdicts = tuple[tuple[bool | None, ...], ...]


@dataclass(frozen=True, repr=False)
class Detectability(LoadedRecord):
    """Maps over depths (rows) and diameters (columns); None where the sphere does not fit.

    Attributes
    ----------
    depth, diameter
        m, shapes (k,) and (m,).
    change
        eq. MA.1, shape (k, m); None also where a stress is below its error.
    standard_deviation
        eq. MA.2; None also where the ratio does not depend on E_object.
    error
        Bound on the error of ``change``, absolute.
    seen, resolved
        Verdicts on detection and resolution; None also where the error leaves them open.
    above_error
        Whether the change is above its error bound; where it is not, the verdict may still be: not detected.
    noise, seen_threshold, resolved_threshold
        Thresholds of the verdicts, the second on |change|.
    ratio_without
        R_0, the ratio without the target but with the other inclusions.
    observable
        What readings, and so all ratios here, are the ratio of: "charge" or "stress".
    evaluator, seconds, load_limits, plan, warnings
        See ``solver.results.result.Result``.
    scene
        The scene with its target.
    provenance
        See ``geometry.provenance.block``.
    """

    INTERNAL = ("scene",)
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
    observable: Observable
    evaluator: str
    seconds: float
    load_limits: LoadLimits | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    scene: Scene | None = field(default=None, compare=False, repr=False)
    provenance: Provenance | None = field(default=None, compare=False, repr=False)


def detectability(
    scene: Scene, depths: Floats, diameters: Floats, thresholds: Thresholds | None = None, *,
    accuracy: float | None = None, linear: bool = False, progress: Progress | None = None,
) -> Detectability:  # fmt: skip
    """Replace the scene's target by spheres of other sizes at other depths, and return the maps.

    Parameters
    ----------
    scene
        With a target, whose material and lateral offset are kept.
    depths
        From the surface to the centre, m, shape (k,).
    diameters
        m, shape (m,).
    thresholds
        Of detection and resolution.
    accuracy
        Relative, of the ratio; default: the noise, within 5e-4 and 0.01.
    linear
        Whether to use linear elasticity at any load, see ``solver.evaluate``.
    progress
        Called with the number of spheres done and their total, for spheres that need reflections.

    Raises
    ------
    InputError
        The scene has no target, or a size is not positive.
    Refusal
        The evaluator cannot model the scene, or its load is beyond what ``contact`` knows of tumours off the axis.
    """
    start = perf_counter()
    thresholds = thresholds or Thresholds()
    accuracy = choose_accuracy(thresholds.noise) if accuracy is None else accuracy
    check_accuracy(accuracy)
    find_target(scene)
    check_spheres(scene, "detectability")
    rule = build_load_rule(scene)
    if linear:
        check_known_load(scene, rule)
    base = EquivalentInclusion().prepare(scene, compute_budget(rule, rule.compute_force(scene), accuracy, True))
    spheres = Spheres(scene, depths, diameters, base.field.states.model.section.tissue_radius)
    tumours, index, readings_without = spheres.tumours, scene.target or 0, compute_readings(base, spheres.other_tumours)
    readings = compute_readings(base, tumours, index, reflect=False)
    load = LoadChanges.from_stiffness(scene, rule, np.append(readings.stiffness, readings_without.stiffness))
    is_linear = linear or is_load_linear(scene, load.weakest, accuracy, True)
    reason = None if is_linear else ContactEvaluator().refusal_off_axis(scene)
    if reason is not None:
        refuse_load(scene, load.weakest, accuracy, True, reason)
    pressed = None if is_linear else ContactEvaluator().press_tissue(scene, base.accuracy)
    films = base.films if pressed is None else pressed.bare.films
    if pressed is not None:
        load, readings_without = LoadChanges.from_contact(load), pressed.compute_readings(readings_without, spheres.other_tumours)

    def compare_readings(readings: Readings, tumours: Tumours) -> SphereEffects:
        """Return the effects of spheres from their linear readings, with that of the load."""
        loaded = readings if pressed is None else pressed.compute_readings(readings, tumours, index)
        return compute_effects(scene, films, loaded, readings_without)

    effects = compare_readings(readings, tumours)
    open_spheres = np.flatnonzero(effects.find_open(thresholds))  # to first order the verdict is open: reflections decide it
    if len(open_spheres):
        opened = tumours.select(open_spheres)
        reflected_readings = compute_readings(base, opened, index, progress=progress, reflect=True)
        effects = effects.replace_rows(open_spheres, compare_readings(reflected_readings, opened))
    read_without = readings_without.get_observable(scene)
    effects = effects.add_load_changes(load)
    evaluator = EquivalentInclusion().name if is_linear else ContactEvaluator().name
    maps = _build_maps(spheres.fits, effects, thresholds)
    return Detectability(
        depth=tuple(depths.tolist()),
        diameter=tuple(diameters.tolist()),
        **maps,
        noise=thresholds.noise,
        seen_threshold=thresholds.min_change,
        resolved_threshold=thresholds.resolved,
        ratio_without=float(read_without.ratio[0]) if read_without.resolved[0] else None,
        observable=scene.observable,
        evaluator=evaluator,
        seconds=perf_counter() - start,
        load_limits=build_limits(rule, accuracy, promise=True),
        plan=(*base.plan, _build_reflection_decision(base, len(open_spheres), len(effects.change))),
        warnings=(
            *warn_of_read_bonds(scene),
            *base.notes,
            *_iterate_warnings(effects, thresholds),
            *(build_load_notes(scene, load.weakest, accuracy, True) if is_linear else ()),
        ),
        scene=scene,
        provenance=build_provenance(scene, evaluator=evaluator, accuracy=accuracy),
    )


def _build_maps(fits: Bools, effects: SphereEffects, thresholds: Thresholds) -> JsonObject:
    """Return the rows of each map by name, with None where there is no value.

    Parameters
    ----------
    fits
        Which spheres of the grid fit, shape (k, m).
    effects
        Effects of the n spheres that fit.
    thresholds
        Of detection and resolution.
    """

    def build_rows(values: Floats, is_known: Bools) -> Map:
        """Return rows of the grid from values of the n spheres."""
        table = np.full(fits.shape, np.nan)
        table[fits] = np.where(is_known & np.isfinite(values), values, np.nan)
        return tuple(tuple(None if np.isnan(value) else float(value) for value in row) for row in table)

    def build_verdicts(values: Floats) -> Verdicts:
        """Return rows of verdicts from values 1 (true), 0 (false) or NaN (open)."""
        rows = build_rows(values, effects.has_ratio)
        return tuple(tuple(None if value is None else value > 0 for value in row) for row in rows)

    has_sensitivity = effects.has_ratio & (effects.sensitivity != 0)
    deviation = thresholds.noise / np.where(has_sensitivity, np.abs(effects.sensitivity), 1.0)
    return {
        "change": build_rows(effects.change, effects.has_ratio),
        "standard_deviation": build_rows(deviation, has_sensitivity),
        "error": build_rows(effects.error, effects.has_ratio),
        "seen": build_verdicts(effects.decide_detection(thresholds)),
        "resolved": build_verdicts(effects.decide_resolution(thresholds)),
        "above_error": build_verdicts(effects.above_error.astype(float)),
    }


def _build_reflection_decision(base: Undisturbed, count: int, n: int) -> Decision:
    """Return the line of the plan about reflections, modelled for ``count`` of n spheres."""
    reason = f"modelled for {count} of {n} spheres, whose verdicts need it; elsewhere counted in error"
    return Decision(REFLECTIONS_FEATURE, count > 0, 0.0, base.accuracy, reason)


def _iterate_warnings(effects: SphereEffects, thresholds: Thresholds) -> Iterator[str]:
    """Yield warnings about spheres without a ratio, with a change below its error, or with an open verdict."""
    n = len(effects.change)
    if not n:
        yield "no tumour of these diameters fits at these depths"
    unknown = (~effects.has_ratio).sum()
    if unknown:
        yield f"of {unknown} of {n} tumours nothing is known: under one of the blocks the stress is smaller than its own error"
    hidden = (effects.has_ratio & ~effects.above_error).sum()
    if hidden:
        yield f"{hidden} of {n} tumours change the ratio by less than the model's own error: how much is not known"
    verdicts = {"detected": effects.decide_detection(thresholds), "resolved in stiffness": effects.decide_resolution(thresholds)}
    for name, verdict in verdicts.items():
        count = (effects.has_ratio & np.isnan(verdict)).sum()
        if count:
            yield f"whether {count} of {n} tumours are {name} stays open: the model's error is larger than what decides it"
