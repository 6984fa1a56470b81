"""Give damaged scenes, other files and bad values of options to every command, as cheaply as possible."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from benchmarks.robustness.attempt import Attempt
from benchmarks.robustness.damage import NUMBERS, TEXTS, Random, garble, mutate
from benchmarks.robustness.files import FILE, LIMITS, ROOT, VIRTUAL, Readable
from benchmarks.robustness.readables import SCENES, readables
from benchmarks.robustness.samples import recordings

CHEAP = ("--accuracy", "0.1", *LIMITS)
LEVELS = ("auto", "published", "closed-form", "closed-form", "equivalent-inclusion", "axisymmetric", "contact", "solid")
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("plan", FILE), ("curve", FILE, "--points", "2", *CHEAP), ("scan", FILE, "--points", "2", *CHEAP),
    ("detectability", FILE, "--points", "2", *CHEAP), ("estimate", FILE, "--ratio", "0.6", *CHEAP), ("export", FILE, "-o", "out"),
    ("sweep", FILE, "-o", "out", "--workers", "1"), ("read", FILE, *VIRTUAL),
    ("load", FILE, "--to", "20 mN", "--points", "2", *CHEAP), ("tolerances", FILE, "--samples", "64", *LIMITS),
    ("estimate", FILE, "--ratio", "0.6", "--next", "--nuisance", "inclusion.diameter = 20 %", *CHEAP),
    ("evaluate", FILE, "--frequency", "5 Hz", *CHEAP), ("evaluate", FILE, "--loads", *CHEAP), ("doctor", FILE, *VIRTUAL),
)  # fmt: skip
OPTIONS = (
    "--accuracy", "--evaluator", "--memory", "--time", "--from", "--to", "--points", "--noise", "--ratio", "--seconds", "--plot",
    "--vtu", "-o", "--readings", "--workers", "--scheduler", "--replay", "--bench", "--calibration", "--device", "--along",
    "--unknown", "--stiffness", "--starts", "--outer-radius", "--seed", "--built", "--record", "--time-limit",
    "--nuisance", "--reading", "--column", "--rate", "--frequency", "--step", "--tolerance", "--shrinkage", "--draft",
    "--material", "--samples", "--stiffness-noise", "--report", "--wait", "--thinner", "--pareto",
)  # fmt: skip
LONE_COMMANDS = (
    ("material", "show"), ("material", "show", "ecoflex-00-10"), ("material", "list"), ("tissue", "show", "breast"), ("rerun",),
    ("optimize", "none.toml", "-o", "out"), ("doctor", "--virtual", "--seconds", "1"), ("check", "--virtual", "--seconds", "1"),
)  # fmt: skip
PATHS = ("/", "/dev/full", "/proc/x.png", "none/x.png", "out", ".", "x.png", "x.svg", "x" * 300 + ".png")


def scene(draw: Random, folder: Path) -> Attempt:
    """Draw a scene with other tables, for any command and evaluator."""
    right = draw.choice(SCENES)
    words = draw.choice([*COMMANDS, *(("evaluate", FILE, "--evaluator", level, *CHEAP) for level in LEVELS)])
    return _build_attempt(Readable(".toml", (*words, "--json"), right), mutate(right, draw), folder)


def other_tables(draw: Random, folder: Path) -> Attempt:
    """Any other file of tables with other values, keys or depths."""
    chosen = draw.choice([readable for readable in readables().values() if not isinstance(readable.right, bytes)])
    return _build_attempt(chosen, mutate(chosen.right, draw), folder)


def other_bytes(draw: Random, folder: Path) -> Attempt:
    """Any file with other bytes, recordings twice as often as others."""
    chosen = draw.choice([*readables().values(), *recordings().values()])
    return _build_attempt(chosen, garble(chosen.content, draw), folder)


def options(draw: Random, folder: Path) -> Attempt:
    """Options with values that are seldom allowed, also of commands that do not have them."""
    words = [str(ROOT / "examples" / "scene.toml") if word == FILE else word for word in draw.choice((*COMMANDS, *LONE_COMMANDS))]
    for _ in range(draw.randint(1, 2)):
        value = draw.choice([*TEXTS, *map(str, NUMBERS[:7]), "nan", "-inf", "1e400", *PATHS]).replace("\udce9", "?")
        words += [draw.choice(OPTIONS), value]
    return Attempt((*words, "--json"), "options")


def _build_attempt(readable: Readable, damaged: Any, folder: Path) -> Attempt:
    name, content = f"it{readable.suffix}", damaged if isinstance(damaged, bytes) else readable.dump(damaged)
    (folder / name).write_bytes(content)
    shutil.copy(ROOT / "examples" / "scene.toml", folder)  # what rerun asks about
    return Attempt(tuple(name if word == FILE else word for word in readable.words), f"{len(content)} bytes", readable.seconds)
