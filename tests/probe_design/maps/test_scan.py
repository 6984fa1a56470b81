"""`probe-design scan` as a user runs it, against other evaluators, 3D references and symmetry."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.scenes.scene_tables import Inclusion
from probe_design.maps.scan import scan
from solver import Workspace, evaluate
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.linalg.workspace import use_workspace
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.program import begun, refused, run
from tests.support.references import expected, named
from tests.support.slow import slow_unless

SCENE = REFERENCE / "solid" / "two-tumours-between.toml"
KEYS = {
    "along", "at", "position", "ratio", "stiffness", "stress_inner", "stress_outer", "log_sensitivity", "error_estimate",
    "ratio_without", "charge_inner", "charge_outer", "charge_ratio", "charge_ratio_error", "charge_log_sensitivity",
    "charge_ratio_without", "observable", "response", "evaluator", "seconds", "plan", "warnings",
    "linear_limit_load", "gap_closure_load", "load_limits", "provenance",
}  # fmt: skip


def changed(scene: Scene, **values: object) -> Scene:
    return Scene.model_validate({**scene.model_dump(), **values})


def test_both_references_of_solid_lie_on_one_scan(tmp_path: Path) -> None:
    """The 3D scenes two-tumours-on-large-tumour and -between are the same tissue, the probe at -15 mm and at 0."""
    picture = tmp_path / "scan.png"
    ended = run("scan", SCENE, "--from", "-15 mm", "--to", "0 mm", "--points", "2", "--json", "--plot", picture)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    output = json.loads(ended.stdout)
    assert set(output) == KEYS
    assert output["position"] == pytest.approx([-0.015, 0.0])
    for k, name in enumerate(("two-tumours-on-large-tumour", "two-tumours-between")):
        reference = named("solid", name)
        slack = reference.uncertainty + output["error_estimate"][k]
        assert output["ratio"][k] == pytest.approx(reference.ratio, rel=slack)
        # round tissue about the probe's axis stands for the block, which is felt where the probe is off its middle
        assert output["stiffness"][k] == pytest.approx(reference.stiffness, rel=0.015)
        assert output["stress_inner"][k] == pytest.approx(reference.stress_inner, rel=0.015)
        assert output["stress_outer"][k] == pytest.approx(reference.stress_outer, rel=0.015)
    assert any("stiffness" in warning for warning in output["warnings"])
    height, width = matplotlib.image.imread(picture).shape[:2]
    assert width == 1170
    assert height > 700


BESIDE = [reference for reference in expected("off-axis") if "0.25" in reference.name]


@pytest.mark.parametrize("reference", slow_unless(BESIDE[:2].__contains__, BESIDE), ids=lambda reference: reference.name)
def test_tumours_beside_the_axis(reference: object) -> None:
    """3D references with the probe beside the tumour."""
    scanned = scan(reference.scene, "x", np.array([reference.scene.placement.x]))  # type: ignore[attr-defined]
    assert scanned.ratio[0] == pytest.approx(reference.ratio, rel=scanned.error_estimate[0] + reference.uncertainty)  # type: ignore[attr-defined]
    assert scanned.error_estimate[0] <= 0.011


@pytest.mark.slow
def test_a_symmetric_scene_gives_a_symmetric_scan_along_any_line() -> None:
    scene = read_scene(REFERENCE / "solid" / "two-tumours-on-large-tumour.toml")
    body = scene.inclusion[0]
    pair = [body.model_copy(update={"x": x, "y": 0.0, "target": False}) for x in (-0.012, 0.012)]
    twin = changed(scene, inclusion=tuple(pair), tissue=named("solid", "flank").scene.tissue)
    places = np.linspace(-0.018, 0.018, 7)
    line = scan(twin, "x", places, offset=0.0)
    assert line.ratio == pytest.approx(line.ratio[::-1], rel=1e-9)
    assert line.log_sensitivity == (None,) * 7
    turned = changed(twin, inclusion=tuple(single.model_copy(update={"x": 0.0, "y": single.x}) for single in pair))
    assert scan(turned, "y", places, offset=0.0).ratio == pytest.approx(line.ratio, rel=1e-9)
    across = scan(twin, "y", np.array([-0.004, 0.004]), offset=0.012)
    assert across.ratio[0] == pytest.approx(across.ratio[1], rel=1e-9)
    assert across.at == 0.012


def test_position_0_is_what_axisymmetric_says() -> None:
    scene = read_scene(EXAMPLES / "scene.toml")
    scanned, evaluated = scan(scene, "x", np.array([-0.01, 0.0, 0.01])), evaluate(scene, "axisymmetric", 1e-3)
    assert scanned.error_estimate[1] is not None
    assert scanned.error_estimate[1] <= 0.01
    assert scanned.ratio[1] == pytest.approx(evaluated.ratio, rel=scanned.error_estimate[1])
    assert scanned.stiffness[1] == pytest.approx(evaluated.stiffness, rel=0.01)
    assert scanned.stress_outer[1] == pytest.approx(evaluated.stress_outer, rel=0.01)
    assert scanned.log_sensitivity[1] == pytest.approx(evaluated.log_sensitivity, rel=0.05)


@pytest.mark.slow
def test_far_from_tumours_and_without_them_the_ratio_is_that_of_tissue_alone() -> None:
    scene = read_scene(REFERENCE / "solid" / "flank.toml")
    alone = evaluate(changed(scene, inclusion=()), "axisymmetric", 1e-3)
    far = scan(scene, "x", np.array([-0.03, 0.0]))
    assert far.ratio[0] == pytest.approx(alone.ratio, rel=far.error_estimate[0])
    assert far.ratio[1] != pytest.approx(alone.ratio, rel=0.05)
    flat = scan(changed(scene, inclusion=()), "y", np.linspace(-0.02, 0.02, 3))
    assert flat.ratio == pytest.approx([alone.ratio] * 3, rel=flat.error_estimate[0])
    assert flat.ratio_without == pytest.approx(flat.ratio[1], rel=1e-12)
    assert flat.log_sensitivity == (None,) * 3
    assert any("no inclusion" in warning for warning in flat.warnings)


def test_one_probe_is_held_wherever_its_bounds_are_found() -> None:
    """Positions off the middle of a block ask for film forces alone: each probe solved everywhere is some 40 MB."""
    scene = read_scene(EXAMPLES / "two-tumours.toml")
    with use_workspace(Workspace()) as held:
        scan(changed(scene, inclusion=()), "x", np.array([0.0, 0.03]), accuracy=0.1)
    kinds = [type(entry.value) for entry in held._entries.values()]
    assert (kinds.count(Undisturbed), kinds.count(ProbeAlone)) == (1, 2)


def test_a_force_is_shared_by_both_films() -> None:
    scene = changed(read_scene(SCENE), load={"force": 0.01})
    scanned = scan(scene, "x", np.array([-0.015, 0.005]))
    areas = scene.probe.inner_area, scene.probe.outer_area
    total = np.array(scanned.stress_inner) * areas[0] + np.array(scanned.stress_outer) * areas[1]
    assert total == pytest.approx(0.01, rel=1e-9)
    assert np.array(scanned.stress_inner) / np.array(scanned.stress_outer) == pytest.approx(scanned.ratio, rel=1e-9)


def test_a_tumour_beyond_the_round_tissue_is_counted_as_an_error() -> None:
    scene = read_scene(SCENE)
    corner = Inclusion(diameter=0.006, depth=0.01, x=0.045, y=0.035, youngs_modulus=6e4, poisson_ratio=0.45, target=True)
    cornered = changed(scene, inclusion=(corner,))
    scanned = scan(cornered, "x", np.array([-0.02, 0.04]), offset=0.0)
    assert scanned.log_sensitivity[0] is None
    assert scanned.log_sensitivity[1] is not None
    assert scanned.ratio[0] == pytest.approx(scanned.ratio_without, rel=1e-3)
    assert any("outside the round tissue" in warning for warning in scanned.warnings)


@pytest.mark.slow
def test_positions_at_the_edge_do_not_spoil_those_in_the_middle() -> None:
    """The bounds of each position hold what the tissue's side does there, with the same results."""
    scene = read_scene(REFERENCE / "solid" / "flank.toml")
    narrow, wide = (scan(scene, "x", np.linspace(-half, half, 9)) for half in (0.01, 0.038))
    assert wide.error_estimate[0] is None or wide.error_estimate[0] > 0.05
    assert wide.error_estimate[4] <= 1.5 * narrow.error_estimate[4]
    assert wide.ratio[4] == pytest.approx(narrow.ratio[4], rel=1e-3)
    assert any("sides" in decision.feature and decision.effect > 0.02 for decision in wide.plan)


@pytest.mark.slow
def test_interrupted_is_one_line_and_leaves_no_file(tmp_path: Path) -> None:
    with begun("probe_design.maps.scan", "scan", SCENE, "--points", "2000", "--plot", tmp_path / "scan.png") as started:
        time.sleep(3)
        started.send_signal(signal.SIGINT)
        output, said = started.communicate(timeout=60)
    assert started.returncode == 130
    assert output == ""
    assert said.strip() == "probe-design: interrupted; nothing half-written is left"
    assert list(tmp_path.iterdir()) == []


def test_table() -> None:
    ended = run("scan", SCENE, "--points", "3")
    assert ended.returncode == 0
    assert "stiffness" in ended.stdout
    assert "-20" in ended.stdout


UNILATERAL, TILTED, ELLIPSOID = (
    ('interface = "bonded"', 'interface = "unilateral"', "unilateral"),
    ('y = "0 mm"\n\n[load]', 'y = "0 mm"\ntilt = "3 deg"\n\n[load]', "tilt"),
    ('diameter = "5 mm"', 'diameters = ["5 mm", "4 mm", "5 mm"]', "built for spheres"),
)


@pytest.mark.parametrize("command", ["scan", "detectability"])
@pytest.mark.parametrize(("old", "new", "word"), [UNILATERAL, TILTED, ELLIPSOID])
def test_kinds_that_are_not_built_are_refused(command: str, old: str, new: str, word: str, tmp_path: Path) -> None:
    text = SCENE.read_text()
    assert old in text
    scene = tmp_path / "scene.toml"
    scene.write_text(text.replace(old, new))
    assert word in refused(command, scene)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--from", "-20"), ("from", "unit is missing")),
        (("--to", "1 kPa"), ("to", "1 kPa")),
        (("--from", "5 mm", "--to", "5 mm"), ("to", "above from")),
        (("--points", "1"), ("points",)),
        (("--along", "z"), ("along", "z")),
        (("--accuracy", "0"), ("accuracy",)),
        (("--accuracy", "fine"), ("accuracy", "fine")),
        (("--plot", "scan.bmp"), ("plot", ".png")),
        # half the block's length of 100 mm less the probe's radius, sqrt(4.1^2 + 4^2 / 1.2) mm = 5.4903 mm
        (("--to", "45 mm"), ("to", "45 mm", "between -44.5097", "44.5097")),
        (("--along", "y", "--from", "-35 mm"), ("from", "between -34.5097")),
        (("--at", "36 mm"), ("at", "36 mm", "34.5097")),
    ],
)
def test_refusals_are_one_line_and_exit_2(arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    line = refused("scan", SCENE, *arguments)
    for word in words:
        assert word in line


def test_round_tissue_limits_the_line_by_its_chord() -> None:
    # 45 mm - 5.4903 mm = 39.5097 mm from the middle; at y = 20 mm that leaves sqrt(39.5097^2 - 20^2) mm = 34.073 mm
    assert "34.07" in refused("scan", REFERENCE / "solid" / "flank.toml", "--at", "20 mm", "--to", "35 mm")


def test_half_space_has_no_limit() -> None:
    scanned = scan(read_scene(REFERENCE / "half-space" / "bonded.toml"), "x", np.array([0.0, 2.0]))
    assert scanned.ratio[1] == pytest.approx(scanned.ratio_without, rel=1e-6)
