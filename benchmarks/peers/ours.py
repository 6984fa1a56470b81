"""Run this project's side of ``axisymmetric.py``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import process_time

import numpy as np

from benchmarks.peers.measured import PeerAnswer, PeerClock, RatioCurve, Stopwatch, time_runs
from geometry import Scene
from geometry.common.arrays import Floats
from geometry.meridian.mesh_lines import MeridianFineness
from solver import evaluate as solver_evaluate
from solver.axisymmetric.base_states import build_model, solve_base_states
from solver.axisymmetric.energy_derivatives import list_variables
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import differentiate_areas, differentiate_by_section
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.linalg import cholesky as factor

GROWTH_FACTORS = (1, 2, 4, 8, 16)  # multiples of the coarsest mesh's cells in each direction, at order 4: 4e3 to 1e6 unknowns
SMALLEST_FINENESS = MeridianFineness(1, 0, 2)  # 1e3 unknowns


def evaluate(scene: Scene, accuracy: float) -> PeerAnswer:
    """Find the ratio within ``accuracy``, its error estimate included in the time."""
    start = PeerClock.now()
    result = solver_evaluate(scene, "axisymmetric", accuracy)
    return PeerAnswer(result.ratio or np.nan, 0, {"all": PeerClock.now() - start})


def one_mesh(scene: Scene, level: MeridianFineness) -> PeerAnswer:
    """Find the ratio on one mesh, without an error estimate."""
    sections = build_sections(scene)
    start = PeerClock.now()
    sample = solve_on_mesh(sections.section, sections, scene, level)
    inner, outer = sample.totals[0]
    ratio = inner / outer * scene.probe.outer_area / scene.probe.inner_area
    unknowns = sample.states.model.system.numbering.unknowns
    return PeerAnswer(float(ratio), unknowns, {"all": PeerClock.now() - start})


def curve(scene: Scene, moduli: Floats, accuracy: float) -> RatioCurve:
    """Find the curve over the inclusion's modulus, with its error estimate."""
    modulus_curve = Axisymmetric().curve(scene, moduli, accuracy)
    ratio, derivatives = (np.array(values, dtype=float) for values in (modulus_curve.ratio, modulus_curve.log_sensitivity))
    return RatioCurve(moduli, ratio, derivatives)


def gradients(scene: Scene, moduli: Floats, accuracy: float) -> dict[str, Floats]:
    """Find d ln ratio / d ln x along the curve for each variable x of ``designs.VARIABLES``, and what ``curve`` finds."""
    sample = Axisymmetric().compute_converged(scene, accuracy, moduli).sample
    logs = differentiate_by_section(sample).totals - differentiate_areas(scene, sample.states.model)
    derivatives = {}
    for k, name in enumerate(list_variables(sample.states.model)):
        body, _, what = name.partition("_")
        change = logs[:, k, 0] - logs[:, k, 1]
        ratios = {part.name.lower(): material.poisson_ratio for part, material in sample.states.model.materials.items()}
        if what == "poisson_ratio":
            change = change * ratios[body]
        derivatives[f"{body}.{what}" if what in ("youngs_modulus", "poisson_ratio") else name] = change
    return derivatives


@contextmanager
def use_library(library: str) -> Iterator[None]:
    """Factorise with SuperLU even where PARDISO is installed, or with what is installed."""
    usual = factor.load_pardiso
    if library == "SuperLU":
        factor.load_pardiso = lambda: None  # type: ignore[assignment]
    try:
        yield
    finally:
        factor.load_pardiso = usual


def libraries() -> tuple[str, ...]:
    """Names of the libraries that ``use_library`` can choose."""
    return ("SuperLU",) if factor.load_pardiso() is None else ("SuperLU", "PARDISO")


def bare_factorisation(scene: Scene, accuracy: float, moduli: Floats | None = None) -> float:
    """Return the processor seconds of factorising the matrix that an evaluation or a curve ends with; its pattern is known."""
    system = Axisymmetric().compute_converged(scene, accuracy, moduli).sample.states.model.system
    return time_runs(lambda: factor.factorise(system.matrix, system.numbering.pattern), 15, process_time)[1]


def growth(scene: Scene) -> Iterator[PeerAnswer]:
    """Solve on finer and finer meshes whose topologies are known, 1e3 to 1e6 unknowns."""
    sections = build_sections(scene)
    areas = scene.probe.outer_area / scene.probe.inner_area
    for fineness in (SMALLEST_FINENESS, *(MeridianFineness(cells, 3, 4) for cells in GROWTH_FACTORS)):
        for _ in range(2):  # the first time numbers the unknowns
            watch = Stopwatch()
            model = build_model(sections.section, sections.materials, scene.contact.interface, fineness)  # type: ignore[arg-type]
            watch.lap("assemble and factorise")
            forces = solve_base_states(model).forces.sum(axis=1)
            watch.lap("solve")
        yield PeerAnswer(float(forces[0] / forces[1] * areas), model.system.numbering.unknowns, watch.stages)
