"""Words that are almost right, and those that a shell completes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from solver.levels import AUTO, BUILT
from tests.support.paths import SCENE
from tests.support.program import refused


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("evalaute", SCENE), "did you mean 'evaluate'?"),
        (("tissue", "lits"), "did you mean 'list'?"),
        (("evaluate", SCENE, "--evaluator", "axisymetric"), "did you mean 'axisymmetric'?"),
        (("evaluate", SCENE, "--evaluator", "Solid"), "did you mean 'solid'?"),
        (("evaluate", SCENE, "--acuracy", "0.1"), "--accuracy"),
    ],
)
def test_what_was_likely_meant_is_told(words: tuple[str, ...], meant: str) -> None:
    assert meant in refused(*words)


def completions(*words: str) -> list[str]:
    """What bash is told for the last word, as click asks for it."""
    asked = {
        "_PROBE_DESIGN_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(("probe-design", *words)),
        "COMP_CWORD": str(len(words)),
    }
    code = "import sys; sys.argv[0] = 'probe-design'; from probe_design.__main__ import main; main()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **asked}, check=True)
    return [line.partition(",")[2] for line in ended.stdout.splitlines()]


def test_a_shell_completes_verbs_and_evaluators() -> None:
    assert completions("evalu") == ["evaluate"]
    assert completions("evaluate", "scene.toml", "--evaluator", "") == [AUTO, *BUILT]
    assert completions("evaluate", "scene.toml", "--evaluator", "ax") == ["axisymmetric"]
