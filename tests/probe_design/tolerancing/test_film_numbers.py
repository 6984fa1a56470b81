"""The uncertainty budget of charges: films and bonds count, with derivatives that are those of ``evaluate``."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.variables import list_values
from probe_design.built_probe.block_predictions import express_by_outer_radius
from probe_design.tolerancing.budget import ToleranceBudget, compute_budget
from probe_design.tolerancing.film_numbers import TAPE_COEFFICIENT_PER_K, TEMPERATURE_NAME
from probe_design.tolerancing.sample_statistics import sample_probes
from probe_design.tolerancing.uncertain_numbers import list_uncertain_numbers
from probe_design.workshop.ratio_budget import build_budget
from solver import evaluate
from tests.support.paths import EXAMPLES

TAPE, GLUE = "tape-50um", {"thickness": 20e-6, "youngs_modulus": 1e9, "poisson_ratio": 0.4}
FILM = {"bond_to_base": TAPE, "bond_to_block": TAPE, "electrode_inset": 2e-4}
SHARED = "film.tape-50um.youngs_modulus"


def build(film: dict[str, object], observable: str = "charge") -> Scene:
    scene = read_scene(EXAMPLES / "scene.toml")
    probe = scene.probe.model_copy(update={"film": Film.model_validate(film)})
    return scene.model_copy(update={"probe": probe}).replace({"reading.observable": observable})


@cache
def budget(force: str | None = None) -> ToleranceBudget:
    """Return the budget at the example's load, by ``contact``, or at another force."""
    scene = build(FILM)
    return compute_budget(scene if force is None else scene.replace({"load.force": force}), samples=64)


LIGHT = "1 mN"  # so little that all is linear
LOADS = [LIGHT, pytest.param(None, marks=pytest.mark.slow)]


def read(changes: dict[str, float]) -> np.ndarray:
    """ln of the ratio and of the stiffness, and the log-sensitivity, of charges."""
    result = evaluate(build(FILM).replace(changes), "axisymmetric", 1e-4, linear=True)
    assert result.charge_ratio is not None
    assert result.stiffness is not None
    return np.array([math.log(result.charge_ratio), math.log(result.stiffness), result.charge_log_sensitivity])


MOVED = ("probe.film.thickness", "probe.film.electrode_inset", "probe.film.bond_to_base.thickness", "probe.outer.youngs_modulus")


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVED)
def test_derivatives_are_those_of_results(name: str) -> None:
    """Central differences of ``evaluate`` at 3 % of the number."""
    value = list_values(build(FILM))[name]
    high, low = (read({name: value * (1 + step)}) for step in (0.03, -0.03))
    (line,) = (line for line in budget().lines if line.name == name)
    derivatives = [line.outputs[key].derivative for key in ("ln_ratio", "ln_stiffness", "log_sensitivity")]
    np.testing.assert_allclose(derivatives, (high - low) / (0.06 * value), rtol=0.03, atol=2e-4 / value)


@pytest.mark.parametrize("force", LOADS)
def test_one_product_deviates_as_one_and_temperature_moves_it(force: str | None) -> None:
    """Both tapes are unmeasured pieces of one product; at 7 % per kelvin its temperature changes both."""
    lines = {line.name: line for line in budget(force).lines}
    assert not any(name.endswith("bond_to_base.youngs_modulus") for name in lines)
    modulus = list_values(build(FILM))["probe.film.bond_to_base.youngs_modulus"]
    keys = [f"probe.film.{side}.youngs_modulus" for side in ("bond_to_base", "bond_to_block")]
    high, low = (read(dict.fromkeys(keys, modulus * math.exp(step)))[0] for step in (0.03, -0.03))
    by_log_modulus = (high - low) / 0.06
    assert by_log_modulus == pytest.approx(0.14, abs=0.03)  # FILM.md: d ln q / d ln E is +0.07 and -0.07
    assert lines[SHARED].outputs["ln_ratio"].derivative == pytest.approx(by_log_modulus / modulus, rel=0.02)
    assert lines[SHARED].sd == pytest.approx(0.69 * modulus)  # of the catalogue
    per_kelvin = lines[TEMPERATURE_NAME].outputs["ln_ratio"].derivative
    assert per_kelvin == pytest.approx(-TAPE_COEFFICIENT_PER_K * by_log_modulus, rel=0.02)
    assert abs(per_kelvin) == pytest.approx(0.01, abs=2e-3)  # FILM.md: 1 % of the ratio per kelvin


@pytest.mark.parametrize("force", LOADS)
def test_parts_add_up(force: str | None) -> None:
    shares = [line.outputs["ln_ratio"].share for line in budget(force).lines]
    assert sum(shares) == pytest.approx(1)
    assert budget(force).observable == "charge"
    assert budget(force).nominal["ratio"] == pytest.approx(evaluate(build(FILM), "axisymmetric").charge_ratio, rel=0.01)
    assert budget(force).samples > 0


@pytest.mark.parametrize("name", [*MOVED, "probe.film.d31", "probe.film.d33", SHARED, TEMPERATURE_NAME])
def test_samples_are_of_the_closed_form_s_charges(name: str) -> None:
    """Their derivatives against differences of ``evaluate``; of all tapes at once where these are one product."""
    scene = express_by_outer_radius(build(FILM))
    variables = list_uncertain_numbers(scene)
    index = [variable.name for variable in variables].index(name)
    number, values = variables[index], list_values(scene)
    tapes = [key for key in values if ".bond_to_" in key and key.endswith("youngs_modulus")]
    keys = tapes if name in (SHARED, TEMPERATURE_NAME) else [name]
    log_sd = -TAPE_COEFFICIENT_PER_K * number.sd if name == TEMPERATURE_NAME else number.sd / number.value
    step = 1e-3
    high, low = (
        evaluate(scene.replace({key: values[key] * (1 + change) for key in keys}), "closed-form", linear=True).charge_ratio
        for change in (step, -step)
    )
    statistics = sample_probes(scene, variables, 64, seed=0)
    assert statistics is not None
    assert high is not None
    assert low is not None
    assert statistics.derivatives[0, index] == pytest.approx(log_sd * math.log(high / low) / (2 * step), rel=1e-4, abs=1e-9)


@pytest.mark.slow
def test_measured_bonds_and_glue_deviate_on_their_own() -> None:
    film = {"bond_to_base": {"name": TAPE, "youngs_modulus": 4e5}, "bond_to_block": GLUE}
    lines = {line.name: line for line in compute_budget(build(film), samples=64).lines}
    assert lines["probe.film.bond_to_base.youngs_modulus"].sd == pytest.approx(0.02 * 4e5)
    assert lines["probe.film.bond_to_block.youngs_modulus"].sd == pytest.approx(0.02 * 1e9)
    assert TEMPERATURE_NAME in lines  # of the tape
    given = {TEMPERATURE_NAME: "1 K", "probe.film.thickness": "2 um", "probe.film.bond_to_base.youngs_modulus": "30 %"}
    sds = {line.name: line.sd for line in compute_budget(build(film), samples=64, given=given).lines}
    assert [sds[name] for name in given] == pytest.approx([1.0, 2e-6, 0.3 * 4e5])
    glued = {line.name for line in compute_budget(build({"bond_to_base": GLUE, "bond_to_block": GLUE}), samples=64).lines}
    assert TEMPERATURE_NAME not in glued
    with pytest.raises(InputError, match="from 0 K to 30 K"):
        compute_budget(build(film), samples=64, given={TEMPERATURE_NAME: "5 %"})


@pytest.mark.parametrize("force", LOADS)
def test_stresses_have_the_budget_of_the_blocks_alone(force: str | None) -> None:
    scene = build(FILM, "stress")
    scene = scene if force is None else scene.replace({"load.force": force})
    names = {line.name for line in compute_budget(scene, samples=64).lines}
    assert not any(name.startswith("probe.film") or name in (SHARED, TEMPERATURE_NAME) for name in names)


def test_charges_by_psi_have_the_budget_of_forces() -> None:
    """Each charge is a multiple of the force: contributions to ln ratio are those of the stresses, samples included."""
    charge, stress = (compute_budget(build({"psi1": 0.2, "psi2": 0.1}, key), samples=64) for key in ("charge", "stress"))
    assert charge.lines == stress.lines
    assert charge.outputs == stress.outputs


@pytest.mark.slow
def test_off_the_axis_films_and_bonds_count_as_on_it() -> None:
    """A micrometre off the axis the other evaluator has the derivatives, to first order in the tumour."""
    scene = build(FILM)
    moved = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={"x": 1e-6}),)})
    lines = {line.name: line for line in compute_budget(moved, samples=64).lines}
    for line in budget().lines:
        part, other = line.outputs["ln_ratio"], lines[line.name].outputs["ln_ratio"]
        assert other.contribution == pytest.approx(part.contribution, rel=0.05, abs=2e-4)


def test_drawings_name_films_and_bonds_in_words() -> None:
    scatters = {scatter.name: scatter.words for scatter in build_budget(build(FILM).probe, budget(LIGHT).lines, 0.01).scatter}
    assert scatters["probe.film.bond_to_base.thickness"] == "films' bond to base, thickness"
    assert scatters["probe.film.electrode_inset"] == "films' electrode inset"
    assert scatters[SHARED] == "tape-50um's modulus"
    assert scatters[TEMPERATURE_NAME] == "films' temperature"
    assert scatters["probe.outer.youngs_modulus"] == "outer block's modulus"
