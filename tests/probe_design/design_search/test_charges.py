"""Designs whose films are bonded are judged by the ratio of their charges, those of stress scenes as before."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import read_scene
from geometry.scenes.scene import Scene
from probe_design.design_search.objective_bounds import compute_objective
from probe_design.design_search.tumour_objective import FiniteElementObjective, Noise
from probe_design.design_search.tumour_study import TumourStudy
from probe_design.design_search.variables import read_vector
from probe_design.design_search.verification import TumourVerification, evaluate_films, verify_tumour_design
from solver import evaluate
from solver.casadi_functions.finite_elements import CHARGE_OUTPUTS, STRESS_OUTPUTS, FilmCallback
from tests.support.paths import ROOT

TAPE = {"thickness": 50e-6, "youngs_modulus": 0.4e6, "poisson_ratio": 0.49}  # FILM.md: two tapes of 0.4 MPa
NOISE, EXAMPLE = Noise(), read_scene(ROOT / "examples/scene.toml")


def build_taped(height: float, observable: str | None = None) -> Scene:
    """Return the example scene, blocks of 4 mm radius, with this height and films between two tapes."""
    tables = EXAMPLE.replace({"probe.height": height}).model_dump(exclude_unset=True)
    tables["probe"]["film"] = {"bond_to_base": TAPE, "bond_to_block": TAPE}
    if observable:
        tables["reading"] = {"observable": observable}
    return Scene.from_tables(tables)


def verify(height: float, observable: str | None = None) -> TumourVerification:
    """Verify the example with this height of its blocks."""
    return verify_tumour_design(build_taped(height, observable), NOISE, "axisymmetric")


def test_charges_rank_heights_otherwise_than_forces() -> None:
    """FILM.md: log-sensitivity 0.017 by charge, 0.050 by force at 1.5 mm; forces select 1.5 mm, charges 6 mm, at 10 mN."""
    values, sensitivities = {}, []
    for observable in ("charge", "stress"):
        for height in (1.5e-3, 6e-3):
            start = build_taped(height, observable)
            films = evaluate_films(start, "axisymmetric").films[0]
            values[observable, height] = compute_objective(start, films, NOISE, 0.01)
            sensitivities.append(films.get_observable(start).log_sensitivity)
    assert [sensitivities[0], sensitivities[2]] == pytest.approx([0.017, 0.050], abs=0.0005)
    assert values["stress", 1.5e-3] < values["stress", 6e-3]
    assert values["charge", 6e-3] < 0.5 * values["charge", 1.5e-3]


def test_the_charge_noise_is_that_of_the_charges_of_each_film() -> None:
    """The sd by hand, eqs. DS.4 to DS.6, from the public result: its charges at the load and their log-sensitivity."""
    verified, noise = verify(3e-3), NOISE
    result = evaluate(verified.loaded_scene, evaluator="axisymmetric")
    variance = noise.ratio**2 + (noise.charge / result.charge_inner) ** 2 + (noise.charge / result.charge_outer) ** 2
    assert verified.value == pytest.approx(np.sqrt(variance) / result.charge_log_sensitivity, rel=1e-6)
    assert verified.lower < verified.value < verified.upper


def test_bounds_of_the_objective_hold_against_a_finer_mesh() -> None:
    """The sd at a tenth of the error lies within the bounds stated at the larger error."""
    coarse = verify_tumour_design(build_taped(3e-3), NOISE, "axisymmetric", 0.05)
    fine = verify_tumour_design(build_taped(3e-3), NOISE, "axisymmetric", 0.002)
    assert coarse.lower <= fine.value <= coarse.upper
    assert fine.upper - fine.lower <= coarse.upper - coarse.lower


def test_derivatives_of_the_objective_by_charges_are_exact() -> None:
    """Central differences of the objective in each variable."""
    start = build_taped(3e-3)
    study = TumourStudy.from_scene(start)
    objective = FiniteElementObjective(study.objective, study.search_space, start, "axisymmetric")
    x = read_vector(start, study.search_space.names)
    which, poisson = list(range(len(x))), study.search_space.start_poisson
    derivatives = objective.gradient(x, poisson, which)[1][0]
    for k in which:
        values = [objective.gradient(x * np.exp(step * np.eye(len(x))[k]), poisson, which)[0][0] for step in (1e-4, -1e-4)]
        assert (values[0] - values[1]) / 2e-4 == pytest.approx(derivatives[k], rel=2e-4, abs=2e-6)
    assert objective.gradient(x, poisson, which)[0][0] == pytest.approx(-np.log(study.verify(start).value), abs=0.03)


def test_outputs_for_ipopt_are_those_that_the_scene_reads() -> None:
    """Stress scenes keep their four outputs; those of charges equal the evaluator's result."""
    assert FilmCallback(EXAMPLE, ("probe.gap",)).output_names == STRESS_OUTPUTS
    start = build_taped(3e-3)
    films = FilmCallback(start, ("probe.gap", "probe.film.thickness"), 0.002)
    assert films.output_names == CHARGE_OUTPUTS
    values, _ = films.compute(np.array([start.probe.gap, start.probe.film.thickness]))
    result = evaluate(start, evaluator="axisymmetric", accuracy=0.002)
    np.testing.assert_allclose(values, [getattr(result, name) for name in CHARGE_OUTPUTS], rtol=0.01)
