"""`probe-design detectability` as a user runs it, against `axisymmetric` and 3D references."""

from __future__ import annotations

import json
import math
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from geometry import Load, Scene, read_scene
from probe_design.maps.detectability import detectability
from probe_design.maps.sphere_effects import Thresholds
from probe_design.maps.target_grid import choose_sizes
from solver import evaluate
from tests.support.paths import REFERENCE, SCENE
from tests.support.program import refused, run
from tests.support.references import expected
from tests.support.slow import slow_unless

KEYS = {
    "depth", "diameter", "change", "standard_deviation", "error", "seen", "resolved", "above_error", "noise", "seen_threshold",
    "resolved_threshold", "ratio_without", "observable", "evaluator", "seconds", "plan", "warnings",
    "linear_limit_load", "gap_closure_load", "load_limits", "provenance",
}  # fmt: skip


def with_sphere(scene: Scene, depth: float, diameter: float) -> Scene:
    body = scene.inclusion[0].model_copy(update={"depth": depth, "diameter": diameter})
    return Scene.model_validate(scene.model_copy(update={"inclusion": (body,)}).model_dump())


def test_json_and_picture(tmp_path: Path) -> None:
    picture = tmp_path / "map.png"
    sizes = ("--depth-from", "4 mm", "--depth-to", "20 mm", "--diameter-from", "1 mm", "--diameter-to", "12 mm")
    ended = run("detectability", SCENE, *sizes, "--noise", "0.01", "--points", "9", "--json", "--plot", picture)
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout, parse_constant=lambda word: pytest.fail(word))
    assert set(output) == KEYS
    assert output["depth"] == pytest.approx(np.linspace(4e-3, 20e-3, 9).tolist())
    assert output["seen_threshold"] == pytest.approx(0.03)
    assert output["noise"] == 0.01
    for key in ("change", "standard_deviation", "error", "seen", "resolved", "above_error"):
        assert [len(row) for row in output[key]] == [9] * 9
    for k, depth in enumerate(output["depth"]):
        for m, diameter in enumerate(output["diameter"]):
            fits = depth - diameter / 2 >= 0.025 * diameter
            assert (output["change"][k][m] is not None) == fits
            assert (output["error"][k][m] is not None) == fits
            if not fits:
                assert output["seen"][k][m] is output["resolved"][k][m] is output["standard_deviation"][k][m] is None
    assert output["seen"][0][0] is False  # 1 mm at 4 mm
    assert output["seen"][0][4] is True  # 6.5 mm at 4 mm
    assert matplotlib.image.imread(picture).shape[1] == 1430


POINTS = [(0.009, 0.008), (0.006, 0.004), (0.006, 0.009), (0.02, 0.012), (0.0051, 0.0092)]


@pytest.mark.parametrize(("depth", "diameter"), slow_unless(POINTS[:2].__contains__, POINTS))
def test_points_are_what_axisymmetric_says(depth: float, diameter: float) -> None:
    """Change within its bound, standard deviation = noise / S with the S of finite elements."""
    scene, noise = read_scene(SCENE), 0.02
    mapped = detectability(scene, np.array([depth]), np.array([diameter]), Thresholds(noise))
    with_it = evaluate(with_sphere(scene, depth, diameter), "axisymmetric", 1e-4)
    bare = evaluate(scene.model_copy(update={"inclusion": ()}), "axisymmetric", 1e-4)
    change = with_it.ratio / bare.ratio - 1
    assert mapped.change[0][0] == pytest.approx(change, abs=mapped.error[0][0] + 2e-4 * abs(change))
    assert mapped.standard_deviation[0][0] == pytest.approx(noise / with_it.log_sensitivity, rel=0.15)
    assert mapped.seen[0][0] in (None, abs(change) >= 0.06)
    assert mapped.resolved[0][0] in (None, noise / with_it.log_sensitivity <= 0.5)


BESIDE = [reference for reference in expected("off-axis") if "0.25" in reference.name]


@pytest.mark.parametrize("reference", slow_unless(BESIDE[:2].__contains__, BESIDE), ids=lambda reference: reference.name)
def test_tumours_beside_the_axis(reference: object) -> None:
    """The 3D references give the ratio without the tumour too."""
    scene: Scene = reference.scene  # type: ignore[attr-defined]
    body = scene.inclusion[0]
    ratio_without = json.loads((REFERENCE / "off-axis" / "expected.json").read_text())[reference.name]["ratio_without"]  # type: ignore[attr-defined]
    mapped = detectability(scene, np.array([body.depth]), np.array([body.diameter]))
    change = reference.ratio / ratio_without - 1  # type: ignore[attr-defined]
    assert mapped.change[0][0] == pytest.approx(change, abs=mapped.error[0][0] + 2e-4)
    assert mapped.seen[0][0] in (None, abs(change) >= 0.03)
    assert mapped.ratio_without == pytest.approx(ratio_without, rel=0.01)


@pytest.mark.slow
def test_verdicts_hold_with_less_error() -> None:
    """Verdicts at a coarse accuracy are those at a fine one, or open; noise scales standard deviations."""
    scene = read_scene(SCENE).model_copy(update={"load": Load(force=0.0)})
    depths, diameters = np.linspace(5e-3, 16e-3, 5), np.linspace(2e-3, 9e-3, 5)
    coarse, fine = (detectability(scene, depths, diameters, Thresholds(0.01), accuracy=accuracy) for accuracy in (0.05, 0.0005))
    noisy = detectability(scene, depths, diameters, Thresholds(0.02), accuracy=0.0005)
    for k in range(5):
        for m in range(5):
            for coarse_verdict, fine_verdict in ((coarse.seen, fine.seen), (coarse.resolved, fine.resolved)):
                assert coarse_verdict[k][m] is None or fine_verdict[k][m] is None or coarse_verdict[k][m] == fine_verdict[k][m]
            if fine.change[k][m] is not None:
                assert coarse.change[k][m] == pytest.approx(fine.change[k][m], abs=coarse.error[k][m] + fine.error[k][m])
                assert noisy.standard_deviation[k][m] == pytest.approx(2 * fine.standard_deviation[k][m], rel=0.1)


def test_threshold_is_what_its_docstring_says() -> None:
    """With a threshold half-way, 3 times the noise leaves 6.7 % errors of either kind, 3.29 times 5 %: drawn, not calculated."""
    drawn = np.random.default_rng(1).normal(size=200_000)
    for times, share in ((3.0, 0.067), (3.29, 0.05)):
        assert np.mean(drawn > times / 2) == pytest.approx(share, abs=2e-3)
        assert np.mean(times + drawn < times / 2) == pytest.approx(share, abs=2e-3)


def test_others_stay_and_spheres_keep_clear_of_them() -> None:
    scene = read_scene(REFERENCE / "solid" / "two-tumours-on-large-tumour.toml")  # the other: 30 mm away, 5 mm wide
    mapped = detectability(scene, np.array([0.01]), np.array([0.008]))
    evaluated = evaluate(scene, "equivalent-inclusion")
    second = scene.inclusion[1].model_copy(update={"target": True})
    alone = evaluate(scene.model_copy(update={"inclusion": (second,)}), "equivalent-inclusion")
    assert mapped.ratio_without == pytest.approx(alone.ratio, rel=1e-6)
    assert mapped.change[0][0] == pytest.approx(evaluated.ratio / alone.ratio - 1, rel=0.02)
    closer = scene.inclusion[1].model_copy(update={"x": scene.inclusion[0].x + 0.008})
    close = scene.model_copy(update={"inclusion": (scene.inclusion[0], closer)})
    assert detectability(close, np.array([0.01]), np.array([0.010, 0.012])).change[0][1] is None


def test_sizes_chosen_hold_the_scenes_own_tumour() -> None:
    scene = with_sphere(read_scene(SCENE), 0.03, 0.02)
    depths, diameters = choose_sizes(scene, 4)
    assert depths[0] < 0.03 < depths[-1] <= scene.tissue.depth
    assert diameters[0] < 0.02 < diameters[-1]
    assert math.isclose(choose_sizes(scene, 4, depth_to=0.01)[0][-1], 0.01)


def test_table() -> None:
    ended = run("detectability", SCENE, "--points", "5", "--noise", "0.05")
    assert ended.returncode == 0
    assert "detected from" in ended.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((SCENE, "--noise", "0"), ("noise", "from 1e-06 to 10")),
        ((SCENE, "--noise", "much"), ("noise", "much")),
        ((SCENE, "--resolved", "nan"), ("resolved",)),
        ((SCENE, "--depth-to", "20"), ("depth-to", "unit is missing")),
        ((SCENE, "--depth-from", "9 mm", "--depth-to", "8 mm"), ("depth-to", "above depth-from")),
        ((SCENE, "--points", "1"), ("points",)),
        ((SCENE, "--plot", "map.bmp"), ("plot", ".png")),
        ((SCENE, "--accuracy", "2"), ("accuracy",)),
        ((REFERENCE / "axisymmetric" / "homogeneous.toml",), ("inclusion",)),
    ],
)
def test_refusals_are_one_line_and_exit_2(arguments: tuple[str | Path, ...], words: tuple[str, ...]) -> None:
    line = refused("detectability", *arguments)
    for word in words:
        assert word in line


def test_several_and_no_target_is_refused(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text((REFERENCE / "solid" / "two-tumours-between.toml").read_text().replace("target = true", ""))
    assert "inclusion.target" in refused("detectability", scene)
