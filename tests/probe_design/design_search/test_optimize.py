"""`optimize DESIGN` from the command line: its template, its refusals, its result, and the same result after a kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from geometry import read_scene
from probe_design.design_search.optimum import explain_low_detection
from probe_design.populations.design_file import Design, design_from_dict, read_builtin_design, read_design
from probe_design.populations.performance import MeanError
from probe_design.populations.population import ScenePopulation
from probe_design.populations.template import build_design_template
from tests.support.program import run

SMALL = """
[population]
depth = ["6 mm", "9 mm"]
diameter = ["6 mm", "10 mm"]
samples = 4
[protocol]
positions = ["-6 mm", "6 mm", 2]
stiffness = false
[noise]
charge = "0.002 pC"
[limits]
force = "0.05 N"
outer_radius = "7 mm"
[variables]
inner_radius = {choices = ["3 mm", "5 mm"]}
gap = "fixed"
height = "fixed"
materials = ["dragon-skin-30"]
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    text = build_design_template()
    path = tmp_path / "design.toml"
    path.write_text(SMALL + text[text.index("\n[scene.probe]") :].replace('"100 Pa"', '"10 kPa"'), encoding="utf-8")
    return path


def test_template_is_all_defaults_and_reads_back() -> None:
    ended = run("optimize", "--template")
    assert ended.returncode == 0, ended.stderr
    read = design_from_dict(tomllib.loads(ended.stdout), units_required=True)
    assert read == Design(scene=read.scene)
    for table in type(read).model_fields:
        for key in getattr(type(getattr(read, table)), "model_fields", {}) if table != "scene" else ():
            assert f"{key} = " in ended.stdout or f"[[{table}.{key}]]" in ended.stdout, (table, key)


def test_builtin_design_starts_from_the_papers_probe_and_every_number_says_where_it_is_from() -> None:
    design = read_builtin_design()
    probe = design.scene.probe
    assert (probe.area_ratio, probe.inner.youngs_modulus, probe.outer.youngs_modulus) == (3.7, 1e5, 1e2)  # sections 2.1, 2.3
    assert design.limits.outer_radius is not None
    assert (
        ScenePopulation.from_scene(design.scene, design.population).draw_tumours(256).note is None
    )  # a first run begins without a warning


@pytest.mark.parametrize(
    ("change", "options", "named"),
    [
        (('charge = "0.002 pC"', 'charge = "2 mm"'), (), "noise.charge"),
        (('materials = ["dragon-skin-30"]', 'materials = ["dragon-skin-3"]'), (), "did you mean"),
        (("samples = 4", "samples = -4"), (), "population.samples"),
        (("samples = 4", "samples = 1"), (), "population.samples"),
        (("samples = 4", "sample = 4"), (), "did you mean 'samples'"),
        (('outer_radius = "7 mm"', 'outer_radius = "7"'), (), "limits.outer_radius"),
        (("[noise]", "[nois]"), (), "did you mean 'noise'"),
        (("", ""), ("--starts", "3"), "starts"),
        (("", ""), ("--outer-radius", "8 mm"), "outer-radius"),
    ],
)
def test_careless_questions_are_one_line_and_exit_2(
    small: Path, change: tuple[str, str], options: tuple[str, ...], named: str
) -> None:
    small.write_text(small.read_text(encoding="utf-8").replace(*change, 1), encoding="utf-8")
    ended = run("optimize", small, "-o", small.parent / "out", *options)
    assert ended.returncode == 2
    assert named in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize(("detection", "error", "said"), [(0.05, 0.01, True), (0.09, 0.03, True), (0.12, 0.03, False)])
def test_a_population_that_no_design_sees_is_told_so(detection: float, error: float, said: bool) -> None:
    performance: Any = SimpleNamespace(means={"detection": detection}, errors={"detection": MeanError(error)}, false_alarm=0.05)
    message = explain_low_detection(performance)
    assert (message is not None) == said
    assert message is None or "false alarms" in message


@pytest.mark.slow
def test_an_answer_is_whole_after_a_kill(small: Path) -> None:
    small.write_text(small.read_text(encoding="utf-8").replace('["3 mm", "5 mm"]', '["5 mm"]'), encoding="utf-8")  # is faster
    output = small.parent / "out"
    words = [sys.executable, "-m", "probe_design", "optimize", str(small), "-o", str(output), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as first:
        assert first.stderr is not None
        assert any("searching" in line for line in first.stderr)
        first.send_signal(signal.SIGKILL)
    assert not output.exists()
    _check(json.loads(run("optimize", small, "-o", output, "--json").stdout), small, output)


def _check(output: dict[str, object], design_path: Path, folder: Path) -> None:
    """What DESIGN.md promises of the JSON object and the folder."""
    population = output["population"]
    assert isinstance(population, dict)
    for name in ("start", "single", "optimum"):
        assert {f"{kind}{end}" for kind in ("detection", "resolved", "information") for end in ("", "_error")} <= set(
            population[name]
        )
    assert output["objective"] == population["optimum"]["detection"]
    assert output["baseline_objective"] == population["start"]["detection"]
    limits = output["limits"]
    assert isinstance(limits, list)
    names = {limit["name"] for limit in limits}
    assert {"outer_radius", "wall", "force"} <= names
    assert not {name for name in names if name.endswith(("gap", "height"))}  # fixed by the design file
    assert all(set(limit) == {"name", "value", "active"} for limit in limits)
    pressing, warnings = output["pressing"], output["warnings"]
    assert isinstance(pressing, dict)
    assert isinstance(warnings, list)
    unused = [limit for limit in warnings if "limits.force of 0.05 N is more than the recommended design allows" in limit]
    assert len(unused) == (pressing["optimum"]["limited_by"] not in ("force", "charge"))
    files, advice, design = output["files"], output["advice"], read_scene(folder / "design.toml")
    assert isinstance(files, list)
    assert isinstance(advice, list)
    built = "Build this" if output["status"] == "improved" else "Keep the start"
    assert advice[0].startswith(built)
    assert f"inner radius {1e3 * design.probe.inner_radius:.4g} mm" in advice[0]
    assert "of dragon-skin-30" in advice[0] or output["status"] != "improved"
    assert f"Press it with {pressing['optimum']['force']:.3g} N." in advice[0]
    assert any(text.startswith("What would help most: ") for text in advice)
    assert {Path(limit).name for limit in files} == {path.name for path in folder.iterdir()}
    assert {"report.html", "maps.png", "levers.png", "assembly.step", "design.toml"} <= {path.name for path in folder.iterdir()}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 4  # maps, levers, drawing, stresses: inside, as a file alone is sent on
    assert 'src="maps' not in page
    assert page.index(advice[0]) < page.index("<h2>")  # the report opens with it
    exported = read_scene(folder / "design.toml").probe.inner.poisson_ratio
    assert exported == pytest.approx(0.495 if output["status"] == "improved" else 0.4)  # without a gain that of the start
    assert read_design(folder / "question.toml") == read_design(design_path)
