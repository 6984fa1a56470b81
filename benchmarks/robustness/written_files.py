"""Files that the program itself writes and reads again: results, pages and designs with their provenance, for ``rerun``."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from typing import Any

from benchmarks.robustness.files import FILE, LIMITS, ROOT, SCENE, VIRTUAL, Readable
from geometry.provenance.texts import format_html_script, format_toml_comment

NAME = str(ROOT / "examples" / "scene.toml")
RERUN_WORDS = ("rerun", FILE, "--json")


def answers() -> dict[str, Readable]:
    """Return every kind of them by its name."""
    made = read_printed("evaluate", NAME, "--evaluator", "closed-form", "--json")
    page = "<!doctype html><title>Answer</title>" + format_html_script("answer", made)
    design = format_toml_comment(made["provenance"]) + Readable(".toml", (), SCENE).content.decode()
    reading = read_printed("read", NAME, *VIRTUAL, "--json")
    return {
        "an answer": Readable(".json", RERUN_WORDS, made),
        "its block": Readable(".json", RERUN_WORDS, {key: made[key] for key in ("ratio", "error_estimate", "provenance")}),
        "a page": Readable(".html", RERUN_WORDS, page.encode()),
        "a design with its block": Readable(".toml", RERUN_WORDS, design.encode()),
        "a reading": Readable(".json", ("estimate", NAME, "--reading", FILE, *LIMITS, "--json"), reading),
    }


@cache
def read_printed(*words: str) -> dict[str, Any]:
    """Return the object that the program prints for these words."""
    ended = subprocess.run([sys.executable, "-m", "probe_design", *words], capture_output=True, check=True, cwd=ROOT)
    document: dict[str, Any] = json.loads(ended.stdout)
    return document
