"""Tumours by scattering against axisymmetric and 3D finite elements of independent codes, and against laws of physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geometry import Inclusion, Placement, Refusal, Scene
from solver import curve, evaluate
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from tests.support.references import Expected, expected, named
from tests.support.slow import slow_unless

LEVEL = "equivalent-inclusion"
GROOVED = ("groove-on-axis", "groove-over-tumour")
# origins in tests/reference/README.md
ON_AXIS = [reference for folder in ("axisymmetric", "extra", "extreme", "layers", "half-space") for reference in expected(folder)]
OFF_AXIS = [reference for folder in ("solid", "off-axis") for reference in expected(folder) if reference.name not in GROOVED]


def name(reference: Expected) -> str:
    return reference.name


def cover(scene: Scene) -> float:
    return min((body.depth / (body.diameter or max(body.diameters)) - 0.5 for body in scene.inclusion), default=1.0)


@pytest.mark.parametrize("reference", slow_unless(ON_AXIS[::16].__contains__, ON_AXIS), ids=name)
def test_on_the_axis(reference: Expected) -> None:
    result = evaluate(reference.scene, LEVEL, 0.01)
    if result.ratio is None or result.error_estimate is None:
        assert cover(reference.scene) < 0.025  # nothing is told of a probe far smaller than a sphere that it nearly touches
        return
    deviation = abs(result.ratio / reference.ratio - 1)
    assert deviation <= result.error_estimate + reference.uncertainty
    if cover(reference.scene) >= 0.1:
        assert deviation <= 0.003
        assert result.error_estimate <= 0.05
        if reference.log_sensitivity is not None:
            assert result.log_sensitivity == pytest.approx(reference.log_sensitivity, rel=0.025, abs=3e-5)


@pytest.mark.parametrize("reference", slow_unless(OFF_AXIS[::5].__contains__, OFF_AXIS), ids=name)
def test_off_the_axis(reference: Expected) -> None:
    result = evaluate(reference.scene, LEVEL, 0.005)
    assert result.ratio is not None
    assert result.error_estimate is not None
    deviation = abs(result.ratio / reference.ratio - 1)
    assert deviation <= result.error_estimate + reference.uncertainty
    if cover(reference.scene) >= 0.1 and all(body.diameter is not None for body in reference.scene.inclusion):
        assert deviation <= 0.003
    if reference.log_sensitivity is not None and all(body.diameter is not None for body in reference.scene.inclusion):
        # what the reference's two meshes leave of it is up to 1e-4, see tests/reference/README.md
        assert result.log_sensitivity == pytest.approx(reference.log_sensitivity, rel=0.025, abs=1e-4)


@pytest.mark.slow
def test_auto_takes_this_level_for_tumours_off_the_axis() -> None:
    scene = named("off-axis", "stiff-cover-0.25-offset-1").scene
    assert evaluate(scene, "auto", 0.005).evaluator == LEVEL


@pytest.mark.parametrize("reflect", [False, True])
def test_a_tumour_of_tissue_is_none(reflect: bool) -> None:
    scene = named("solid", "flank").scene
    base = solve_undisturbed(scene, 0.01)
    tissue = scene.tissue
    same_tumours = Tumours(
        0.004, 0.0, 0.006, diameter=0.008, youngs_modulus=[[tissue.youngs_modulus]], poisson_ratio=tissue.poisson_ratio
    )
    solution = compute_readings(base, same_tumours, reflect=reflect)
    assert solution.forces[0] == pytest.approx(base.films.forces, rel=1e-9)


def test_only_the_distance_from_the_axis_matters() -> None:
    base = solve_undisturbed(named("solid", "flank").scene, 0.01)
    angle = np.array([[0.0], [1.0], [2.5], [-2.0]])
    tumours = Tumours(0.004 * np.cos(angle), 0.004 * np.sin(angle), 0.006, diameter=0.008, youngs_modulus=6e4, poisson_ratio=0.45)
    for reflect in (False, True):
        forces = compute_readings(base, tumours, reflect=reflect).forces
        assert forces == pytest.approx(np.broadcast_to(forces[:1], forces.shape), rel=1e-9)


def test_near_the_axis_is_the_limit_of_on_it() -> None:
    base = solve_undisturbed(named("solid", "flank").scene, 0.003)
    x = np.array([[0.0], [2e-5]])  # the one by axisymmetric modes, the other by all orders
    forces = compute_readings(
        base, Tumours(x, 0.0, 0.006, diameter=0.008, youngs_modulus=6e4, poisson_ratio=0.45), reflect=True
    ).forces
    assert forces[1] == pytest.approx(forces[0], rel=2e-4)


def test_stiffness_rises_with_the_modulus_of_any_tumour() -> None:
    base = solve_undisturbed(named("solid", "flank").scene, 0.01)
    E = np.geomspace(60, 6e6, 9)[:, None]
    for reflect in (False, True):
        stiffness = compute_readings(
            base, Tumours(0.006, 0.0, 0.0055, diameter=0.008, youngs_modulus=E, poisson_ratio=0.45), reflect=reflect
        ).stiffness
        assert np.all(np.diff(stiffness) > 0)


@pytest.mark.parametrize("reflect", slow_unless(False.__eq__, [False, True]))
@pytest.mark.parametrize("key", ["depth", "diameter", "offset", "youngs_modulus", "poisson_ratio"])
def test_derivatives_by_the_tumours_own_numbers(key: str, reflect: bool) -> None:
    """Central differences of the film forces, which are integrals over the volume; derivatives are ones over the surface."""
    base = solve_undisturbed(named("solid", "flank").scene, 0.001)
    values = {"x": 0.006, "y": 0.0, "depth": 0.012, "diameter": 0.007, "youngs_modulus": 3e4, "poisson_ratio": 0.4}
    attribute = {"offset": "x"}.get(key, key)
    step = (2e-2 if reflect else 1e-3) * values[attribute]  # with reflections, numbers of modes change from place to place

    def forces(change: float) -> np.ndarray:
        moved = {**values, attribute: values[attribute] + change}
        return compute_readings(base, Tumours(*([[value]] for value in moved.values())), reflect=reflect).forces[0]

    derivative = compute_readings(
        base, Tumours(*([[value]] for value in values.values())), places=True, reflect=reflect
    ).derivatives[key][0]
    scale = 1.0 if key in ("offset", "poisson_ratio") else values[attribute]
    differences = (forces(step) - forces(-step)) / (2 * step)
    assert derivative / scale == pytest.approx(differences, abs=5e-3 * np.abs(differences).max())


@pytest.mark.parametrize("shape", [{}, {"diameter": None, "diameters": (4e-3, 3e-3, 2e-3)}], ids=["sphere", "ellipsoid"])
def test_curve_passes_through_evaluate_and_its_slope_is_the_sensitivity(shape: dict[str, object]) -> None:
    scene = named("solid", "flank").scene
    scene = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update=shape),)})
    moduli = scene.inclusion[0].youngs_modulus * np.array([0.98, 1.0, 1.02])
    modulus_curve = curve(scene, moduli, 0.003)
    assert modulus_curve.evaluator == LEVEL
    assert modulus_curve.ratio[1] == pytest.approx(evaluate(scene, LEVEL, 0.003).ratio, rel=1e-12)
    derivative = np.log(np.array(modulus_curve.ratio[2]) / modulus_curve.ratio[0]) / np.log(1.02 / 0.98)
    assert modulus_curve.log_sensitivity[1] == pytest.approx(derivative, rel=0.01)


def test_a_distant_tumour_is_left_out_and_counted() -> None:
    """Under a probe at the rim of a block a tumour at the other end lies beyond the cylinder that stands for the block."""
    scene = named("solid", "flank").scene
    tissue = {"shape": "block", "length": 0.4, "breadth": 0.05, "depth": 0.03, "youngs_modulus": 6e3, "poisson_ratio": 0.45}
    far = Inclusion(diameter=0.008, depth=0.01, x=-0.19, youngs_modulus=6e4, poisson_ratio=0.45)
    both_tumours = Scene.model_validate(
        {**scene.model_dump(exclude_unset=True), "tissue": tissue, "inclusion": (far.model_dump(exclude_unset=True),)}
    )
    moved = both_tumours.model_copy(update={"placement": Placement(x=0.1)})
    with_far, without_far = (
        evaluate(scene_evaluated, LEVEL, 0.05) for scene_evaluated in (moved, moved.model_copy(update={"inclusion": ()}))
    )
    assert with_far.ratio == without_far.ratio
    assert with_far.error_estimate >= without_far.error_estimate


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"contact": {"interface": "unilateral"}}, "unilateral"),
        ({"placement": {"tilt": 0.01}}, "tilt"),
        ({"inclusion": ({"surface": "tumour.stl", "depth": 0.01, "youngs_modulus": 1e4, "poisson_ratio": 0.4},)}, "sphere"),
    ],
)
def test_other_kinds_are_refused(change: dict[str, object], word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tumour.stl").touch()
    monkeypatch.chdir(tmp_path)
    scene = Scene.model_validate({**named("solid", "flank").scene.model_dump(exclude_unset=True), **change})
    assert word in str(EquivalentInclusion().refusal(scene))
    with pytest.raises(Refusal, match=word):
        evaluate(scene, LEVEL)


@pytest.mark.parametrize("reference", expected("spheroids"), ids=name)
def test_spheroids_near_the_surface_are_within_their_bounds(reference: Expected) -> None:
    for accuracy in (0.01, 0.003):
        result = evaluate(reference.scene, LEVEL, accuracy)
        assert abs(result.ratio / reference.ratio - 1) <= result.error_estimate + reference.uncertainty
        deviation = abs(result.log_sensitivity - reference.log_sensitivity)
        assert deviation <= max(5 * accuracy * abs(reference.log_sensitivity), 1e-5) or any(
            "log_sens" in text for text in result.warnings
        )


def ellipsoid(**changes: object) -> Scene:
    scene = named("off-axis", "ellipsoid-off-axis").scene
    data = scene.model_dump(exclude_unset=True)
    data["inclusion"] = ({**data["inclusion"][0], **changes},)
    return Scene.model_validate(data)


def test_a_nearly_round_ellipsoid_is_a_sphere() -> None:
    round_one = ellipsoid(diameters=(6e-3, 6.0001e-3, 6e-3))
    body = round_one.inclusion[0].model_dump(exclude_unset=True, exclude={"diameters", "orientation"})
    sphere = round_one.model_copy(update={"inclusion": (Inclusion(**{**body, "diameter": 6e-3}),)})
    spheroid, round_result = (evaluate(scene, LEVEL, 0.005) for scene in (round_one, sphere))
    assert spheroid.ratio == pytest.approx(
        round_result.ratio, rel=5e-5
    )  # the one by the table of strains, the other by the elements
    assert spheroid.log_sensitivity == pytest.approx(round_result.log_sensitivity, rel=2e-3)


def test_an_ellipsoid_is_the_same_with_its_axes_named_otherwise() -> None:
    first_result = evaluate(ellipsoid(diameters=(8e-3, 6e-3, 5e-3), orientation=(0.0, 0.0, 0.0)), LEVEL, 0.01)
    turned_result = evaluate(ellipsoid(diameters=(6e-3, 8e-3, 5e-3), orientation=(90.0, 0.0, 0.0)), LEVEL, 0.01)
    assert first_result.ratio == pytest.approx(turned_result.ratio, rel=2e-6)  # by quadratures with other points


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"diameters": (20e-3, 20e-3, 0.5e-3)}, "20 times"), ({"diameters": (10e-3, 10e-3, 1e-3), "depth": 1e-3}, "near a surface")],
)
def test_ellipsoids_beyond_the_level_are_refused(changes: dict[str, object], word: str) -> None:
    with pytest.raises(Refusal, match=word):
        evaluate(ellipsoid(**{"x": 0.0, "orientation": (0.0, 0.0, 0.0), **changes}), LEVEL, 0.01)


@pytest.mark.parametrize("turn", [0.65, 2.0])
def test_turning_tumours_at_different_azimuths_changes_nothing(turn: float) -> None:
    base = solve_undisturbed(named("solid", "flank").scene, 0.01)
    angle, offset = np.array([0.0, 1.9, 3.9]), np.array([0.004, 0.006, 0.005])

    def forces(added_azimuth: float) -> np.ndarray:
        x, y = offset * np.cos(angle + added_azimuth), offset * np.sin(angle + added_azimuth)
        tumours = Tumours(
            x[None],
            y[None],
            [[0.006, 0.0055, 0.0065]],
            diameter=[[0.006, 0.005, 0.006]],
            youngs_modulus=[[6e4, 6e2, 2e4]],
            poisson_ratio=0.45,
        )
        return compute_readings(base, tumours, reflect=True).forces[0]

    assert forces(turn) == pytest.approx(forces(0.0), rel=1e-9)


def test_modes_without_mirror_symmetry_say_the_same_as_those_with_it() -> None:
    """The second tumour is 10 um off the plane of the first: all modes and both families of waves are used."""
    base = solve_undisturbed(named("solid", "flank").scene, 0.003)
    pairs = [
        Tumours(
            [[0.004, -0.005]],
            [[0.0, y]],
            [[0.006, 0.0055]],
            diameter=[[0.006, 0.005]],
            youngs_modulus=[[6e4, 6e2]],
            poisson_ratio=0.45,
        )
        for y in (0.0, 1e-5)
    ]
    plane, free = (compute_readings(base, pair, reflect=True).forces[0] - base.films.forces for pair in pairs)
    assert free == pytest.approx(plane, abs=2e-5 * np.abs(plane).max())
