"""Tissue of layers in the meridian plane: against an independent code, one material cut up, laws, derivatives, refusals."""

import json
import re

import numpy as np
import pytest

from geometry import Refusal, Scene, read_scene
from geometry.common.errors import InputError
from geometry.scenes.scene_file import scene_from_toml
from geometry.scenes.units import SI_CONTEXT
from geometry.scenes.variables import list_values
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import compute_gradients
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.evaluation import evaluate, plan
from tests.support.paths import REFERENCE, SCENE
from tests.support.slow import slow_unless

FOLDER = REFERENCE / "tissue-layers"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
QUICK = ("breast", "sphere-across")
EXAMPLE = read_scene(SCENE)
OWN = (EXAMPLE.tissue.youngs_modulus, EXAMPLE.tissue.poisson_ratio)


def add_layers(*layers: tuple[float, ...], scene: Scene = EXAMPLE, **changes) -> Scene:
    """The example on layers, (thickness in mm, Young's modulus in Pa, Poisson's ratio of 0.45 unless it is given)."""
    names = ("thickness", "youngs_modulus", "poisson_ratio")
    tables = [dict(zip(names, (1e-3 * row[0], *row[1:], 0.45)[:3], strict=True)) for row in layers]
    data = scene.model_dump(exclude_unset=True)
    return Scene.model_validate(data | {"tissue": data["tissue"] | {"layer": tables}} | changes, context=SI_CONTEXT)


def cut(*thicknesses: float) -> Scene:
    """The example's one material as layers of itself."""
    return add_layers(*((thickness, *OWN) for thickness in thicknesses))


def forces(scene: Scene, level: int = 2):
    plain = build_sections(scene)
    return solve_on_mesh(plain.section, plain, scene, MESH_LEVELS[level])


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in EXPECTED])
def test_against_an_independent_code(name):
    """NGSolve's answers (benchmarks.references.axisymmetric): the true error is within the one that is stated."""
    scene, expected = read_scene(FOLDER / f"{name}.toml"), EXPECTED[name]
    for accuracy in (1e-2, 1e-4):
        result = Axisymmetric().evaluate(scene, accuracy)
        uncertain = expected["relative_uncertainty"]
        for key in ("ratio", "stress_inner", "stress_outer", "stiffness"):
            unit = {"ratio": "", "stiffness": "_n_per_m"}.get(key, "_pa")
            assert abs(getattr(result, key) / expected[f"{key}{unit}"] - 1) <= result.error_estimate + uncertain, key
        assert result.error_estimate <= accuracy
        if "log_sensitivity" in expected:
            assert result.log_sensitivity == pytest.approx(expected["log_sensitivity"], rel=5 * accuracy + uncertain, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("thicknesses", [(3.0,), (9.0,), (1.0, 6.5, 3.0), (12.7, 2.0)])
def test_a_layer_of_the_tissues_own_material_changes_nothing(thicknesses):
    whole, layered = Axisymmetric().evaluate(EXAMPLE, 1e-5), Axisymmetric().evaluate(cut(*thicknesses), 1e-5)
    for key in ("ratio", "stiffness", "log_sensitivity"):
        assert getattr(layered, key) == pytest.approx(getattr(whole, key), rel=2e-5)


@pytest.mark.slow
def test_figures_of_the_trial():
    """DATA.md's trial: a skin of 1.5 mm and 56 kPa moves the example's ratio by -32 %, 0.5 mm of 12 kPa by -3.9 %."""
    ratio = Axisymmetric().evaluate(EXAMPLE, 1e-3).ratio
    moved = [Axisymmetric().evaluate(add_layers(layer), 1e-3).ratio / ratio - 1 for layer in ((1.5, 56e3), (0.5, 12e3))]
    assert moved == pytest.approx([-0.32, -0.039], rel=0.02)


@pytest.mark.slow
def test_a_very_thick_layer_is_a_half_space_of_it():
    endless = EXAMPLE.tissue.model_dump(exclude_unset=True, exclude={"radius", "depth"}) | {"shape": "half-space"}
    alone = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless})
    rock = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless | {"youngs_modulus": 1e9}})
    result, expected = (Axisymmetric().evaluate(layered, 1e-4) for layered in (add_layers((5000.0, *OWN), scene=rock), alone))
    assert result.ratio == pytest.approx(expected.ratio, rel=2e-4)
    assert result.stiffness == pytest.approx(expected.stiffness, rel=3e-3)  # a radius over a distance is what rock there changes


@pytest.mark.slow
def test_a_stiff_layer_far_below_is_the_rigid_floor():
    data = EXAMPLE.model_dump(exclude_unset=True)
    rock = Scene.model_validate(data | {"tissue": data["tissue"] | {"depth": 70e-3, "youngs_modulus": 1e12}})
    result, expected = (Axisymmetric().evaluate(layered, 1e-4) for layered in (add_layers((50.0, *OWN), scene=rock), EXAMPLE))
    for key in ("ratio", "stiffness", "log_sensitivity"):
        assert getattr(result, key) == pytest.approx(getattr(expected, key), rel=2e-4)


APART, ACROSS = ((1.4, 56e3), (3.0, 2e3, 0.49)), ((1.4, 56e3), (6.0, 2e3, 0.49))
TWICE = ((6.0, 56e3), (6.0, 2e3), (4.0, 2e4))


EVERY = ("tissue.layer", "inclusion.depth")


@pytest.mark.parametrize(
    ("layers", "names"),
    [
        (TWICE, "tissue.layer[1].thickness"),
        *(pytest.param(layered_scene, EVERY, marks=pytest.mark.slow) for layered_scene in (APART, ACROSS, TWICE)),
    ],
)
def test_taylor_rate_is_two_by_every_number_of_the_layers(layers, names):
    """Apart from the sphere, across it, twice across it: half the step leaves a quarter of the remainder."""
    scene = add_layers(*layers)
    exact = compute_gradients(scene, forces(scene))
    for k, name in enumerate(exact.variables):
        if not name.startswith(names):
            continue
        left = []
        for step in (1e-3, 5e-4):
            value = list_values(scene)[name]
            moved = scene.replace({name: value * (1 + step)})
            computed = compute_gradients(moved, forces(moved), ())
            error = {key: computed.values[key][0] - exact.values[key][0] for key in ("ratio", "log_sensitivity")}
            left.append([change - exact.derivatives[key][0, k] * value * step for key, change in error.items()])
        np.testing.assert_allclose(np.divide(*left), 4, rtol=0.01)


def test_reciprocity_and_stiffness_grows_with_every_modulus():
    scene = add_layers((1.4, 56e3), (6.0, 2e3, 0.49))
    solution = forces(scene)
    assert solution.forces[0][0, 1] == pytest.approx(solution.forces[0][1, 0], rel=1e-9)
    exact = compute_gradients(scene, solution)
    by_name = zip(exact.variables, exact.derivatives["stiffness"][0], strict=True)
    grows = {name: derivative for name, derivative in by_name if name.endswith("youngs_modulus")}
    assert {"tissue.layer[0].youngs_modulus", "tissue.layer[1].youngs_modulus"} < grows.keys()
    assert min(grows.values()) > 0


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        (((5.0, 1e4, 0.5),), "tissue.layer[0].poisson_ratio"),
        (((0.0, 1e4),), "tissue.layer[0].thickness"),
        (((-1.0, 1e4),), "tissue.layer[0].thickness"),
        (((30.0, 1e4), (20.0, 1e4)), "tissue.layer[1].thickness = 20 mm: allowed: less than 20 mm"),
        (((1.0, 1e4),) * 9, "tissue.layer"),
    ],
)
def test_layers_that_do_not_fit_are_refused(layers, words):
    tables = "".join(
        f"[[tissue.layer]]\nthickness = '{layer[0]} mm'\nyoungs_modulus = '{layer[1]} Pa'\npoisson_ratio = "
        f"{(*layer[2:], 0.45)[0]}\n"
        for layer in layers
    )
    with pytest.raises(InputError, match="^" + re.escape(words)) as refused:
        scene_from_toml(SCENE.read_text(encoding="utf-8") + tables)
    assert "\n" not in str(refused.value)


CROSSED = REFERENCE / "crossed-spheres"
TRUE_CROSSED = json.loads((CROSSED / "expected.json").read_text())


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
@pytest.mark.parametrize("name", TRUE_CROSSED)
def test_spheres_across_interfaces_against_an_independent_code(name, accuracy):
    """Interfaces near a pole, several at once, contrasts of a thousand, a sphere wider than the probe: no bound is broken."""
    expected, result = TRUE_CROSSED[name], Axisymmetric().evaluate(read_scene(CROSSED / f"{name}.toml"), accuracy)
    assert result.error_estimate <= accuracy
    uncertain = expected["relative_uncertainty"]
    assert abs(result.ratio / expected["ratio"] - 1) <= result.error_estimate + uncertain
    promised = max(5 * accuracy * abs(expected["log_sensitivity"]), 1e-5)
    assert abs(result.log_sensitivity - expected["log_sensitivity"]) <= promised + uncertain


@pytest.mark.parametrize("pole", slow_unless((13.0).__eq__, [5.0, 13.0]))
def test_an_interface_that_touches_the_sphere_lies_between_those_beside_it(pole):
    """A thousandth of the radius more or less changes little, and either way alike."""
    outside, touching, inside = (
        Axisymmetric().evaluate(add_layers((pole + offset, 6e4)), 1e-4).ratio for offset in (-0.004, 0.0, 0.004)
    )
    assert touching == pytest.approx((outside + inside) / 2, rel=2e-4)
    assert min(outside, inside) - 1e-4 * touching < touching < max(outside, inside) + 1e-4 * touching


@pytest.mark.parametrize(
    ("change", "level"),
    [
        ({}, "axisymmetric for layers of tissue"),
        ({"inclusion": [EXAMPLE.inclusion[0].model_dump(exclude_unset=True) | {"x": 5e-3}]}, "equivalent-inclusion for layers"),
        ({"placement": {"tilt": 0.02}}, "solid for placement.tilt"),
    ],
)
def test_the_level_that_does_not_know_layers_names_one_that_does(change, level):
    with pytest.raises(Refusal, match=level):
        evaluate(add_layers((1.5, 56e3), **change), "published")


def test_the_plan_says_what_layers_change_and_what_a_skin_would():
    skin = plan(add_layers((1.5, 56e3)))
    (layer,) = (decision for decision in skin.decisions if decision.feature == "tissue.layer[0]")
    assert (skin.evaluator, layer.modelled) == ("contact", True)  # by the cautious rule its load is no small one under a skin
    assert layer.effect == pytest.approx(0.32, rel=0.15)
    assert not [note for note in skin.warnings if note.kind == "skin"]
    (line,) = (note for note in plan(EXAMPLE).warnings if note.kind == "skin")
    assert "1.4 mm and 56 kPa" in line


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [1e-3, 0.03, 1.0, 30.0])
@pytest.mark.parametrize("contrast", [1e-6, 1e3])
def test_extremes_are_answered_within_their_error_or_refused(thickness, contrast):
    """A finer answer is within the coarser one's stated error, whatever the layer."""
    scene = add_layers((thickness, contrast * OWN[0]))
    try:
        coarse, fine = (Axisymmetric().evaluate(scene, accuracy) for accuracy in (1e-2, 1e-5))
    except Refusal:  # so soft that the load drives the probe through the tissue
        assert contrast < 1
        return
    for key in ("ratio", "stress_inner", "stress_outer", "stiffness"):
        coarse_value, fine_value = getattr(coarse, key), getattr(fine, key)
        if coarse.error_estimate is not None and fine.error_estimate is not None:
            assert abs(coarse_value / fine_value - 1) <= coarse.error_estimate + fine.error_estimate, key
