"""The key [reading] observable: results and curves of charges beside stresses, and what is said where there are none."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.scenes.film import Film
from probe_design.reporting.curve_figures import draw_curve, draw_load_curve
from probe_design.terminal.result_tables import build_curve_table, build_load_table, build_result_table, list_reading_lines
from solver import curve, evaluate, press
from tests.support.paths import EXAMPLES

TAPE = {"thickness": 50e-6, "youngs_modulus": 4e5, "poisson_ratio": 0.49}
MODULI = np.array([3e3, 3e4, 3e5])


def build(film: dict[str, object] | None, observable: str | None = None) -> Scene:
    """The example's scene with a film, and with the key where one is given."""
    scene = read_scene(EXAMPLES / "scene.toml")
    probe = scene.probe.model_copy(update={"film": None if film is None else Film.model_validate(film)})
    scene = scene.model_copy(update={"probe": probe})
    return scene if observable is None else scene.replace({"reading.observable": observable})


def test_bonds_decide_what_is_read_unless_the_key_does() -> None:
    taped = {"bond_to_base": TAPE, "bond_to_block": TAPE}
    assert [build(film).observable for film in (None, {}, {"psi1": 0.0}, taped)] == ["stress", "stress", "stress", "charge"]
    assert build(taped, "stress").observable == "stress"
    assert build({}, "charge").observable == "charge"


def test_psi_gives_the_ratio_of_the_forces() -> None:
    """Eq. (12) as printed makes each charge a multiple of the force: ratio and log-sensitivity are those of the stresses."""
    scene = build({"psi1": 0.3, "psi2": 0.1, "d31": 20e-12, "d32": 2e-12, "d33": -20e-12}, "charge")
    result = evaluate(scene, "closed-form")
    assert result.observable == "charge"
    assert result.charge_per_force_inner == pytest.approx(0.3 * 20e-12 + 0.1 * 2e-12 - 20e-12)
    assert result.charge_ratio == pytest.approx(result.ratio, rel=1e-12)
    assert result.charge_log_sensitivity == pytest.approx(result.log_sensitivity, rel=1e-12)
    assert result.charge_inner == pytest.approx(
        result.charge_per_force_inner * result.stress_inner * scene.probe.inner_area, rel=1e-9
    )


def test_a_charge_that_cancels_is_null_with_the_reason() -> None:
    """psi1 d31 = -d33: the film's charge vanishes at every force."""
    result = evaluate(build({"psi1": 1.0, "psi2": 0.0}, "charge"), "closed-form")
    assert result.charge_inner == 0
    assert result.charge_ratio is result.charge_per_force_inner is result.reading.ratio is None
    assert any("charge_inner is below its own error" in note for note in result.warnings)
    assert list_reading_lines(result) == []
    json.dumps(result.as_dict(), allow_nan=False)


def test_without_a_film_there_are_no_charges_and_no_word_of_them() -> None:
    result = evaluate(build(None), "closed-form")
    assert all(value is None for name, value in result.as_dict().items() if name.startswith("charge"))
    assert not any("charge" in note for note in result.warnings)
    assert list_reading_lines(result) == []


@pytest.mark.slow
@pytest.mark.parametrize("observable", ["charge", "stress"])
def test_curves_read_what_the_key_says(observable: str) -> None:
    scene = build({"bond_to_base": TAPE, "bond_to_block": TAPE}, observable)
    line = curve(scene, MODULI, 0.01)
    single = evaluate(scene.replace({"inclusion.youngs_modulus": 3e4}), "axisymmetric")
    assert line.charge_ratio is not None
    assert line.charge_log_sensitivity is not None
    assert line.ratio[1] == pytest.approx(single.ratio, rel=0.01)
    assert line.charge_ratio[1] == pytest.approx(single.charge_ratio, rel=0.01)
    # the log-sensitivity is the derivative: the ratio's change from end to end is its integral
    fine = curve(scene, np.geomspace(MODULI[0], MODULI[-1], 41), 0.01)
    change = np.trapezoid(np.array(fine.charge_log_sensitivity), np.log(fine.youngs_modulus))
    assert np.log(fine.charge_ratio[-1] / fine.charge_ratio[0]) == pytest.approx(change, rel=2e-3)  # type: ignore[index, operator]
    expected = (line.charge_ratio, line.charge_log_sensitivity) if observable == "charge" else (line.ratio, line.log_sensitivity)
    assert (line.reading.ratio, line.reading.log_sensitivity) == expected
    figure = draw_curve(line)
    assert figure.axes[0].get_ylabel() == f"ratio of inner to outer film {observable}"
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), expected[0])
    assert build_curve_table(line).headings[1] == ("charge_ratio" if observable == "charge" else "ratio")
    assert line.to_dataset()["charge_ratio"].shape == (3,)


def test_a_curve_without_charges_has_none() -> None:
    line = curve(build(None), MODULI, 0.05)
    assert line.charge_ratio is None
    assert "charge_ratio" not in line.to_dataset()


def test_the_table_shows_first_what_is_read_in_units_of_people() -> None:
    scene = build({"bond_to_base": TAPE, "bond_to_block": TAPE})
    charge = evaluate(scene, "axisymmetric")
    rows = {row[0]: row for row in build_result_table(charge).rows}
    assert next(iter(rows)) == "charge_inner"
    assert rows["charge_inner"][2] == "pC"
    assert float(rows["charge_per_force_inner"][1]) == pytest.approx(1e12 * (charge.charge_per_force_inner or 0.0), rel=1e-5)
    assert rows["charge_per_force_inner"][2] == "pC/N"
    (line,) = list_reading_lines(charge)
    assert line.startswith(f"A reading is the ratio of film charges, {charge.charge_ratio:.4g} within")
    stress = replace(charge, observable="stress")
    assert build_result_table(stress).rows[0][0] == "stress_inner"
    assert list_reading_lines(stress)[0].startswith(f"A reading is the ratio of film stresses, {charge.ratio:.4g} within")


@pytest.mark.slow
def test_under_load_charges_are_those_of_single_results() -> None:
    scene = build({"bond_to_base": TAPE, "bond_to_block": TAPE})
    line = press(scene, force=0.02, points=2)
    alone = evaluate(scene.replace({"load.force": 0.02}), "contact")
    assert line.charge_ratio is not None
    assert line.charge_inner is not None
    assert line.charge_ratio_error is not None
    assert alone.charge_ratio_error is not None
    assert line.charge_ratio[1] == pytest.approx(alone.charge_ratio, rel=line.charge_ratio_error[1] + alone.charge_ratio_error)
    assert line.charge_inner[1] == pytest.approx(alone.charge_inner, rel=0.01)
    assert line.charge_inner[0] == pytest.approx(line.charge_inner[1] / 2, rel=0.02)  # nearly proportional to the force
    assert line.reading.ratio == line.charge_ratio
    assert draw_load_curve(line).axes[0].get_ylabel() == "ratio of inner to outer film charge"
    assert build_load_table(line).headings[2] == "charge_ratio"
    assert line.to_dataset()["charge_ratio"].shape == (2,)
