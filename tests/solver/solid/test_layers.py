"""Layers of tissue in three dimensions: against independent codes and other evaluators, one material cut up, films and bone."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from geometry import HalfSpaceTissue, Load, Refusal, Scene
from geometry.common.resources import LimitReached
from geometry.scenes.scene_tables import Layer
from solver import evaluate, plan
from solver.results.result import Result
from solver.solid.domain import choose_domain, compute_reach
from solver.solid.evaluator import SolidEvaluator
from solver.solid.regions import Region
from tests.support.meshes import LAYERED, scene_mesh
from tests.support.references import Expected, expected, named

pytestmark = pytest.mark.timeout(900)
BESIDE = "tissue-layers-off-axis"
ACROSS = named(BESIDE, LAYERED)


@pytest.fixture
def stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """The meshes of ACROSS: a tumour off the axis, across the interface of fat and ground, under a skin."""
    monkeypatch.setattr("solver.solid.film_forces.mesh_domain", partial(scene_mesh, name=LAYERED))


def solved(scene: Scene, accuracy: float = 0.05) -> Result:
    return SolidEvaluator().evaluate(scene, accuracy)


def with_moduli(scene: Scene, *moduli: float, poisson_ratio: float | None = None) -> Scene:
    """Other Young's moduli of the layers and, last, of what is below them."""
    tissue = scene.tissue
    ratios = [poisson_ratio or layer_or_tissue.poisson_ratio for layer_or_tissue in (*tissue.layer, tissue)]
    layers = tuple(
        layer.model_copy(update={"youngs_modulus": modulus, "poisson_ratio": ratio})
        for layer, modulus, ratio in zip(tissue.layer, moduli, ratios, strict=False)
    )
    values = {"youngs_modulus": moduli[-1], "poisson_ratio": ratios[-1], "layer": layers}
    return scene.model_copy(update={"tissue": tissue.model_copy(update=values)})


def assert_as_expected(result: Result, reference: Expected) -> None:
    """What is stated is not smaller than what is true, of ratio, stresses and stiffness."""
    assert result.error_estimate is not None
    for key in ("ratio", "stress_inner", "stress_outer", "stiffness"):
        assert abs(getattr(result, key) / getattr(reference, key) - 1) <= result.error_estimate + reference.uncertainty, key
    assert result.error_estimate <= 0.05
    if reference.log_sensitivity is not None:
        assert result.log_sensitivity == pytest.approx(reference.log_sensitivity, rel=0.05)


@pytest.mark.slow
def test_against_an_independent_code_on_stored_meshes(stored: None) -> None:
    assert_as_expected(solved(ACROSS.scene), ACROSS)


@pytest.mark.slow
@pytest.mark.parametrize("name", [reference.name for reference in expected(BESIDE) if reference.name != LAYERED])
def test_against_an_independent_code(name: str) -> None:
    assert_as_expected(solved(named(BESIDE, name).scene), named(BESIDE, name))


@pytest.mark.slow
def test_on_the_axis() -> None:
    """The meshes know nothing of the symmetry: a tumour across two interfaces must come out as in the meridian plane."""
    reference = named("tissue-layers", "sphere-across-two")
    assert_as_expected(solved(reference.scene), reference)


@pytest.mark.slow
def test_layers_of_the_tissues_own_material_change_nothing(stored: None) -> None:
    """Against the evaluator of harmonics, which has no such planes."""
    whole = with_moduli(ACROSS.scene, 6e3, 6e3, 6e3, poisson_ratio=0.45)
    result = solved(whole)
    bare = whole.model_copy(update={"tissue": whole.tissue.model_copy(update={"layer": ()})})
    second_result = evaluate(bare, "equivalent-inclusion", 0.003)
    assert result.error_estimate is not None
    assert second_result.error_estimate is not None
    for key in ("ratio", "stiffness"):
        assert (
            abs(getattr(result, key) / getattr(second_result, key) - 1) <= result.error_estimate + second_result.error_estimate
        ), key


@pytest.mark.slow
@pytest.mark.parametrize("moduli", [(5e9, 5e3, 5e3), (56e3, 5e3, 5e9), (5e-3, 5e3, 5e3)])
def test_contrasts_of_a_million_are_right_or_refused(moduli: tuple[float, ...]) -> None:
    """A plate of bone, bone below, a skin like a liquid: against the meridian plane."""
    scene = with_moduli(named("tissue-layers", "bone-below").scene, *moduli)
    scene = scene.model_copy(update={"load": Load(indentation=1e-6)})
    truth = evaluate(scene, "axisymmetric", 1e-3)
    try:
        result = solved(scene)
    except Refusal:
        return
    assert truth.ratio is not None
    assert result.ratio is not None
    assert result.error_estimate is not None
    assert abs(result.ratio / truth.ratio - 1) <= result.error_estimate + (truth.error_estimate or 0.0)


@pytest.mark.slow
def test_a_curve_of_a_tumour_across_an_interface_is_what_evaluations_are(stored: None) -> None:
    modulus_curve = SolidEvaluator().curve(ACROSS.scene, np.array([1e3, 1e6]), 0.05)
    body = ACROSS.scene.inclusion[0].model_copy(update={"youngs_modulus": 1e6})
    single = solved(ACROSS.scene.model_copy(update={"inclusion": (body,)}))
    assert modulus_curve.ratio[1] == pytest.approx(single.ratio, rel=1e-5)
    assert modulus_curve.log_sensitivity[1] == pytest.approx(single.log_sensitivity, rel=1e-3, abs=1e-7)


def test_a_film_too_thin_to_be_meshed_within_the_limits_is_refused_at_once() -> None:
    film = Layer(thickness=1e-5, youngs_modulus=1e6, poisson_ratio=0.45)
    tissue = ACROSS.scene.tissue.model_copy(update={"layer": (film,)})
    with pytest.raises(LimitReached, match=r"memory = 2 GB: allowed: .* equations of some") as refused:
        solved(ACROSS.scene.model_copy(update={"tissue": tissue}))
    assert "\n" not in str(refused.value)


def test_layers_below_what_is_modelled_are_cut_off_with_it() -> None:
    """On a half-space: what the mesh does not reach is its last layer's material, and its effect part of the far tissue's."""
    layers = tuple(Layer(thickness=t, youngs_modulus=e, poisson_ratio=0.45) for t, e in ((1e-3, 5e4), (40e-3, 3e3), (1.0, 1e5)))
    endless = HalfSpaceTissue(shape="half-space", youngs_modulus=1e9, poisson_ratio=0.3, layer=layers)
    scene = ACROSS.scene.model_copy(update={"tissue": endless})
    near_tissue, far = (choose_domain(scene, times * compute_reach(scene), None).scene.tissue for times in (1.0, 2.0))
    assert (len(near_tissue.layer), near_tissue.youngs_modulus) == (
        1,
        3e3,
    )  # an interface just above the cut would leave a flat slice
    assert (len(far.layer), far.youngs_modulus) == (2, 1e5)


def test_regions_are_told_by_their_numbers() -> None:
    for region in (Region(5), Region(7, 3), Region(5, 0, True), Region(1004, 8, True)):
        assert Region.from_number(region.number) == region


@pytest.mark.slow
@pytest.mark.parametrize("change", ["beside", "several", "tilted", "ellipsoid"])
def test_auto_comes_here_for_layers_that_no_cheaper_level_takes(change: str) -> None:
    scene = ACROSS.scene.model_copy(update={"load": Load(force=1e-3)})  # that the rule for loads allows
    body = scene.inclusion[0]
    if change == "several":
        mirrored = body.model_copy(update={"x": -body.x, "target": True})
        scene = scene.model_copy(update={"inclusion": (body, mirrored)})
    elif change == "tilted":
        scene = scene.model_copy(update={"placement": scene.placement.model_copy(update={"tilt": 1e-4})})
    elif change == "ellipsoid":
        flat = body.model_copy(update={"diameter": None, "diameters": (8e-3, 8e-3, 5e-3)})
        scene = scene.model_copy(update={"inclusion": (flat,)})
    assert SolidEvaluator().refusal(scene) is None
    assert SolidEvaluator().may_help(scene, 0.01)
    assert plan(scene, 0.01).evaluator == "solid"


def test_no_inclusion_is_left_out_of_layers() -> None:
    """The bounds that would allow it know one material about all of them."""
    scene = ACROSS.scene
    body = scene.inclusion[0].model_copy(update={"target": True})
    speck = body.model_copy(update={"x": -0.02, "y": 0.01, "depth": 0.02, "diameter": 1e-3, "target": False})
    both_bodies = scene.model_copy(update={"inclusion": (body, speck)})
    bare = both_bodies.model_copy(update={"tissue": both_bodies.tissue.model_copy(update={"layer": ()})})
    assert len(plan(bare, 0.05).scene.inclusion) == 1
    assert len(plan(both_bodies, 0.05).scene.inclusion) == 2
