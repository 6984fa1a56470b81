"""The commands as Python functions: scenes or their files in, results out that notebooks show."""

from __future__ import annotations

import importlib
import inspect
import json
import pydoc
import re
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import geometry
import hw
import probe_design
import solver
from geometry.common.errors import InputError
from geometry.provenance.block import build_provenance
from geometry.provenance.texts import read_block
from geometry.scenes.scene_file import read_scene
from probe_design import Scene, curve, detectability, estimate, evaluate, export, plot, press, scan, sweep
from probe_design.commands.built_probe import SourceOptions
from probe_design.commands.hardware_request import ReferenceRequest
from probe_design.commands.names import COMMANDS
from probe_design.commands.request import list_fields
from probe_design.notebook import format_record
from tests.support.paths import DOCS, SCENE
from tests.support.program import run


class Cells(HTMLParser):
    """Texts of a page's table cells; a tag that is not closed is a fault."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.cells: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["td"]:
            self.cells.append(data)


def test_a_scene_and_its_file_are_answered_alike() -> None:
    by_name = evaluate(str(SCENE), evaluator="closed-form", accuracy=0.1)
    assert by_name.ratio == evaluate(read_scene(SCENE), evaluator="closed-form", accuracy=0.1).ratio
    assert by_name.ratio == solver.evaluate(SCENE, "closed-form", 0.1).ratio


@pytest.mark.parametrize("function", [evaluate, scan, detectability, estimate, probe_design.optimize, curve, press])
def test_what_is_no_scene_is_refused_in_one_line(function: Any, tmp_path: Any) -> None:
    extra = {curve: {"moduli": [1e3]}, press: {"force": 0.1}, estimate: {"ratio": 0.6}}.get(function, {})
    with pytest.raises(InputError, match=r"(scene|design) = 3: allowed: a (Design or )?Scene, (or )?the name"):
        function(3, **extra)
    with pytest.raises(InputError, match="scene file = "):
        function(tmp_path / "nothing.toml", **extra)


def test_functions_say_what_they_take() -> None:
    for name in sorted({*probe_design.__all__} - {"Scene"}):
        function = getattr(probe_design, name)
        text = inspect.getdoc(function)
        assert text is not None
        for parameter in inspect.signature(function).parameters.values():
            assert re.search(rf"^ *{parameter.name}(:|$| : )", text, re.MULTILINE), (name, parameter.name)
            if parameter.name == "progress":
                assert parameter.default is None


@pytest.mark.parametrize("package", [probe_design, solver, hw])
def test_help_lists_what_a_user_calls(package: Any) -> None:
    assert [name for name in dir(package) if inspect.ismodule(getattr(package, name)) and package is not solver] == []
    assert all(callable(getattr(package, name)) for name in package.__all__)


@pytest.mark.slow
def test_help_page_has_the_functions() -> None:
    page = subprocess.run(
        [sys.executable, "-c", "import probe_design; help(probe_design)"], capture_output=True, text=True, check=True
    ).stdout
    functions = page.partition("\nFUNCTIONS\n")[2]
    names = set(probe_design.__all__) - {"Locator", "Scene"}  # classes
    assert [name for name in names if f"\n    {name}(" not in f"\n{functions}"] == []


@pytest.mark.parametrize("package", [probe_design, solver, hw, geometry])
def test_help_begins_with_what_a_user_calls(package: Any) -> None:
    """Before the modules, which pydoc lists of any package, stands each name that the package offers."""
    text = pydoc.render_doc(package, renderer=pydoc.plaintext).partition("\nPACKAGE CONTENTS\n")[0]
    assert [name for name in package.__all__ if not re.search(rf"\b{name}\b", text)] == []


def test_bare_import_is_light() -> None:
    code = "import probe_design, sys; dir(probe_design); print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())
    assert loaded & {"numpy", "pydantic", "scipy", "click", "solver", "geometry", "xarray", "matplotlib"} == set()


def test_functions_need_no_plots_and_no_tables() -> None:
    code = f"from probe_design import evaluate; evaluate({str(SCENE)!r}, evaluator='closed-form', accuracy=0.1)"
    command = [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"]
    loaded = set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert loaded & {"matplotlib", "xarray", "pandas", "rich", "click", "cadquery", "casadi"} == set()


def test_a_result_shows_its_numbers() -> None:
    result = evaluate(SCENE, evaluator="closed-form", accuracy=0.1)
    cells = Cells(format_record(result)).cells
    assert f"{result.ratio:.6g}" in cells
    assert cells[cells.index("stress_inner") + 2] == "Pa"


def test_a_notebook_shows_results_as_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPython looks functions up by a class's module and name, so that registering imports no result."""
    registered: dict[tuple[str, str], Any] = {}

    class Formatter:
        def for_type_by_name(self, module: str, name: str, function: Any) -> None:
            registered[module, name] = function

    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": Formatter(), "image/png": Formatter()}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    importlib.reload(probe_design)
    result = evaluate(SCENE, evaluator="closed-form", accuracy=0.1)
    keys = [(parent.__module__, parent.__name__) for parent in type(result).__mro__]
    display = next(registered[key] for key in keys if key in registered)
    assert f"{result.ratio:.6g}" in Cells(display(result)).cells
    assert all(hasattr(importlib.import_module(module), name) for module, name in registered)


def test_every_command_that_computes_is_a_function() -> None:
    others = {"init", "explore", "doctor", "rerun", "tissue", "material"}  # a dialogue, a page, tests of a computer, files, lists
    names = {{"load": "press", "material fit": "fit_material"}.get(name, name) for name in COMMANDS}
    assert {name for name in names if name.split()[0] not in others} <= {*probe_design.__all__}
    page = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
    assert [name for name in probe_design.__all__ if f"::: probe_design.{name}\n" not in page] == []


def test_keywords_of_what_is_read_are_the_request_s() -> None:
    """The ``TypedDict`` of the functions for a built probe has the options of the commands, and no others."""
    shared = {"scene", "memory", "time", "as_json", "quiet"}
    assert SourceOptions.__annotations__.keys() == list_fields(ReferenceRequest).keys() - shared
    assert inspect.signature(probe_design.check).parameters["seed"].default == 0
    assert "resume" not in inspect.signature(probe_design.read).parameters


def test_careless_keywords_are_refused() -> None:
    for wrong, named in (({"seconds": "ten"}, "seconds"), ({"built": {"probe.gap": 1e-4}}, "built"), ({"scene": 3}, "scene")):
        with pytest.raises(InputError, match=named):
            probe_design.read(virtual=True, **wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="sceonds"):
        probe_design.read(virtual=True, sceonds=3)  # type: ignore[call-arg]
    with pytest.raises(InputError, match=r"probe\.gpa"):
        probe_design.tolerances(SCENE, sds={"probe.gpa": "1 um"})


@pytest.mark.slow
def test_built_probe_from_python_is_the_command_line_s(tmp_path: Any) -> None:
    """A probe whose inner block is half a millimetre too large: from its calibration to the verdict, without a file between."""
    record = probe_design.calibrate(SCENE, virtual=True, seconds=5)
    words = ("calibrate", SCENE, "--virtual", "--seconds", "5", "-o", tmp_path / "probe.toml", "--json")
    assert record.matrix == tuple(map(tuple, json.loads(run(*words).stdout)["matrix"]))
    assert probe_design.check(SCENE, calibration=record, virtual=True, seconds=5).passed
    larger = {"probe.inner_radius": "4.5 mm"}
    wrong = probe_design.check(SCENE, calibration=tmp_path / "probe.toml", virtual=True, built=larger, seconds=5)
    assert wrong.failed
    assert "probe.inner_radius" in wrong.reason
    reading = probe_design.read(SCENE, calibration=record, virtual=True, seconds=5)
    assert abs(reading.z_ratio or 9.0) < 4
    budget = probe_design.tolerances(SCENE, samples=64)
    assert budget.to_frame()["share"].sum() == pytest.approx(1.0)
    assert budget.to_dataset()["contribution"].sel(output="ln_ratio").values == pytest.approx(budget.to_frame()["contribution"])


@pytest.mark.slow
def test_from_scene_to_optimum_in_ten_lines() -> None:
    """What a newcomer types, without a look at the sources."""
    scene = Scene.from_file(SCENE)
    wider = scene.replace({"probe.gap": "0.2 mm", "inclusion.depth": "10 mm"})
    before, after = (evaluate(item, accuracy=0.05) for item in (scene, wider))
    assert after.to_frame().loc["ratio", "value"] == after.ratio != before.ratio
    line = scan(wider, positions=[0.0, 5e-3], accuracy=0.1)
    assert line.to_frame().loc[5e-3, "ratio"] == line.ratio[1]
    assert "ratio" in str(after)
    optimum = probe_design.optimize(scene, starts=1, outer_radius=8e-3)
    assert optimum.best_tried.scene.probe.tube_radius <= 8e-3 * (1 + 1e-9)
    assert optimum.verdict


@pytest.mark.parametrize(
    ("mistake", "remedy"),
    [
        (lambda scene: Scene.from_file({"probe": {}}), "Scene.from_dict takes tables"),
        (lambda scene: setattr(scene.probe, "gap", 3e-4), r"scene\.replace\(\{'probe.gap': '0.2 mm'\}\)"),
        (lambda scene: scene.replace(None), r"\{'probe.gap': '0.2 mm'\}"),
        (lambda scene: evaluate(scene, accuracy="high"), "such as 0.01 or '1 %'"),
        (lambda scene: curve(scene, "30 kPa"), r"such as \['10 kPa', '30 kPa'\]"),
        (lambda scene: curve(scene, ["30 mm"]), "'mm' is no unit that converts to Pa"),
        (lambda scene: press(scene, force="1 kg"), "'kg' is no unit that converts to N"),
        (lambda scene: press(scene, force=-1.0), "from 0 N"),
        (probe_design.evaluate_many, "evaluate takes one"),
        (lambda scene: probe_design.evaluate_many(str(SCENE)), "evaluate takes one"),
    ],
)
def test_what_newcomers_try_first_is_refused_with_a_remedy(mistake: Callable[[Scene], object], remedy: str) -> None:
    with pytest.raises(InputError, match=remedy):
        mistake(Scene.from_file(SCENE))


def test_texts_with_units_are_taken_as_in_files() -> None:
    scene = Scene.from_file(SCENE)
    assert evaluate(scene, "closed-form", "5 %").ratio == evaluate(scene, "closed-form", 0.05).ratio  # type: ignore[arg-type]
    by_text, by_number = (curve(scene, moduli, 0.1) for moduli in (["10 kPa", 3e4], np.array([1e4, 3e4])))  # type: ignore[arg-type]
    assert (by_text.youngs_modulus, by_text.ratio) == (by_number.youngs_modulus, by_number.ratio)


def test_a_wrong_call_is_answered_with_the_names_of_parameters() -> None:
    with pytest.raises(TypeError, match=r"argument 2 = .-10 mm.: allowed: scan\(scene, \*, along=, positions=, "):
        scan(SCENE, "-10 mm", "10 mm", 3)  # type: ignore[call-arg]


def test_results_print_as_short_tables() -> None:
    result = evaluate(SCENE, evaluator="closed-form", accuracy=0.1)
    assert f"ratio  {result.ratio:.6g}".split() in [row.split() for row in repr(result).splitlines()]
    assert len(str(result)) < 1500
    moduli = np.geomspace(1e3, 1e5, 30)
    rows = str(curve(SCENE, moduli, accuracy=0.1)).splitlines()
    assert rows[-1] == "... 20 more rows"
    assert sum(row.lstrip().startswith("1 ") for row in rows) == 1  # kPa


def test_a_scene_is_drawn_to_scale() -> None:
    scene = Scene.from_file(SCENE)
    (axes,) = scene.plot().axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "tissue, 6 kPa", "inner block, 1 MPa", "outer block, 80 kPa", "base", "tumour, 30 kPa"
    ]  # fmt: skip
    tumour = next(patch for patch in axes.patches if patch.get_label().startswith("tumour"))
    assert (tumour.center, tumour.radius) == ((0.0, -9.0), 4.0)


def test_the_old_name_of_press_warns() -> None:
    with pytest.warns(DeprecationWarning, match="press"):
        assert probe_design.load is press
    assert re.fullmatch(r"\d+\.\d+\.\d+", probe_design.__version__)


def test_what_has_no_picture_is_refused() -> None:
    with pytest.raises(InputError, match="a result of curve, press, scan, detectability, locate or tolerances"):
        plot(evaluate(SCENE, evaluator="closed-form", accuracy=0.1))  # type: ignore[arg-type]


def test_scan_as_arrays_and_picture() -> None:
    line = scan(SCENE, positions=[-8e-3, 0.0], accuracy=0.1)
    data = line.to_dataset()
    assert data["ratio"].dims == ("position",)
    assert data["ratio"].values.tolist() == list(line.ratio)
    assert {name: data[name].attrs["units"] for name in ("position", "stiffness", "stress_inner")} == {
        "position": "m", "stiffness": "N/m", "stress_inner": "Pa"
    }  # fmt: skip
    assert json.loads(data.attrs["provenance"])["scene"] == line.provenance["scene"]
    assert len(plot(line).axes) == 3
    assert "scene" not in line.as_dict()
    assert f"{line.ratio[0]:.6g}" in Cells(format_record(line)).cells


def test_map_as_arrays_and_picture() -> None:
    mapped = detectability(SCENE, depths=[8e-3, 4e-2], diameters=[4e-3, 6e-2, 6.5e-2])
    data = mapped.to_dataset()
    assert data["seen"].dims == ("depth", "diameter")
    assert np.isnan(data["change"].values[1, 2])  # does not fit
    assert data["change"].values[0, 0] == mapped.change[0][0]
    assert plot(mapped).axes


def test_curve_as_arrays_and_picture() -> None:
    modulus_curve = curve(SCENE, [1e3, 1e5])
    data = modulus_curve.to_dataset()
    assert data["ratio"].sel(youngs_modulus=1e5) == modulus_curve.ratio[1]
    assert data["youngs_modulus"].attrs["units"] == "Pa"
    assert len(plot(modulus_curve).axes) == 2


@pytest.mark.slow
def test_load_as_arrays_and_picture() -> None:
    path = press(SCENE, force=0.02, points=2)
    data = path.to_dataset()
    assert data["indentation"].dims == ("force",)
    assert data["closest_walls"].attrs["units"] == "m"
    assert data["indentation"].values.tolist() == list(path.indentation)
    assert len(plot(path).axes) == 3


def test_estimate_needs_one_way_to_readings() -> None:
    with pytest.raises(InputError, match="one of ratio and readings"):
        estimate(SCENE)


def test_estimate_is_the_command_line_s() -> None:
    estimated = estimate(SCENE, ratio=0.62, noise=0.05)
    output = json.loads(run("estimate", SCENE, "--ratio", "0.62", "--noise", "0.05", "--json").stdout)
    assert output["interval"] == list(estimated.interval)
    assert "unknown" in Cells(format_record(estimated)).cells


def test_sweep_as_arrays(tmp_path: Any) -> None:
    variables = {"probe.gap": {"values": [1e-4, 2e-4]}}
    swept = sweep({"scene": SCENE, "evaluator": "closed-form", "variables": variables}, tmp_path, workers=1)
    assert swept.to_dataset()["ratio"].dims == ("probe.gap",)
    assert "designs" in Cells(format_record(swept)).cells


@pytest.mark.slow
def test_export_writes_what_the_command_writes(tmp_path: Any) -> None:
    made = export(SCENE, tmp_path / "parts", step=1e-4)
    names = {path.name for path in made.files}
    assert {"assembly.step", "parts.json", "outer.pdf", "mould-inner-upper.step", "bill-of-materials.csv"} <= names
    assert made.rounding is not None
    assert made.scene.probe.tube_radius == pytest.approx(5.5e-3)
    assert read_block(tmp_path / "parts")[0]["scene"] == build_provenance(read_scene(SCENE))["scene"]
    with pytest.raises(InputError, match="another design"):
        export(SCENE, tmp_path / "parts")
