"""The program as a user runs it: exit codes, one line for every refusal, JSON keys, clean streams."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from probe_design.commands.names import COMMANDS
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.paths import SCENE as EXAMPLE
from tests.support.program import refused, run, started
from tests.support.slow import slow_unless

SCENE = REFERENCE / "axisymmetric" / "shallow.toml"
KEYS = {
    "stress_inner", "stress_outer", "ratio", "log_sensitivity", "stiffness", "charge_inner", "charge_outer", "error_estimate",
    "evaluator", "seconds", "equivalent_modulus", "residual", "linear_limit_load", "gap_closure_load", "load_limits",
    "frequency", "ratio_phase", "ratio_phase_error", "ratio_phase_derivatives", "film_log_sensitivities", "plan", "warnings",
    "provenance", "error_kind", "stress_inner_error", "stress_outer_error", "stiffness_error", "charge_per_force_inner",
    "charge_per_force_outer", "charge_ratio", "charge_log_sensitivity", "charge_log_sensitivity_error", "charge_inner_error",
    "charge_outer_error", "charge_per_force_inner_error", "charge_per_force_outer_error", "charge_ratio_error", "observable",
    "response",
}  # fmt: skip


STARTED: dict[str, tuple[str | Path, ...]] = {  # the cheapest that each command does
    "init": ("-o", "first.toml"),
    "evaluate": (SCENE, "--evaluator", "closed-form"),
    "plan": (SCENE,),
    "load": (SCENE, "--to", "20 mN", "--points", "1"),
    "curve": (SCENE, "--points", "2", "--accuracy", "0.1"),
    "scan": (SCENE, "--points", "2", "--accuracy", "0.1"),
    "detectability": (SCENE, "--points", "2", "--accuracy", "0.1"),
    "estimate": (EXAMPLE, "--ratio", "0.563", "--accuracy", "0.05"),
    "locate": (EXAMPLES / "scans" / "none.toml", "--readings", EXAMPLES / "scans" / "none.csv"),
    "survey": (EXAMPLES / "scans" / "none.toml", "--virtual", "--presses", "1", "-o", "out"),
    "optimize": (EXAMPLE, "-o", "out", "--starts", "1"),
    "export": (SCENE, "-o", "out"),
    "tradeoff": (REFERENCE / "axisymmetric" / "homogeneous.toml", "-o", "out"),
    "sweep": (EXAMPLES / "sweep.toml", "-o", "out", "--workers", "1"),
    "tissue": ("show", "breast"),
    "tolerances": (EXAMPLE, "--samples", "64"),
    "material": ("show", "ecoflex-00-10", "--thinner", "0.3"),
    "read": (EXAMPLE, "--virtual", "--seconds", "4"),
    "calibrate": (EXAMPLE, "--virtual", "--seconds", "5", "-o", "probe.toml"),
    "check": (EXAMPLE, "--virtual", "--seconds", "5"),
    "doctor": (EXAMPLE, "--virtual", "--seconds", "4"),
    "rerun": ("made.json",),
}


LONG = (  # quick tests ask for them in this process, for less
    "calibrate", "check", "doctor", "estimate", "export", "load", "locate", "optimize", "read", "rerun", "scan", "survey",
    "sweep", "tolerances", "tradeoff",
)  # fmt: skip


@pytest.mark.parametrize(
    "command_name",
    slow_unless(
        lambda command_name: command_name not in LONG,
        [command_name for command_name in COMMANDS if " " not in command_name and command_name != "explore"],  # it serves a page
    ),
)
def test_every_command_starts(command_name: str, tmp_path: Path) -> None:
    if command_name == "rerun":
        made = started("evaluate", SCENE, "--evaluator", "closed-form", "--json", cwd=tmp_path)
        (tmp_path / "made.json").write_text(made.stdout)
        (tmp_path / SCENE.name).write_bytes(SCENE.read_bytes())
    ended = started(command_name, *STARTED[command_name], "--json", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert isinstance(json.loads(ended.stdout), dict)
    assert [line for line in ended.stderr.splitlines() if not line.startswith("probe-design: ")] == []


@pytest.mark.parametrize("evaluator", ["auto", "published", "closed-form", "equivalent-inclusion", "axisymmetric"])
def test_evaluate_prints_one_json_object(evaluator: str) -> None:
    ended = run("evaluate", SCENE, "--evaluator", evaluator, "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    assert set(output) == KEYS
    assert bool(output["plan"]) == (evaluator in ("auto", "equivalent-inclusion"))
    assert ended.stderr == ""


def test_evaluate_prints_a_table() -> None:
    ended = run("evaluate", SCENE)
    assert ended.returncode == 0
    printed = re.search(r"ratio +│ +([0-9.]+) ", ended.stdout)
    assert printed is not None
    assert float(printed[1]) == pytest.approx(3.58232, rel=2e-3)  # tests/reference/axisymmetric


def test_charges_follow_equation_12(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    film = '\n[probe.film]\nthickness = "110 um"\nd31 = "20 pC/N"\nd32 = "2 pC/N"\nd33 = "-20 pC/N"\npsi1 = 0.5\npsi2 = 1.0\n'
    scene.write_text(SCENE.read_text().replace("\n[tissue]", film + "\n[tissue]"))
    output = json.loads(run("evaluate", scene, "--json").stdout)
    # Q = F (0.5 * 20 + 1 * 2 - 20) pC/N = -8 pC/N F, and A2 = pi (5 mm)^2
    assert output["charge_inner"] == pytest.approx(-8e-12 * output["stress_inner"] * 3.141592653589793 * 25e-6, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("evaluate", "absent.toml"), ("absent.toml",)),
        (("evaluate", SCENE, "--accuracy", "0"), ("accuracy", "0", "above 0")),
        (("evaluate", SCENE, "--accuracy", "-1"), ("accuracy", "-1")),
        (("evaluate", SCENE, "--accuracy", "nan"), ("accuracy", "nan")),
        (("evaluate", SCENE, "--accuracy", "fine"), ("accuracy", "fine")),
        (("evaluate", SCENE, "--evaluator", "magic"), ("evaluator", "magic", "axisymmetric")),
        (("conjure", SCENE), ("conjure", "evaluate, plan, curve, load, scan")),
        (("sweep", SCENE, "-o", "unused"), ("a scene file", "a sweep file", "probe-design evaluate")),
        (("evaluate",), ("SCENE",)),
        (("evaluate", ""), ("scene = ''", "name of a file")),
        (("evaluate", "a\udcff.toml"), (r"scene = 'a\udcff.toml'", "in UTF-8")),
        (("evaluate", "a\x1b[31m.toml"), (r"scene file = 'a\x1b[31m.toml'",)),
        (("evaluate", SCENE, "--\x1b[31m"), (r"--\x1b[31m",)),
        (("evaluate", SCENE, "--vtu", ""), ("vtu = ''",)),
        (("curve", SCENE, "--plot", ""), ("plot = ''",)),
        (("export", SCENE, "-o", "a\udcff"), (r"output = 'a\udcff'", "in UTF-8")),
        (("read", "--virtual", "--record", ""), ("record = ''",)),
        *(
            ((command_name, SCENE, "-o", ""), ("output = ''", "name of a file"))
            for command_name in ("optimize", "export", "tradeoff", "sweep", "calibrate", "check")
        ),
        (("evaluate", SCENE, "--colour"), ("--colour",)),
        (("evaluate", REFERENCE / "solid" / "flank.toml", "--evaluator", "axisymmetric"), ("axis", "equivalent-inclusion")),
        (("optimize", REFERENCE / "axisymmetric" / "homogeneous.toml", "-o", "unused"), ("inclusion.target",)),
        (("optimize", SCENE, "-o", "unused", "--outer-radius", "8"), ("outer-radius", "unit is missing")),
        (("optimize", SCENE, "-o", "unused", "--outer-radius", "1 um"), ("outer-radius", "above")),
    ],
)
def test_refusals_are_one_line_and_exit_2(arguments: tuple[str | Path, ...], words: tuple[str, ...], tmp_path: Path) -> None:
    line = refused(*(tmp_path / argument if argument == "unused" else argument for argument in arguments))
    assert line.startswith("probe-design: ")
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('"0.1 mm"', '"0 mm"', "probe.gap"),
        ('"0.1 mm"', '"0.1 Pa"', "probe.gap"),
        ('"0.1 mm"', "0.1", "probe.gap"),
        ("= 0.48", "= 0.5", "probe.outer.poisson_ratio"),
        ("area_ratio", "area_ration", "probe.area_ration"),
        ('"6 mm"', '"3 mm"', "inclusion[0].depth"),
    ],
)
def test_scene_refusals_name_the_key(old: str, new: str, word: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.read_text().replace(old, new))
    assert word in refused("evaluate", scene)


def test_binary_and_empty_files_are_refused(tmp_path: Path) -> None:
    for content in (b"", b"\xff\xfe\x00\x01", b"[probe"):
        scene = tmp_path / "scene.toml"
        scene.write_bytes(content)
        assert "scene.toml" in refused("evaluate", scene)


def test_an_evaluator_that_is_named_answers_with_a_larger_error_than_requested() -> None:
    groove = REFERENCE / "solid" / "groove-on-axis.toml"
    ended = run("evaluate", groove, "--evaluator", "axisymmetric", "--json")
    assert ended.returncode == 0
    assert json.loads(ended.stdout)["error_estimate"] > 0.01


def test_export_writes_files(tmp_path: Path) -> None:
    ended = run("export", SCENE, "-o", tmp_path / "out", "--json")
    assert ended.returncode == 0, ended.stderr
    files = json.loads(ended.stdout)["files"]
    parts = ("inner", "outer", "base", "assembly")
    moulds = {f"mould-{block}-{half}.step" for block in ("inner", "outer") for half in ("lower", "upper")}
    lists = {"bill-of-materials.csv", "tolerances.csv", "assembly.md", "scene.toml", "drawing.png", "parts.json"}
    assert {Path(file).name for file in files} == {
        f"{part}.{kind}" for part in parts for kind in ("step", "dxf", "pdf")
    } | moulds | lists
    assert all(Path(file).stat().st_size > 300 for file in files)
    record = json.loads((tmp_path / "out" / "parts.json").read_text())["files"]
    assert record.keys() == {Path(file).name for file in files} - {"parts.json"}
    assert record == {name: sha256((tmp_path / "out" / name).read_bytes()).hexdigest() for name in record}


@pytest.mark.parametrize(
    "arguments",
    [
        ("export", SCENE, "-o", "file"),
        ("optimize", SCENE, "-o", "file/folder"),
        ("tradeoff", SCENE, "-o", "file"),
        ("sweep", EXAMPLES / "sweep.toml", "-o", "file"),
        ("calibrate", "--virtual", "-o", "file/probe.toml"),
        ("check", "--virtual", "-o", "file/check.json"),
        ("read", "--virtual", "--record", "file/run.probe"),
        ("curve", SCENE, "--plot", "file/curve.png"),
        ("scan", SCENE, "--plot", "file/scan.svg"),
        ("detectability", EXAMPLE, "--plot", "file/map.pdf"),
        ("evaluate", SCENE, "--evaluator", "solid", "--vtu", "file/mesh.vtu"),
    ],
    ids=lambda argument: argument[0],
)
def test_an_output_under_a_file_is_refused_before_any_work(arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    line = refused(*(tmp_path / argument if str(argument).startswith("file") else argument for argument in arguments))
    assert f"{tmp_path / 'file'} is a file; give another folder, or move it away" in line
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_picture_in_a_folder_s_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "curve.png").mkdir()
    assert "the name of a file: this is a folder" in refused("curve", SCENE, "--plot", tmp_path / "curve.png")


def test_no_verb_shows_help() -> None:
    ended = run()
    assert ended.returncode == 0
    assert "optimize" in ended.stdout


@pytest.mark.parametrize("command_name", ["export", "optimize"])
def test_a_folder_with_parts_of_an_unknown_design_is_refused_before_any_work(command_name: str, tmp_path: Path) -> None:
    (tmp_path / "inner.step").write_text("of another design")
    assert "parts.json is missing); --force replaces them" in refused(command_name, EXAMPLE, "-o", tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("inner.step", "of another design")]


@pytest.mark.slow
def test_an_optimum_is_not_replaced_under_its_report(tmp_path: Path) -> None:
    ended = run("optimize", EXAMPLE, "-o", tmp_path, "--starts", "1")
    assert ended.returncode in (0, 1), ended.stderr
    content = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    other_scene = EXAMPLES / "paper-study.toml"
    for arguments in (("export", other_scene), ("optimize", EXAMPLE, "--starts", "2")):
        assert "another design" in refused(*arguments, "-o", tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == content
    assert run("export", tmp_path / "design.toml", "-o", tmp_path).returncode == 0
    assert run("export", other_scene, "-o", tmp_path, "--force").returncode == 0
    assert not {"report.html", "optimize.json", "candidates.csv", "design.toml"} & {path.name for path in tmp_path.iterdir()}


def test_want_of_memory_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing_left(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("solver.plan", nothing_left)
    assert "memory = all that the system gives this process: allowed: more" in refused("plan", SCENE, "--json")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not hold processes to it")
@pytest.mark.parametrize("kind", ["d", "v"])
def test_too_little_to_load_libraries_with_is_refused_at_once(kind: str) -> None:
    """OpenBLAS, where it does not get its buffers, asks for them without an end: 150 MB were silent for minutes."""
    command = shlex.join([sys.executable, "-m", "probe_design", "evaluate", str(SCENE)])
    ended = subprocess.run(
        ["sh", "-c", f"ulimit -{kind} 150000 && exec {command}"], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    assert ended.stderr.startswith("probe-design: memory = 0.15 GB of ")
    assert f"(ulimit -{kind}): allowed: 0.5 GB or more" in ended.stderr
