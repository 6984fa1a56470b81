"""Command lines with any value for any option: computed, or refused in one line; never a defect or a code for terminals."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from probe_design.commands.main import cli
from tests.support.paths import SCENE
from tests.support.program import run

CHEAP = ("evaluate", "export", "optimize", "tradeoff", "sweep", "calibrate", "check")
GIVEN = {
    "evaluate": (str(SCENE), "--evaluator", "closed-form"),
    "estimate": (str(SCENE), "--ratio", "0.56", "--accuracy", "0.3"),
    **{command_name: (str(SCENE), "--points", "2", "--accuracy", "0.3") for command_name in ("curve", "scan", "detectability")},
    **dict.fromkeys(("optimize", "export", "tradeoff", "sweep"), ("absent.toml", "-o", "out")),
    **dict.fromkeys(("read", "check"), ("--replay", "absent")),
    "calibrate": ("--replay", "absent", "-o", "out"),
    "plan": (str(SCENE),),
}
VALUES = st.one_of(
    st.sampled_from(
        ["", " ", "nan", "-inf", "1e400", "-1e400", "1e-320", "0", "-1", "1", "0.5", "٣", "１", "½", "1_000", "0x10", "1,5",
         "true", "5 mm", "-5 mm", "0 mm", "nan mm", "1e400 mm", "0.1 mm^0", "0e99999999999999999999 mm", "1 kPa", "1 s", "1e9 s",
         "1 GB", "x" * 3000, "\x1b[31m", "a\nb", "\udcff", "--", "-", "=", "%s", "{0}", "[/b]", "/dev/zero", "/", "..", "9" * 400,
         "usb:", "usb:\x1b", "visa:", "replay:", "probe.gap=", "probe.gap=nan", "=", "probe.inner.poisson_ratio=0.5"]
    ),
    st.text(st.characters(exclude_characters="\0"), max_size=8),
    st.floats().map(str),
)  # fmt: skip
COMMANDS = {name: cli.get_command(click.Context(cli), name) for name in (*CHEAP, *GIVEN)}
OPTIONS = {
    name: [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    for name, command in COMMANDS.items()
    if command is not None
}


@st.composite
def command_lines(draw: st.DrawFn, command_names: list[str]) -> list[str]:
    command_name = draw(st.sampled_from(command_names))
    words = [command_name, *GIVEN[command_name]]
    for _ in range(draw(st.integers(1, 2))):
        option = draw(st.sampled_from(OPTIONS[command_name]))
        name = max(option.opts, key=len)
        words += [name] if option.is_flag else [f"{name}={draw(VALUES)}"] if draw(st.booleans()) else [name, draw(VALUES)]
    return words


def answered_or_refused(words: list[str], folder: Path) -> None:
    ended = run(*words, cwd=folder)
    if ended.returncode == 0:
        assert "--json" not in words or isinstance(json.loads(ended.stdout), dict)
        assert not {"nan", "inf", "NaN", "Infinity"} & set(ended.stdout.replace(",", " ").split())
    else:
        assert (ended.returncode, ended.stdout) == (2, ""), ended.stderr
        assert ended.stderr.count("\n") == 1
    assert "defect" not in ended.stderr
    assert all(character.isprintable() or character == "\n" for character in ended.stderr + ended.stdout)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lines")


@given(words=command_lines(list(CHEAP)))
@settings(max_examples=15, suppress_health_check=list(HealthCheck))
def test_values_of_options(folder: Path, words: list[str]) -> None:
    answered_or_refused(words, folder)


@pytest.mark.slow
@pytest.mark.timeout(1500)
@given(words=command_lines(list(GIVEN)))
@settings(max_examples=150, suppress_health_check=list(HealthCheck))
def test_many_values_of_options(folder: Path, words: list[str]) -> None:
    answered_or_refused(words, folder)
