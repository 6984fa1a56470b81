"""Run the command that made a file again, and compare the numbers."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from geometry.common.errors import InputError, ProbeError, Words
from geometry.provenance.block import Provenance, provenance
from geometry.provenance.texts import block_of
from probe_design.repetition.agreement import Difference, compared, differences
from probe_design.repetition.command_line import rerun_words

TABLES = {"results.csv": "rows", "tolerances.csv": "tolerances", "bill-of-materials.csv": "bill"}  # their keys
WHOLE = "optimize.json"  # contains all numbers of its folder, whatever else is in it
NO_GAIN = 1  # exit code of a command with a negative result


class RerunError(ProbeError):
    """The command that made a file fails now."""


@dataclass(frozen=True)
class Rerun:
    """The comparison of a file with its repetition.

    Attributes:
        command: the repeated command line.
        numbers: number of values compared.
        differences: values that differ by more than their errors.
        version_changes: such as "numpy 2.3 then, 2.4 now".
        provenance: of the repetition.
    """

    command: tuple[str, ...]
    numbers: int
    differences: tuple[Difference, ...]
    changed: tuple[str, ...]
    provenance: Provenance

    @property
    def agrees(self) -> bool:
        """Whether all numbers agree."""
        return not self.differences

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that versions differ, one line each."""
        return tuple(f"versions differ: {text}" for text in self.changed)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design rerun``."""
        places = [{"place": one.place, "before": one.before, "now": one.now} for one in self.differences]
        return {
            "agrees": self.agrees, "numbers": self.numbers, "differences": places, "command": list(self.command),
            "warnings": list(self.warnings), "provenance": self.provenance,
        }  # fmt: skip


def rerun(file: Path, cli: click.Group) -> Rerun:
    """Run the command that made a file or folder again, and compare the numbers.

    Args:
        file: JSON, TOML or HTML page with its provenance; or the folder of such files.
        cli: the commands.

    Raises:
        InputError: it has no provenance, was made from Python, or its input files have changed.
        RerunError: the command fails now.
    """
    block, before = _told(file)
    words = block.get("command")
    if not words or not isinstance(words, list):
        raise InputError("file", str(file), "made by a command line (this was made by a Python program)")
    with tempfile.TemporaryDirectory() as folder:
        beside = file if file.is_dir() else file.parent
        again = rerun_words(cli, [str(word) for word in words], block.get("inputs") or {}, beside.absolute(), Path(folder))
        printed = _printed(again)
        made = _counterpart(file, Path(folder))
        now_block, now = (printed.get("provenance") or provenance(), printed) if made is None else _told(made)
    if block.get("scene") != now_block.get("scene"):
        raise InputError("scene", Words("another one now"), f"the scene of the file, {block.get('scene')}")
    count = compared(before, now)
    if count == 0:
        raise InputError("file", str(file), "a file with numbers beside its block of provenance")
    return Rerun(tuple(words), count, tuple(differences(before, now)), tuple(_changed(block, now_block)), now_block)


def _told(file: Path) -> tuple[Provenance, dict[str, Any]]:
    """Read provenance and numbers of a file or folder; those of a folder include the rows of its tables."""
    block, found = block_of(file)
    there = {name: file / name for name in TABLES if (file / name).is_file() and not (file / WHOLE).is_file()}
    return block, found | {TABLES[name]: list(_rows(path)) for name, path in there.items()}


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a CSV table by heading without unit; numbers are converted."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file, restkey=""):
                yield {name.partition(",")[0]: _number(text) for name, text in row.items() if name not in ("", "key")}
    except (UnicodeDecodeError, csv.Error):
        raise InputError("file", str(path), "a table as it was written") from None


def _number(text: str) -> float | str | None:
    try:
        return float(text) if text else None
    except ValueError:
        return text


def _printed(words: list[str]) -> dict[str, Any]:
    """Run the program with these words and return the JSON object that it prints; its standard error is passed on."""
    ended = subprocess.run([sys.executable, "-m", "probe_design", *words], stdout=subprocess.PIPE, text=True, check=False)
    if ended.returncode not in (0, NO_GAIN):
        raise RerunError(f"the command that made the file ends now with exit code {ended.returncode}: see above")
    try:
        found = json.loads(ended.stdout)
    except ValueError:
        raise RerunError("the command that made the file fails now: see above") from None
    return found if isinstance(found, dict) else {}


def _counterpart(file: Path, folder: Path) -> Path | None:
    """Return the new file of the same name, or the only one with the same suffix; None if only the printed object is new."""
    if file.is_dir():
        return folder if any(folder.iterdir()) else None
    if (folder / file.name).is_file():
        return folder / file.name
    alike = [path for path in folder.iterdir() if path.suffix == file.suffix]
    return alike[0] if len(alike) == 1 else None


def _changed(before: Provenance, now: Provenance) -> list[str]:
    """Describe the versions that differ between two runs."""
    old, new = ({"probe-design": one.get("program"), **(one.get("dependencies") or {})} for one in (before, now))
    return [f"{name} {old.get(name)} then, {new.get(name)} now" for name in {**old, **new} if old.get(name) != new.get(name)]
