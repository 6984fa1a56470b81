"""Damaged scenes and other files, and bad values of options, asked of every verb as cheaply as it can be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.attacks.attempt import Attempt
from benchmarks.attacks.damage import NUMBERS, TEXTS, Random, garbled, mutated
from benchmarks.attacks.files import FILE, LIMITS, ROOT, VIRTUAL, Readable, readables

CHEAP = ("--accuracy", "0.1", *LIMITS)
LEVELS = ("auto", "published", "closed-form", "closed-form", "equivalent-inclusion", "axisymmetric", "solid")
VERBS: tuple[tuple[str, ...], ...] = (
    ("plan", FILE), ("curve", FILE, "--points", "2", *CHEAP), ("scan", FILE, "--points", "2", *CHEAP),
    ("detectability", FILE, "--points", "2", *CHEAP), ("estimate", FILE, "--ratio", "0.6", *CHEAP), ("export", FILE, "-o", "out"),
    ("sweep", FILE, "-o", "out", "--workers", "1"), ("read", FILE, *VIRTUAL),
)  # fmt: skip
OPTIONS = (
    "--accuracy", "--evaluator", "--memory", "--time", "--from", "--to", "--points", "--noise", "--ratio", "--seconds", "--plot",
    "--vtu", "-o", "--readings", "--workers", "--scheduler", "--replay", "--bench", "--calibration", "--device", "--along",
    "--unknown", "--stiffness", "--starts", "--outer-radius", "--seed", "--built", "--record", "--time-limit",
)  # fmt: skip
PATHS = ("/", "/dev/full", "/proc/x.png", "none/x.png", "out", ".", "x.png", "x.svg", "x" * 300 + ".png")


def scene(draw: Random, folder: Path) -> Attempt:
    """A scene with other tables, asked of any verb and level."""
    right = readables()["scene" if draw.random() < 0.3 else "design"].right
    words = draw.choice([*VERBS, *(("evaluate", FILE, "--evaluator", level, *CHEAP) for level in LEVELS)])
    return _asked(Readable(".toml", (*words, "--json"), right), _dumped(mutated(right, draw)), folder)


def other_tables(draw: Random, folder: Path) -> Attempt:
    """Any other file of tables with other values, keys or depths."""
    some = draw.choice([one for one in readables().values() if not isinstance(one.right, bytes)])
    return _asked(some, _dumped(mutated(some.right, draw)), folder)


def other_bytes(draw: Random, folder: Path) -> Attempt:
    """Any file with other bytes, recordings twice as often as others."""
    some = draw.choice([*readables().values(), readables()["recording"]])
    return _asked(some, garbled(some.content, draw), folder)


def options(draw: Random, folder: Path) -> Attempt:
    """Options with values that are seldom allowed, also of verbs that do not have them."""
    words = [str(ROOT / "examples" / "scene.toml") if word == FILE else word for word in draw.choice(VERBS)]
    for _ in range(draw.randint(1, 2)):
        value = draw.choice([*TEXTS, *map(str, NUMBERS[:7]), "nan", "-inf", "1e400", *PATHS]).replace("\udce9", "?")
        words += [draw.choice(OPTIONS), value]
    return Attempt((*words, "--json"), "options")


def _asked(some: Readable, content: bytes, folder: Path) -> Attempt:
    name = f"it{some.suffix}"
    (folder / name).write_bytes(content)
    return Attempt(tuple(name if word == FILE else word for word in some.words), f"{len(content)} bytes")


def _dumped(tables: Any) -> bytes:
    """TOML; integers of more digits than Python writes are left to the bytes."""
    try:
        return tomli_w.dumps(tables).encode("utf-8", "surrogatepass")
    except ValueError:
        return b"a = " + b"9" * 5000
