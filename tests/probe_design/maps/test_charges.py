"""Scans, maps and estimates of a probe whose readings are ratios of charges, against results of the axisymmetric evaluator."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design.estimation.estimate import estimate
from probe_design.estimation.measurements import Reading
from probe_design.maps.detectability import Detectability, detectability
from probe_design.maps.scan import scan
from probe_design.maps.sphere_effects import Thresholds
from probe_design.reporting.detectability_figure import draw_detectability
from probe_design.reporting.scan_figure import draw_scan
from probe_design.terminal.estimate_table import build_estimate_table
from probe_design.terminal.result_tables import build_scan_table, build_threshold_table
from solver import evaluate
from solver.results.result import Result
from tests.support.paths import EXAMPLES
from tests.support.slow import slow_unless

TAPE = {"thickness": 50e-6, "youngs_modulus": 4e5, "poisson_ratio": 0.49}
TAPED: dict[str, object] = {"bond_to_base": TAPE, "bond_to_block": TAPE}
BY_PSI: dict[str, object] = {"psi1": 0.3, "psi2": 0.1}


def build(film: dict[str, object], observable: str = "charge", modulus: float | None = None) -> Scene:
    scene = read_scene(EXAMPLES / "scene.toml")
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": Film.model_validate(film)})})
    changes: dict[str, str | float] = {"reading.observable": observable, "load.force": "1 mN"}  # so little that all is linear
    return scene.replace(changes if modulus is None else changes | {"inclusion.youngs_modulus": modulus})


@cache
def solve(modulus: float | None = None, tumour: bool = True) -> Result:
    scene = build(TAPED, modulus=modulus)
    return evaluate(scene if tumour else scene.model_copy(update={"inclusion": ()}), "axisymmetric", 1e-3)


def test_a_scan_has_the_charges_at_every_position() -> None:
    line = scan(build(TAPED), "x", np.array([0.0, 6e-3]))
    alone, without = solve(), solve(tumour=False)
    assert line.charge_ratio is not None
    assert line.charge_ratio_error is not None
    assert line.charge_inner is not None
    assert line.charge_log_sensitivity is not None
    assert line.charge_ratio[0] == pytest.approx(alone.charge_ratio, rel=line.charge_ratio_error[0])
    assert line.charge_ratio[0] == pytest.approx(alone.charge_ratio, rel=2e-3)
    assert line.charge_log_sensitivity[0] == pytest.approx(alone.charge_log_sensitivity, rel=0.02)
    assert line.charge_inner[0] == pytest.approx(alone.charge_inner, rel=0.01)
    assert line.ratio[0] == pytest.approx(alone.ratio, rel=0.01)
    assert line.charge_ratio_without == pytest.approx(without.charge_ratio, rel=5e-3)
    assert (line.reading.ratio, line.reading_without) == (line.charge_ratio, line.charge_ratio_without)
    assert build_scan_table(line).headings[1] == "charge_ratio"
    figure = draw_scan(line, build(TAPED))
    assert any(axes.get_ylabel() == "ratio of inner to\nouter film charge" for axes in figure.axes)
    assert line.to_dataset()["charge_inner"].attrs["units"] == "C"


def test_by_stress_a_scan_is_that_without_the_key() -> None:
    stress, charge = (scan(build(TAPED, key), "x", np.array([0.0])) for key in ("stress", "charge"))
    assert stress.reading.ratio == stress.ratio
    assert stress.charge_ratio is not None  # they are there all the same
    assert stress.charge_ratio[0] == pytest.approx((charge.charge_ratio or (None,))[0], rel=1e-2)


@cache
def map_example(key: str) -> Detectability:
    body = build(TAPED).inclusion[0]
    thresholds = Thresholds(0.01)
    sizes = np.array([body.depth, 1.2 * body.depth]), np.array([body.diameter, 1.2 * (body.diameter or 0.0)])
    return detectability(build(TAPED, key), *sizes, thresholds)


def test_maps_show_what_the_charges_change() -> None:
    by_charge, by_stress = map_example("charge"), map_example("stress")
    alone, without = solve(), solve(tumour=False)
    assert alone.charge_ratio is not None
    assert without.charge_ratio is not None
    assert by_charge.observable == "charge"
    assert by_charge.ratio_without == pytest.approx(without.charge_ratio, rel=5e-3)
    change, error = by_charge.change[0][0], by_charge.error[0][0]
    assert change is not None
    assert error is not None
    expected = alone.charge_ratio / without.charge_ratio - 1
    assert abs(change - expected) <= error + 2e-3 * abs(expected)
    assert change == pytest.approx(expected, rel=0.05)
    assert by_charge.standard_deviation[0][0] == pytest.approx(0.01 / abs(alone.charge_log_sensitivity or 0.0), rel=0.05)
    assert by_stress.standard_deviation[0][0] == pytest.approx(0.01 / abs(alone.log_sensitivity or 0.0), rel=0.05)
    assert "film charges" in build_threshold_table(by_charge).title
    assert any("ratio of charges" in axes.get_ylabel() for axes in draw_detectability(by_charge, build(TAPED)).axes)


@pytest.mark.parametrize("modulus", slow_unless((3e4).__eq__, [1e4, 3e4, 2e5]))
def test_an_estimate_from_charges_covers_the_modulus_that_gave_them(modulus: float) -> None:
    ratio = solve(modulus).charge_ratio
    assert ratio is not None
    result = estimate(build(TAPED), (Reading(0.0, 0.0, ratio, 2e-3),))
    low, high = result.interval
    assert low is None or low < modulus
    assert high is None or high > modulus
    assert result.observable == "charge"
    assert json.loads(json.dumps(result.as_dict()))["observable"] == "charge"
    assert "ratio of film charges" in build_estimate_table(result).title
    if modulus == 3e4:
        assert result.value == pytest.approx(modulus, rel=0.1)


@pytest.mark.slow
def test_the_ratio_of_stresses_is_another_number() -> None:
    """Read as a ratio of charges it is explained by no modulus."""
    ratio = solve().ratio
    assert ratio is not None
    wrong = estimate(build(TAPED), (Reading(0.0, 0.0, ratio, 2e-3),))
    assert wrong.value is None
    assert "something in the scene is not as stated" in (wrong.reason or "")
    right = estimate(build(TAPED, "stress"), (Reading(0.0, 0.0, ratio, 2e-3),))
    assert right.value == pytest.approx(3e4, rel=0.1)


@pytest.mark.slow
def test_charges_by_psi_are_estimated_as_stresses() -> None:
    """Each charge is a multiple of the force, the same for both films: nothing else changes."""
    readings = (Reading(0.0, 0.0, 0.56, 0.01, stiffness=93.0), Reading(5e-3, 0.0, 0.53, 0.01))
    charge, stress = (estimate(build(BY_PSI, key), readings) for key in ("charge", "stress"))
    assert charge.interval == pytest.approx(stress.interval, rel=1e-9)
    assert charge.strength == pytest.approx(stress.strength, rel=1e-9)


@pytest.mark.slow
def test_phases_of_charges_by_tape_narrow_an_estimate() -> None:
    """The tape's losses turn the ratio over any tumour, to the same phase as ``evaluate`` has."""
    lossy = {"bond_to_base": TAPE | {"loss_factor": 0.3}, "bond_to_block": TAPE | {"loss_factor": 0.3}}
    result = evaluate(build(lossy), "axisymmetric", 1e-3, frequency=0.5)
    assert result.charge_ratio is not None
    assert result.ratio_phase is not None
    reading = Reading(0.0, 0.0, result.charge_ratio, 0.01, ratio_phase=result.ratio_phase, ratio_phase_sd=0.01)
    fitted = estimate(build(lossy), (reading,), nuisances={"probe.film.bond_to_base.loss_factor": "30 %"})
    assert fitted.value == pytest.approx(3e4, rel=0.1)
    assert fitted.p_value is not None
    assert fitted.p_value > 0.5
