"""Words that are almost right, and those that a shell completes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from solver.evaluators import AUTO, EVALUATOR_NAMES
from tests.support.paths import SCENE
from tests.support.program import refused, run


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("evalaute", SCENE), "did you mean 'evaluate'?"),
        (("tissue", "lits"), "did you mean 'list'?"),
        (("evaluate", SCENE, "--evaluator", "axisymetric"), "did you mean 'axisymmetric'?"),
        (("evaluate", SCENE, "--evaluator", "Solid"), "did you mean 'solid'?"),
        (("evaluate", SCENE, "--acuracy", "0.1"), "--accuracy"),
        (("optimize", SCENE, "-o", "out", "--evaluator", "axisymetric"), "did you mean 'axisymmetric'?"),
        (("estimate", SCENE, "--ratio", "0.5", "--unknown", "diametre"), "did you mean 'diameter'?"),
        (("estimate", SCENE, "--ratio", "0.5", "--nuisance", "probe.gpa=1 %"), "did you mean 'probe.gap'?"),
        (("tolerances", SCENE, "--tolerance", "probe.gpa=1 um"), "did you mean 'probe.gap'?"),
        (("material", "show", "ecoflx-00-10"), "did you mean 'ecoflex-00-10'?"),
        (("tissue", "show", "brest"), "did you mean 'breast'?"),
        (("read", SCENE, "--virtual", "--built", "probe.gpa=1 mm"), "did you mean 'probe.gap'?"),
    ],
)
def test_what_was_likely_meant_is_told(words: tuple[str, ...], meant: str) -> None:
    assert meant in refused(*words)


SWEEP = """scene = "{scene}"
[variables]
"{key}" = {{{part} = ["0.1 mm"]}}
"""
FILES = {  # what is wrong in it, the command that reads it, and what is meant
    "sweep": (SWEEP.format(scene=SCENE, key="probe.gapp", part="values"), "did you mean 'gap'?"),
    "sweep ": (SWEEP.format(scene=SCENE, key="probe.gap", part="vals"), "did you mean 'values'?"),
    "sweep  ": (f'scene = "{SCENE}"\nevaluater = "closed-form"', "did you mean 'evaluator'?"),
    "read": ("[workshp]\nlength = '1 um'\n", "did you mean 'workshop'?"),
    "read ": ("[channels]\ngian = 0.1\n", "did you mean 'gain'?"),
    "estimate": ("ratoi,noise\n0.5,0.01\n", "did you mean 'ratio'?"),
    "evaluate": (SCENE.read_text(encoding="utf-8").replace('"bonded"', '"bondd"'), "did you mean 'bonded'?"),
    "plan": ('scene = "s.toml"\n[population]\ndepth = ["5 mm", "9 mm"]\n', "use probe-design optimize"),
    "plan ": ('scene = "s.toml"\n[variables]\n', "use probe-design optimize or probe-design sweep"),
    "plan  ": (SCENE.read_text(encoding="utf-8").replace('"0.1 mm"', '"0.3 m"'), "probe.gap = 300 mm: allowed: less than 40."),
    "evaluate ": (SCENE.read_text(encoding="utf-8").replace('"cylinder"', '"cylindre"'), "did you mean 'cylinder'?"),
}


@pytest.mark.parametrize("command", FILES)
def test_what_was_likely_meant_in_a_file_is_told(command: str, tmp_path: Path) -> None:
    text, meant = FILES[command]
    file = tmp_path / ("file.csv" if "," in text else "file.toml")
    file.write_text(text, encoding="utf-8")
    words: dict[str, tuple[object, ...]] = {
        "sweep": (file, "-o", tmp_path / "out"),
        "read": (SCENE, "--virtual", "--bench", file),
        "estimate": (SCENE, "--readings", file),
        "evaluate": (file,),
        "plan": (file,),
    }
    assert meant in refused(command.strip(), *words[command.strip()])


KINDS = {  # the file of another kind, and what reads it
    "design": ('scene = "s.toml"\n[population]\ndepth = "9 mm"\n', "a design file", "use probe-design optimize"),
    "sweep": ('scene = "s.toml"\nevaluator = "closed-form"\n[variables]\n', "a sweep file", "use probe-design sweep"),
    "scene": (SCENE.read_text(encoding="utf-8"), "a scene file", "use probe-design evaluate, plan or optimize"),
    "bench": ('[load]\nfrequency = "5 Hz"\n[channels]\ngain = 0.1\n', "a bench file", "use --bench of probe-design read"),
    "calibration": (
        "cross_talk_resolved = [true]\nworkshop = [1.0]\n",
        "a calibration file",
        "use --calibration of probe-design read",
    ),
    "tumours": ('[[inclusion]]\ndiameter = "9 mm"\n', "a file of tumours alone", "use --hide of probe-design survey --virtual"),
}


@pytest.mark.parametrize(
    ("reader", "given"),
    [
        *(("evaluate", file_kind) for file_kind in ("design", "sweep", "bench", "calibration", "tumours")),
        *(("optimize", file_kind) for file_kind in ("sweep", "bench", "calibration", "tumours")),
        *(("sweep", file_kind) for file_kind in ("design", "scene", "bench", "calibration")),
        *(("read", file_kind) for file_kind in ("design", "sweep", "scene", "calibration")),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_reads_it(reader: str, given: str, tmp_path: Path) -> None:
    text, kind, use = KINDS[given]
    file = tmp_path / "file.toml"
    file.write_text(text, encoding="utf-8")
    words = (SCENE, "--virtual", "--bench", file) if reader == "read" else (file,)
    output = ("-o", tmp_path / "out") if reader in ("optimize", "sweep") else ()
    message = refused(reader, *words, *output)
    assert f"{file} = {kind}: " in message
    assert use in message
    assert not (tmp_path / "out").exists()


def test_of_a_folder_its_file_is_named(tmp_path: Path) -> None:
    for name in ("a.toml", "design.toml"):
        (tmp_path / name).touch()
    assert f"which holds {tmp_path / 'design.toml'}" in refused("evaluate", tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", SCENE, "--evaluator", "closed-form", "--accuracy", "1%"),
        ("estimate", SCENE, "--ratio", "0.563", "--noise", "2 %"),
        ("tolerances", SCENE, "--tolerance", "probe.inner.youngs_modulus = 10 %"),
    ],
)
def test_fractions_may_be_percentages(words: tuple[str, ...]) -> None:
    """As people write them, wherever a fraction is asked for."""
    assert run(*words, "--json").returncode == 0


def test_a_gap_wider_than_the_core_is_doubted(tmp_path: Path) -> None:
    path = tmp_path / "wide.toml"
    path.write_text(SCENE.read_text(encoding="utf-8").replace('gap = "0.1 mm"', 'gap = "8 mm"'))
    for words in (("evaluate", path, "--evaluator", "closed-form"), ("plan", path)):
        assert "probe.gap = 8 mm is wider than probe.inner_radius, 4 mm: is its unit right?" in run(*words).stderr


def completions(*words: str) -> list[str]:
    """What bash receives for the last word, as click asks for it."""
    requests = {
        "_PROBE_DESIGN_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(("probe-design", *words)),
        "COMP_CWORD": str(len(words)),
    }
    code = "import sys; sys.argv[0] = 'probe-design'; from probe_design.__main__ import main; main()"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **requests}, check=True
    )
    return [line.partition(",")[2] for line in ended.stdout.splitlines()]


def test_a_shell_completes_verbs_and_evaluators() -> None:
    assert completions("evalu") == ["evaluate"]
    assert completions("evaluate", "scene.toml", "--evaluator", "") == [AUTO, *EVALUATOR_NAMES]
    assert completions("evaluate", "scene.toml", "--evaluator", "ax") == ["axisymmetric"]
