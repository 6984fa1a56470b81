"""The phase of the ratio: against the same equations with complex moduli, Taylor's theorem and laws of physics."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from geometry.scenes.film import Film
from geometry.scenes.scene_file import scene_from_dict, scene_to_dict
from geometry.scenes.scene_tables import Contact, Load
from geometry.scenes.variables import list_loss_factors, list_values
from solver import evaluate
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.phase.inertia import add_inertia_error, compute_inertia_number
from solver.phase.log_derivatives import differentiate_off_axis, differentiate_on_axis
from solver.phase.losses import compute_angle_spread, compute_loss_angles
from solver.phase.phase import LOSSLESS_NOTE, STEP_RAD, PhaseUnknown, compute_ratio_phase
from tests.support.complex_states import complex_ratio
from tests.support.paths import EXAMPLES
from tests.support.slow import slow_unless

COARSE = MESH_LEVELS[0]
LOSSES = {"tissue": 0.3, "inclusion": 0.2, "probe.inner": 0.05, "probe.outer": 0.1}


@cache
def example(name: str = "scene.toml", bonded: bool = True) -> Scene:
    scene = read_scene(EXAMPLES / name)
    return scene if bonded else scene.model_copy(update={"contact": Contact(interface="frictionless")})


def lossy(scene: Scene, times: float = 1.0, **loss_factors_given: float) -> Scene:
    """A scene whose materials have the loss factors above, or ``others``, times a number."""
    chosen = loss_factors_given or LOSSES
    factors = {key: chosen.get(key.removesuffix(".loss_factor"), 0.0) * times for key in list_loss_factors(scene)}
    return scene.replace(factors)


def first_order(scene: Scene) -> float:
    return float(differentiate_on_axis(scene, (compute_loss_angles(scene),), COARSE).directional[0])


SCENES = {
    "bonded": example(),
    "frictionless": example(bonded=False),
    "skin": example("skin.toml"),
}


@pytest.mark.parametrize("name", slow_unless("bonded".__eq__, SCENES))
def test_the_error_falls_eightfold_as_losses_are_halved(name: str) -> None:
    """The complex solution shares the mesh with the gradient, so that nothing but eq. PH.2 is left."""
    scenes = [lossy(SCENES[name], times, **{"tissue.layer[0]": 0.2} | LOSSES) for times in (0.4, 0.2, 0.1)]
    errors = [first_order(scene) - cmath.phase(complex_ratio(scene, COARSE)) for scene in scenes]
    assert errors[0] / errors[1] == pytest.approx(8, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(8, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", range(2))
def test_the_error_that_is_told_covers_the_complex_solution(name: str, seed: int) -> None:
    random, scene = np.random.default_rng(seed), SCENES[name]
    scene = scene.replace({key: float(random.choice([0.0, 0.1, 0.3, 0.6])) for key in list_loss_factors(scene)})
    scene = scene.model_copy(update={"load": Load(force=0.0)})  # at which the error is the phase's own
    result = evaluate(scene, linear=True)
    computed, true = compute_ratio_phase(scene, result, 0.01, 0.1), cmath.phase(complex_ratio(scene, MESH_LEVELS[4]))
    assert abs(computed.value - true) <= computed.error
    assert computed.error < max(0.3 * abs(true), 0.02 * compute_angle_spread(scene))


@pytest.mark.slow
@pytest.mark.parametrize("key", [name for name in list_values(example()) if name.startswith("probe") or "depth" in name])
def test_derivatives_are_those_of_the_phase(key: str) -> None:
    scene = lossy(example())
    derivative = compute_ratio_phase(scene, evaluate(scene, "axisymmetric"), 0.01, 0.1).derivatives[key]
    step = 1e-3 * list_values(scene)[key]
    upper, lower = (
        float(
            differentiate_on_axis(
                scene.replace({key: list_values(scene)[key] + s}), (compute_loss_angles(scene),), MESH_LEVELS[3]
            ).directional[0]
        )
        for s in (step, -step)
    )
    assert derivative == pytest.approx((upper - lower) / (2 * step), rel=2e-3, abs=1e-6 / list_values(scene)[key])


def test_where_all_materials_lose_alike_there_is_no_phase() -> None:
    scene = example().replace(dict.fromkeys(list_loss_factors(example()), 0.4))
    assert abs(first_order(scene)) < 1e-9
    assert compute_angle_spread(scene) == 0
    assert abs(cmath.phase(complex_ratio(scene, COARSE))) < 1e-9


def test_slopes_are_the_published_ones() -> None:
    """Of examples/scene.toml, by an independent trial: tissue, tumour, inner and outer block."""
    owners = ("tissue", "inclusion", "probe.inner", "probe.outer")
    derivatives = differentiate_on_axis(example(), [{owner: 1.0} for owner in owners], MESH_LEVELS[2]).directional
    assert derivatives == pytest.approx([0.13702, 0.04714, 0.01388, -0.19804], abs=5e-5)


def test_without_losses_the_slopes_are_told_all_the_same() -> None:
    result = evaluate(example(), "axisymmetric", frequency=1.0)
    assert result.ratio_phase == result.ratio_phase_error == 0
    assert LOSSLESS_NOTE in result.warnings
    derivatives = result.ratio_phase_derivatives
    assert derivatives is not None
    assert derivatives["tissue.loss_factor"] == pytest.approx(0.13702, abs=5e-5)
    assert derivatives["probe.gap"] == 0


@pytest.mark.slow
def test_off_the_axis_the_first_order_agrees_with_the_meridian() -> None:
    """On the axis both evaluators can compute; with reflections left out the phase is in error by no more than the ratio is."""
    scene = lossy(example())
    phase, exact = (
        float(differentiate(scene, (compute_loss_angles(scene),), MESH_LEVELS[3]).directional[0])
        for differentiate in (differentiate_off_axis, differentiate_on_axis)
    )
    assert phase == pytest.approx(exact, abs=0.01 * compute_angle_spread(scene))
    off_axis_scene = scene_from_dict(scene_to_dict(scene) | {"placement": {"x": "1 um"}})
    result = evaluate(off_axis_scene, "equivalent-inclusion", frequency=1.0)
    assert result.ratio_phase is not None
    assert result.ratio_phase_error is not None
    assert abs(result.ratio_phase - cmath.phase(complex_ratio(scene, MESH_LEVELS[3]))) <= result.ratio_phase_error


@pytest.mark.slow
def test_losses_of_each_of_several_tumours_add_up() -> None:
    scene = example("two-tumours.toml")
    phases = [evaluate(scene.replace({key: 0.1}), frequency=1.0, linear=True).ratio_phase for key in list_loss_factors(scene)]
    assert sum(value or 0.0 for value in phases) == pytest.approx(0, abs=1e-6)
    assert all(phases)


def test_kinds_without_derivatives_are_null_with_the_reason() -> None:
    scene = lossy(example())
    tilted = scene_from_dict(scene_to_dict(scene) | {"placement": {"tilt": "1 deg"}})
    with pytest.raises(PhaseUnknown, match="upright probes"):
        compute_ratio_phase(tilted, evaluate(scene, "closed-form"), 0.01, 1.0)
    with pytest.raises(PhaseUnknown, match="finite strain"):
        compute_ratio_phase(scene, replace(evaluate(scene, "closed-form"), evaluator="contact"), 0.01, 1.0)
    result = evaluate(scene, "published", frequency=1.0)
    assert result.ratio_phase is None
    assert any("ratio_phase is null" in text for text in result.warnings)


@pytest.mark.slow
def test_at_loads_beyond_linear_elasticity_no_phase_is_told() -> None:
    """There the derivative by the tissue's modulus is a quarter larger, and the ratio hardly another one."""
    result = evaluate(lossy(example()).model_copy(update={"load": Load(force=0.1)}), frequency=1.0)
    assert result.evaluator == "contact"
    assert result.ratio_phase is result.ratio_phase_error is None
    assert any("ratio_phase is null" in text for text in result.warnings)


@pytest.mark.parametrize("frequency", [0.0, math.nan, math.inf, 1e6, 300.0])
def test_frequencies_that_are_none_or_too_high_are_refused(frequency: float) -> None:
    with pytest.raises(InputError, match="frequency"):
        evaluate(lossy(example()), "closed-form", frequency=frequency)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bonded", "skin"])
@pytest.mark.parametrize("frequency", [1.0, 3.0, 5.0])
def test_inertia_is_within_what_it_is_counted_as(name: str, frequency: float) -> None:
    """Against the complex equations with masses: of the phase, and of the ratio, in whose error it did not count."""
    scene = lossy(SCENES[name], 1.0, tissue=0.1, inclusion=0.1)
    still, shaken = (complex_ratio(scene, MESH_LEVELS[1], f, 1100.0) for f in (0.0, frequency))
    assert abs(cmath.phase(shaken) - cmath.phase(still)) <= 2.0 * compute_inertia_number(scene, frequency) * compute_angle_spread(
        scene
    )
    with_zero = add_inertia_error(0.0, scene, frequency)
    assert with_zero is not None
    assert abs(math.log(abs(shaken / still))) <= with_zero


def test_tissue_that_swings_as_a_whole_has_no_phase() -> None:
    """Once it was given with a warning that its error did not count that."""
    scene = lossy(example())
    limit = 0.25 * math.sqrt(scene.tissue.youngs_modulus / (2 * (1 + scene.tissue.poisson_ratio)) / 1100.0) / scene.tissue.depth
    known = evaluate(scene, "closed-form")
    with pytest.raises(PhaseUnknown, match="may swing as a whole"):
        compute_ratio_phase(scene, known, 0.01, limit)


def test_the_step_is_small_enough() -> None:
    assert STEP_RAD**2 < 1e-3


@pytest.mark.parametrize("loss", [-0.1, 1.5, "0.1", True, math.nan])
@pytest.mark.parametrize("place", ["tissue", "inclusion", "probe.inner", "tissue.layer"])
def test_loss_factors_out_of_range_are_refused(loss: object, place: str) -> None:
    data = scene_to_dict(example("skin.toml"))
    table = {"tissue": data["tissue"], "inclusion": data["inclusion"][0], "probe.inner": data["probe"]["inner"]}
    (table | {"tissue.layer": data["tissue"]["layer"][0]})[place]["loss_factor"] = loss
    with pytest.raises(InputError, match=r"loss_factor = .*: allowed: tan delta, a number from 0 to 1"):
        scene_from_dict(data)


@pytest.mark.parametrize("place", ["base", "film"])
def test_base_and_films_have_no_losses(place: str) -> None:
    data = scene_to_dict(example())
    data["probe"].setdefault(place, {})["loss_factor"] = 0.1
    with pytest.raises(InputError, match="loss_factor"):
        scene_from_dict(data)


def taped(observable: str, times: float = 1.0) -> Scene:
    """The example with films between two tapes of 0.4 MPa, whose tan delta is 0.5 times a number; stiffer on the outer block."""
    tape = {"thickness": 50e-6, "youngs_modulus": 4e5, "poisson_ratio": 0.49, "loss_factor": 0.5 * times}
    film = {"bond_to_base": tape, "bond_to_block": tape, "outer": {"bond_to_base": tape | {"youngs_modulus": 8e5}}}
    probe = example().probe.model_copy(update={"film": Film.model_validate(film)})
    return example().model_copy(update={"probe": probe}).replace({"reading.observable": observable})


@pytest.mark.parametrize("observable", slow_unless("charge".__eq__, ["charge", "stress"]))
def test_losses_of_bonds_turn_what_is_read(observable: str) -> None:
    """Against the complex solution, as for the other materials; charges turn hundreds of times more than stresses do."""
    scenes = [taped(observable, times) for times in (0.4, 0.2)]
    phases = [cmath.phase(complex_ratio(scene, COARSE)) for scene in scenes]
    errors = [first_order(scene) - phase for scene, phase in zip(scenes, phases, strict=True)]
    assert errors[0] / errors[1] == pytest.approx(8, rel=0.15)
    assert abs(errors[1]) < 0.02 * abs(phases[1])
    assert (abs(phases[1]) > 0.01) == (observable == "charge")


def test_tape_turns_the_ratio_of_charges_by_the_published_phase() -> None:
    """FILM.md: a loss tangent of 0.5 of two tapes of 0.4 MPa turns it by 0.07 rad."""
    scene = taped("charge")
    film = scene.probe.film
    assert film is not None
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": film.model_copy(update={"outer": None})})})
    result = evaluate(scene, "axisymmetric", frequency=1.0)
    assert result.ratio_phase == pytest.approx(0.07, abs=5e-3)
    assert result.ratio_phase_error is not None
    assert result.ratio_phase_error < 0.01
    derivatives = result.ratio_phase_derivatives
    assert derivatives is not None
    # to first order the phase is a sum over both bonds, and d atan t / dt = 1 / (1 + t^2) with t = tan delta
    turned = sum(derivatives[f"probe.film.{side}.loss_factor"] for side in ("bond_to_base", "bond_to_block"))
    assert turned * (1 + 0.5**2) * math.atan(0.5) == pytest.approx(result.ratio_phase, rel=1e-9)


def test_off_the_axis_tapes_turn_charges_as_on_it() -> None:
    scene = taped("charge")
    scene = scene.replace({"tissue.loss_factor": 0.2, "inclusion.loss_factor": 0.1})
    phase, exact = (
        float(level(scene, (compute_loss_angles(scene),), MESH_LEVELS[2]).directional[0])
        for level in (differentiate_off_axis, differentiate_on_axis)
    )
    assert phase == pytest.approx(exact, abs=0.01 * compute_angle_spread(scene))
