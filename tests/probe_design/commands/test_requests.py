"""One description of each command: options, Python keywords, checks, help and names agree with its request."""

from __future__ import annotations

import inspect
import shlex
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

import probe_design
from geometry.common.errors import InputError
from probe_design.commands.evaluate import EvaluateRequest
from probe_design.commands.main import cli
from probe_design.commands.names import COMMANDS
from probe_design.commands.options import wrap_line
from probe_design.commands.request import list_fields
from probe_design.populations.design_file import read_builtin_design
from tests.support.paths import SCENE
from tests.support.program import refused, run, started

FACE = {name: COMMANDS[name].load_request() for name in probe_design.__all__ if name in COMMANDS}
# what Python has in place of options: arrays for ends and numbers, objects for files, functions for progress; and limits
PYTHON_ONLY = {
    "curve": {"moduli", "progress", "limits"},
    "detectability": {"depths", "diameters", "progress"},
    "estimate": {"readings", "nuisances"},
    "evaluate": {"progress", "limits"},
    "export": {"progress"},
    "load": {"force", "indentation", "progress", "limits"},
    "locate": {"advise", "readings"},
    "optimize": {"design", "progress"},
    "plan": {"solid"},
    "scan": {"positions", "progress"},
    "sweep": {"specification", "progress", "notice"},
    "survey": {"design"},
    "tolerances": {"sds", "materials"},
    "tradeoff": {"progress"},
}

OPTION_ONLY = {
    "as_json", "quiet", "memory", "time", "picture", "vtu", "low", "high", "max_load", "depth_from", "depth_to", "diameter_from",
    "diameter_to", "template", "pareto", "other_files", "reading", "calibration", "column", "rate", "nuisance", "advise",
    "any_probe",
}  # fmt: skip
OPTION_ONLY_OF = {
    "curve": {"points"},
    "scan": {"points"},
    "estimate": {"bench", "readings_file"},
    "locate": {"output", "bench", "readings_file"},
    "optimize": {"scene"},
    "sweep": {"sweep"},
    "check": {"output", "report"},
    "survey": {"scene"},
    "tolerances": {"tolerance", "material"},
    "tradeoff": {"output"},
}
BUILT_PROBE = {"calibrate", "check", "read", "survey"}  # have the options of what is read in Python, too


@pytest.mark.parametrize("name", FACE)
def test_keywords_are_those_of_the_request(name: str) -> None:
    parameters = inspect.signature(getattr(probe_design, name)).parameters
    fields = list_fields(FACE[name])
    general = {"as_json", "quiet", "memory", "time"} if name in BUILT_PROBE else OPTION_ONLY
    option_only = general | OPTION_ONLY_OF.get(name, set())
    assert parameters.keys() == fields.keys() - option_only | PYTHON_ONLY.get(name, set())
    for key in parameters.keys() & fields.keys() - (
        {"output"} if name == "calibrate" else set()
    ):  # in Python a record may have no file
        default = parameters[key].default
        assert fields[key].is_required() if default is inspect.Parameter.empty else fields[key].default == default, key


@pytest.mark.parametrize("name", ["scan", "detectability", "estimate", "export", "optimize"])
def test_help_in_python_is_that_of_the_options(name: str) -> None:
    text = inspect.getdoc(getattr(probe_design, name)) or ""
    options = {option.name: option for option in command(name).params if isinstance(option, click.Option)}
    for key in inspect.signature(getattr(probe_design, name)).parameters.keys() & options.keys():
        help_text = (options[key].help or "").partition("  [default")[0]
        assert help_text in text, key


@pytest.mark.parametrize(
    ("function", "keywords", "words"),
    [
        ("scan", {"along": "z"}, "along = 'z': allowed: 'x' or 'y'"),
        ("scan", {"accuracy": 2}, "accuracy = 2: allowed: a number above 0 and below 1"),
        ("scan", {"at": 20.0}, "at = 20.0: allowed: a position with its unit, such as '5 mm', from -10000 mm to 10000 mm"),
        ("detectability", {"points": 1}, "points = 1: allowed: a whole number from 2 to 300"),
        ("detectability", {"seen": "300 %"}, "seen = '300 %': allowed: a number above 0, in multiples of the noise"),
        ("estimate", {"ratio": 0.5, "noise": 0.0}, "noise = 0.0: allowed: from 1e-06 to 10"),
        ("export", {"output": "out", "step": "1 kPa"}, "step = '1 kPa': allowed: a length with its unit"),
        ("optimize", {"starts": 0}, "starts = 0: allowed: a whole number from 1 to 100"),
    ],
)
def test_python_refuses_what_the_command_line_refuses(function: str, keywords: dict[str, Any], words: str) -> None:
    subject = {} if function == "optimize" else {"scene": SCENE}
    with pytest.raises(InputError) as refusal:
        getattr(probe_design, function)(**subject, **keywords)
    assert str(refusal.value).startswith(words)


def test_python_takes_objects_in_place_of_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the signatures say: what is refused is what comes after the design, and scenes reach the study by their names."""
    design = read_builtin_design()
    population = {"depth": [9e-3, 20e-3], "diameter": [5e-3, 8e-3], "object": [16e3, 32e3]}
    for source in (design, {"scene": design.scene, "population": population}, None):
        with pytest.raises(InputError, match="readings = 3: allowed: a tuple of Reading"):
            probe_design.locate(source, readings=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="design = 3: allowed: a Design or Scene"):
        probe_design.locate(3, readings=())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="readings = 3"):
        probe_design.estimate(SCENE, readings=3)  # type: ignore[arg-type]
    monkeypatch.setattr("probe_design.tradeoffs.study.measure_tradeoff", lambda named, *_, **__: list(named))
    assert probe_design.tradeoff({"mine": design.scene}) == ["mine"]  # type: ignore[comparison-overlap]
    assert probe_design.tradeoff([SCENE]) == [Path(SCENE).stem]  # type: ignore[comparison-overlap, list-item]
    for wrong, words in (([3], "scenes = "), ({"mine": 3}, "scene = 3"), (SCENE, "scenes = ")):
        with pytest.raises(InputError, match=words):
            probe_design.tradeoff(wrong)  # type: ignore[arg-type]


def test_python_takes_texts_with_units() -> None:
    scanned: Any = probe_design.scan(SCENE, positions=[0.0], at="1 mm", accuracy="10 %")  # type: ignore[arg-type]
    assert scanned.at == 1e-3


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ("detectability", SCENE, "--seen", "300%"),
            "seen = '300%': allowed: a number above 0, in multiples of the noise (3 for ",
        ),
        (("curve", SCENE, "--from", "1 MPa", "--to", "1 kPa"), "to = '1 kPa': allowed: a modulus above from = '1 MPa'"),
        (("scan", SCENE, "--from", "5 mm", "--to", "5 mm"), "to = 5 mm: allowed: a position above from = 5 mm"),
        (("detectability", SCENE, "--depth-to", "5"), "depth-to = '5': allowed: a length with its unit, such as '5 mm', from "),
        (("read", "--virtual", "--seconds", "0"), "seconds = '0': allowed: a number of seconds above 0, up to 1e6"),
        (("optimize", SCENE), "output = missing: allowed: -o DIR, the folder for"),
    ],
)
def test_an_option_is_refused_by_its_name_with_what_is_allowed(words: tuple[str, ...], line: str) -> None:
    assert refused(*words).startswith(f"probe-design: {line}")


def command(name: str) -> click.Command:
    context, found = click.Context(cli), cli.get_command(click.Context(cli), name.split()[0])
    for part in name.split()[1:]:
        assert isinstance(found, click.Group)
        found = found.get_command(context, part)
    assert found is not None
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_has_a_line_and_each_option_a_sentence(name: str) -> None:
    summary = COMMANDS[name].summary
    assert command(name).short_help == summary
    assert summary.endswith(".")
    assert all(parameter.help for parameter in command(name).params if isinstance(parameter, click.Option))


def test_help_lists_each_command_in_one_line_of_80_columns_below_its_group(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = run("--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    headings = [line.removesuffix(":") for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert headings == ["Options", "Design", "Predict", "From readings", "Built probe", "Data"]
    for name, entry in COMMANDS.items():
        assert " " in name or f"  {name:13}  {entry.summary}" in lines


@pytest.mark.slow
def test_quiet_leaves_results_and_warnings(tmp_path: Any) -> None:
    words = ("sweep", SCENE.parent / "sweep.toml", "--workers", "1")
    noisy, quiet = (started(*words, "-o", tmp_path / str(k), *options) for k, options in enumerate(((), ("--quiet",))))
    assert "wrote results.csv" in noisy.stderr
    assert (quiet.returncode, quiet.stderr) == (0, "")
    assert quiet.stdout == noisy.stdout != ""
    loaded = tmp_path / "loaded.toml"
    loaded.write_text(SCENE.read_text().replace('force = "', 'force = "1'))
    warned = run("evaluate", loaded, "--evaluator", "closed-form", "--quiet")
    assert "probe-design: warning: " in warned.stderr
    assert all(line.startswith("probe-design: warning: ") for line in warned.stderr.splitlines())


def test_a_request_is_frozen() -> None:
    request = EvaluateRequest.build({"scene": SCENE, "accuracy": "1 %"})
    assert request.accuracy == 0.01
    with pytest.raises(ValueError, match="frozen"):
        request.accuracy = 0.1  # type: ignore[misc]


@pytest.mark.parametrize("width", [80, 120])
def test_help_has_no_line_beyond_the_terminal(width: int) -> None:
    """Neither prose nor examples: a terminal would cut or break them anywhere; quoted parts stay whole."""
    for name in ("", *COMMANDS):
        words = [*name.split(), "--help"]
        text = CliRunner().invoke(cli, words, terminal_width=width, max_content_width=width).output
        assert [line for line in text.splitlines() if len(line) > width] == [], name


def test_a_long_example_continues_after_a_backslash() -> None:
    line = 'probe-design read scene.toml --replay scope.csv --column "inner=CH1 mV" --column "outer=CH2 mV" --rate "1 kHz"'
    lines = wrap_line(line, 60)
    assert shlex.split("\n".join(lines).replace("\\\n", "")) == shlex.split(line)  # what the shell reads
    assert max(map(len, lines)) <= 60
    assert wrap_line("name   " + "word " * 20, 40)[1].startswith(" " * 7 + "word")
