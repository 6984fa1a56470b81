"""The measurements of ``axisymmetric.py``, one function for each kind of table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from time import process_time
from typing import TypeVar

import numpy as np

from benchmarks.peers import calculix_meridian as peer_calculix
from benchmarks.peers import ours
from benchmarks.peers.designs import LENGTHS, MATERIALS, VARIABLES
from benchmarks.peers.measured import KnownScene, PeerAnswer, limit_memory, time_runs, typical
from benchmarks.peers.ngsolve_curve import central_difference, solve_by_looping, solve_by_reusing
from benchmarks.peers.ngsolve_meridian import ALL_SINGULAR, MeridianSetting
from benchmarks.peers.ngsolve_meridian import evaluate as ngsolve_evaluate
from benchmarks.peers.ngsolve_settings import ACCURACIES, COARSE, EXACT, FINE, cheapest
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.results.evaluator import ProgressCallback

DIFFERENCE_STEP_RELATIVE = 0.01  # relative, of central differences: smaller ones drown in the changes of the mesh
DIFFERENCED_VARIABLES = {
    "sphere_depth": len(LENGTHS),
    "tissue.youngs_modulus": len(MATERIALS),
}  # and how many variables each stands for
GROWTH_LEVELS = (
    MeridianSetting(2, 2.0, 0.9, 2, singular=ALL_SINGULAR),
    *(MeridianSetting(4, 0.5, 0.3, 3, singular=ALL_SINGULAR, halvings=k) for k in range(5)),
)
CURVE_COLUMNS = (
    "scene",
    "ours error, error",
    "ours, ms",
    "NGSolve error, error",
    "looping, ms",
    "reusing, ms",
    "looping / ours, times",
    "reusing / ours, times",
)
T = TypeVar("T")


def seam(run: Callable[[], T], table: MeasuredTable) -> T | None:
    """Return what ours finds, or None with a note where there is no such function yet."""
    try:
        return run()
    except NotImplementedError as missing:
        table.note(f"not measured: {missing}")
        return None


def evaluations(cases: list[KnownScene], repeats: int, progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Compare one evaluation with NGSolve's cheapest, for each accuracy."""
    for accuracy in ACCURACIES:
        columns = ("scene", "code", "order", "unknowns, count", "true error, error", "mesh, ms", "solve, ms", "all, ms")
        table = MeasuredTable(f"a. one evaluation at {accuracy * 100:g} %", (*columns, "ours over it, times"))
        for case in cases:
            progress(f"one evaluation of {case.name} at {accuracy:g}")
            _evaluation(case, accuracy, repeats, table)
        table.note(
            "ours: with log-sensitivity and error estimate, all meshes it needs; first: the first call, which builds what is kept"
        )
        table.note(
            "cheapest: of all settings tried, the true value known; one for all: the cheapest that serves all five scenes;"
        )
        table.note("both the ratio alone, without an error estimate (ngsolve_settings.py)")
        yield table


def _evaluation(case: KnownScene, accuracy: float, repeats: int, table: MeasuredTable) -> None:
    first = ours.evaluate(case.scene, accuracy)
    mine = typical(partial(ours.evaluate, case.scene, accuracy), repeats)
    level = next(mesh_level for mesh_level in MESH_LEVELS if case.error(ours.one_mesh(case.scene, mesh_level).ratio) <= accuracy)
    bare = typical(partial(ours.one_mesh, case.scene, level), repeats)
    table.add(case.name, "ours, one mesh", level.order, bare.unknowns, case.error(bare.ratio), None, None, bare.seconds, None)
    for code, answer in (("ours, first", first), ("ours", mine)):
        table.add(case.name, code, None, None, case.error(answer.ratio), None, None, answer.seconds, None)
    for code, name in (("NGSolve, cheapest", case.name), ("NGSolve, one for all", "all")):
        setting = cheapest(name, f"{accuracy:g}")
        run = typical(partial(ngsolve_evaluate, case.scene, setting), repeats)
        error, mesh, factor = case.error(run.ratio), run.stages["mesh"], mine.seconds / run.seconds
        table.add(case.name, code, setting.order, run.unknowns, error, mesh, run.seconds - mesh, run.seconds, factor)
        if error > accuracy:
            table.note(f"{case.name}: {code} misses the accuracy with this release of NGSolve: run ngsolve_settings.py again")


def calculix(cases: list[KnownScene], progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Run CalculiX at each refinement with each of its elements."""
    columns = ("scene", "element", "unknowns, count", "true error, error", "mesh, ms", "write, ms", "ccx, ms", "all, ms")
    table = MeasuredTable("a. one evaluation by CalculiX", columns)
    if not peer_calculix.is_installed():
        table.note(peer_calculix.HOW_TO_GET)
        cases = []
    for case in cases:
        for element in peer_calculix.ELEMENTS:
            for fineness in peer_calculix.REFINEMENTS:
                progress(f"CalculiX on {case.name}, {element}")
                run = peer_calculix.evaluate(case.scene, fineness, element)
                table.add(case.name, element, run.unknowns, case.error(run.ratio), *run.stages.values(), run.seconds)
    yield table


def curves(cases: list[KnownScene], points: int, repeats: int, progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Compare whole curves at the first accuracy."""
    table = MeasuredTable(f"b. ratio and log-sensitivity at {points} moduli of the inclusion, {COARSE * 100:g} %", CURVE_COLUMNS)
    for case in cases:
        progress(f"curves of {case.name}")
        table.add(case.name, *_curve(case, case.moduli(points), repeats))
    table.note(f"errors: the largest along the curve of the ratio, relative, against NGSolve of order {EXACT.order}")
    table.note("looping: mesh and space kept, assembled and factorised for each modulus")
    table.note("reusing: K_0 and K_o assembled once, the sum factorised for each modulus in the ordering found first")
    yield table


def _curve(case: KnownScene, moduli: Floats, repeats: int) -> tuple[float, ...]:
    scene, setting = case.scene, cheapest(case.name, "curve")
    true = solve_by_reusing(scene, EXACT, moduli).curve
    mine, seconds = time_runs(lambda: ours.curve(scene, moduli, COARSE), repeats)
    loop, reuse = (typical(partial(run, scene, setting, moduli), repeats).seconds for run in (solve_by_looping, solve_by_reusing))
    error = solve_by_reusing(scene, setting, moduli).curve.largest_difference(true)[0]
    return mine.largest_difference(true)[0], seconds, error, loop, reuse, loop / seconds, reuse / seconds


def gradients(cases: list[KnownScene], points: int, repeats: int, progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Compare curves with all gradients, NGSolve's by central differences."""
    columns = (*CURVE_COLUMNS[:6], "finer error, error", "finer, ms", *CURVE_COLUMNS[6:], "finer / ours, times")
    table = MeasuredTable(f"c. the curve and its derivatives by {len(VARIABLES)} variables, {COARSE * 100:g} %", columns)
    for case in cases:
        progress(f"gradients of {case.name}")
        table.add(case.name, *_gradient(case, case.moduli(points), repeats, table))
    table.note(
        f"NGSolve: for each variable two curves, {DIFFERENCE_STEP_RELATIVE:g} up and down; timed for one length (with "
        "its meshes) and for one"
    )
    table.note(
        f"modulus, multiplied by {len(LENGTHS)} and {len(MATERIALS)}; finer: reusing, with the setting for 0.01 % in all scenes"
    )
    table.note("errors: the largest along the curve of d ln ratio / d ln sphere_depth, over its largest value, against the same")
    table.note(f"differences at order {EXACT.order}: NGSolve's are those of two meshes' errors, divided by the step")
    yield table


def _gradient(case: KnownScene, moduli: Floats, repeats: int, table: MeasuredTable) -> tuple[float | None, ...]:
    timed_gradients = seam(lambda: time_runs(lambda: ours.gradients(case.scene, moduli, COARSE), repeats), table)
    true = central_difference(solve_by_reusing, case.scene, EXACT, moduli, "sphere_depth", DIFFERENCE_STEP_RELATIVE)[0]
    setting, errors, totals = cheapest(case.name, "curve"), [], []
    for run, used in ((solve_by_looping, setting), (solve_by_reusing, setting), (solve_by_reusing, cheapest("all", f"{FINE:g}"))):
        pairs = {
            name: central_difference(run, case.scene, used, moduli, name, DIFFERENCE_STEP_RELATIVE)
            for name in DIFFERENCED_VARIABLES
        }
        totals.append(sum(number * pairs[name][1] for name, number in DIFFERENCED_VARIABLES.items()))
        errors.append(_compute_difference(pairs["sphere_depth"][0], true))
    theirs = (errors[0], totals[0], totals[1], errors[2], totals[2])
    if timed_gradients is None:
        return None, None, *theirs, None, None, None
    mine, seconds = timed_gradients
    return _compute_difference(mine["sphere_depth"], true), seconds, *theirs, *(total / seconds for total in totals)


def _compute_difference(values: Floats, true: Floats) -> float:
    return float(np.max(np.abs(values - true)) / np.max(np.abs(true)))


def factorisations(cases: list[KnownScene], points: int, repeats: int, progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Express our times in factorisations of our own matrix, with each library that is installed."""
    columns = (
        "scene",
        "library",
        "evaluate's, ms",
        "evaluate, times",
        "curve's, ms",
        "curve, times",
        "curve and gradients, times",
    )
    table = MeasuredTable(f"d. ours at {COARSE * 100:g} % in bare factorisations of its own matrix", columns)
    for case, library in product(cases, ours.libraries()):
        progress(f"factorisations of {case.name} by {library}")
        with ours.use_library(library):
            table.add(case.name, library, *_count_in_factorisations(case, case.moduli(points), repeats))
    table.note("processor time, all with their error estimates: one mesh or more; the factorisation is that of the matrix of the")
    table.note("last mesh of an evaluation and of a curve, its pattern known")
    yield table


def _count_in_factorisations(case: KnownScene, moduli: Floats, repeats: int) -> list[float]:
    single, bare = ours.bare_factorisation(case.scene, COARSE), ours.bare_factorisation(case.scene, COARSE, moduli)
    evaluation = time_runs(partial(ours.evaluate, case.scene, COARSE), repeats, process_time)[1]
    runs = (partial(f, case.scene, moduli, COARSE) for f in (ours.curve, ours.gradients))
    return [single, evaluation / single, bare, *(time_runs(run, repeats, process_time)[1] / bare for run in runs)]


def growth(cases: list[KnownScene], progress: ProgressCallback) -> Iterator[MeasuredTable]:
    """Show how time grows with the number of unknowns, for the first scene."""
    case, stages = cases[0], ("mesh", "assemble", "factorise", "solve")
    columns = ("code", "unknowns, count", "true error, error", *(f"{stage}, s" for stage in stages), "all, s")
    table = MeasuredTable(f"d. growth with the unknowns, {case.name}", columns)

    def add(code: str, answer: PeerAnswer) -> None:
        times = (answer.stages.get(stage) for stage in stages)
        table.add(code, answer.unknowns, case.error(answer.ratio), *times, answer.seconds)

    ngsolve_evaluate(case.scene, GROWTH_LEVELS[0])  # what is slow the first time only
    for setting in GROWTH_LEVELS:
        progress(f"growth: NGSolve, order {setting.order}, {setting.halvings} halvings")
        add(f"NGSolve, order {setting.order}", ngsolve_evaluate(case.scene, setting))
    progress("growth: ours")
    try:
        with limit_memory():
            for answer in ours.growth(case.scene):
                add("ours", answer)
    except (NotImplementedError, MemoryError, RuntimeError) as fault:  # SuperLU raises either for want of memory
        table.note(f"ours ends here: {fault}")
    yield table
