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

import click

from geometry.common.errors import InputError, ProbeError, Words
from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance, build_provenance
from geometry.provenance.texts import read_block
from probe_design.repetition.agreement import Difference, count_numbers, find_differences
from probe_design.repetition.command_line import build_rerun_words

TABLE_KEYS = {"results.csv": "rows", "tolerances.csv": "tolerances", "bill-of-materials.csv": "bill"}  # their keys
OPTIMIZE_FILE = "optimize.json"  # contains all numbers of its folder, whatever else is in it
NEGATIVE_EXIT_CODE = 1  # exit code of a command with a negative result


class RerunError(ProbeError):
    """The command that made a file fails now."""


@dataclass(frozen=True)
class Rerun:
    """The comparison of a file with its repetition.

    Attributes
    ----------
    command
        The repeated command line.
    numbers
        Number of values compared.
    differences
        Values that differ by more than their errors.
    version_changes
        Versions that differ, such as "numpy 2.3 then, 2.4 now".
    provenance
        Provenance of the repetition.
    """

    command: tuple[str, ...]
    numbers: int
    differences: tuple[Difference, ...]
    version_changes: tuple[str, ...]
    provenance: Provenance

    @property
    def agrees(self) -> bool:
        """Whether all numbers agree."""
        return not self.differences

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that versions differ, one line each."""
        return tuple(f"versions differ: {text}" for text in self.version_changes)

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design rerun``."""
        differences = [
            {"place": difference.place, "before": difference.recorded, "now": difference.repeated}
            for difference in self.differences
        ]
        return {
            "agrees": self.agrees, "numbers": self.numbers, "differences": differences, "command": list(self.command),
            "warnings": list(self.warnings), "provenance": self.provenance,
        }  # fmt: skip


def rerun(file: Path, cli: click.Group) -> Rerun:
    """Run the command that made a file or folder again, and compare the numbers.

    Parameters
    ----------
    file
        JSON, TOML or HTML page with its provenance; or the folder of such files.
    cli
        The group of all commands.

    Raises
    ------
    InputError
        It has no provenance, was made from Python, or its input files have changed.
    RerunError
        The command fails now.
    """
    block, recorded = _read_numbers(file)
    words = block.get("command")
    if not words or not isinstance(words, list):
        raise InputError("file", str(file), "made by a command line (this was made by a Python program)")
    with tempfile.TemporaryDirectory() as folder:
        file_folder, inputs = file if file.is_dir() else file.parent, block.get("inputs") or {}
        new_words = build_rerun_words(cli, [str(word) for word in words], inputs, file_folder.absolute(), Path(folder))
        repeated = _run_program(new_words)
        new_block = repeated.get("provenance") or build_provenance()
        # a command without such a file prints the numbers
        new_file = _find_counterpart(file, Path(folder))
        if new_file is not None:
            new_block, repeated = _read_numbers(new_file)
    if block.get("scene") != new_block.get("scene"):
        raise InputError("scene", Words("another one now"), f"the scene of the file, {block.get('scene')}")
    count = count_numbers(recorded, repeated)
    if count == 0:
        raise InputError("file", str(file), "a file with numbers beside its block of provenance")
    differences, version_changes = find_differences(recorded, repeated), _compare_versions(block, new_block)
    return Rerun(tuple(words), count, tuple(differences), tuple(version_changes), new_block)


def _read_numbers(file: Path) -> tuple[Provenance, JsonObject]:
    """Return provenance and numbers of a file or folder; those of a folder include the rows of its tables."""
    block, numbers = read_block(file)
    tables = {name: file / name for name in TABLE_KEYS if (file / name).is_file() and not (file / OPTIMIZE_FILE).is_file()}
    return block, numbers | {TABLE_KEYS[name]: list(_read_rows(path)) for name, path in tables.items()}


def _read_rows(path: Path) -> Iterator[JsonObject]:
    """Yield the rows of a CSV table, by heading without unit, with numbers converted; the column ``key`` is left out."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file, restkey=""):
                yield {name.partition(",")[0]: _parse_cell(text) for name, text in row.items() if name not in ("", "key")}
    except (UnicodeDecodeError, csv.Error):
        raise InputError("file", str(path), "a table as it was written") from None


def _parse_cell(text: str) -> float | str | None:
    """Return a cell as a number where it is one, None where it is empty."""
    try:
        return float(text) if text else None
    except ValueError:
        return text


def _run_program(words: list[str]) -> JsonObject:
    """Run the program with these words and return the JSON object that it prints; its standard error is passed on."""
    process = subprocess.run([sys.executable, "-m", "probe_design", *words], stdout=subprocess.PIPE, text=True, check=False)
    if process.returncode not in (0, NEGATIVE_EXIT_CODE):
        raise RerunError(f"the command that made the file ends now with exit code {process.returncode}: see above")
    try:
        printed = json.loads(process.stdout)
    except ValueError:
        raise RerunError("the command that made the file fails now: see above") from None
    return printed if isinstance(printed, dict) else {}


def _find_counterpart(file: Path, folder: Path) -> Path | None:
    """Return the new file of the same name, or the only one with the same suffix; None if only the printed object is new."""
    if file.is_dir():
        return folder if any(folder.iterdir()) else None
    if (folder / file.name).is_file():
        return folder / file.name
    candidates = [path for path in folder.iterdir() if path.suffix == file.suffix]
    return candidates[0] if len(candidates) == 1 else None


def _compare_versions(recorded: Provenance, repeated: Provenance) -> list[str]:
    """Describe the versions that differ between two runs."""
    old, new = ({"probe-design": block.get("program"), **(block.get("dependencies") or {})} for block in (recorded, repeated))
    return [f"{name} {old.get(name)} then, {new.get(name)} now" for name in {**old, **new} if old.get(name) != new.get(name)]
