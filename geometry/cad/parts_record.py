"""Record the design of the parts in a folder, and refuse to replace them by those of another design."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from geometry.common.errors import InputError
from geometry.common.text_files import read_text
from geometry.provenance.block import build_provenance, compute_digest
from geometry.scenes.base_sizes import assume_sizes, find_base_sizes
from geometry.scenes.probe import Probe, format_mm

RECORD_NAME = "parts.json"
PART_FILES = tuple(f"{name}.step" for name in ("inner", "outer", "film-inner", "film-outer", "base", "assembly"))
RECORD_FORMAT: Literal["probe-design parts"] = "probe-design parts"
RECORD_VERSION: Literal[1] = 1
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
FileName = Annotated[str, Field(pattern=r"^\w[\w.-]*$", max_length=100)]


class PartsRecord(BaseModel):
    """Content of ``parts.json``, the record of the files in its folder.

    Attributes
    ----------
    design
        Digest of the probe's numbers, see ``compute_design_digest``.
    assumed
        Dimensions that the scene leaves open, by the keys that would give them.
    files
        SHA-256 of the parts and of other files of this design, by name.
    asked
        Digest of the design question that the design solves, if there is one.
    provenance
        What made the newest of the files, see ``geometry.provenance.block``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal["probe-design parts"] = RECORD_FORMAT
    version: Literal[1] = RECORD_VERSION
    design: Digest
    assumed: dict[str, str]
    files: dict[FileName, Digest]
    asked: Digest | None = None
    provenance: dict[str, object] | None = None

    def text(self) -> str:
        """Return the text of the file."""
        return self.model_dump_json(indent=2) + "\n"


def list_part_files(probe: Probe) -> tuple[str, ...]:
    """Return the names of a probe's files: those of films only where it has any."""
    return tuple(name for name in PART_FILES if probe.film is not None or not name.startswith("film"))


def compute_design_digest(probe: Probe, edge_radius: float = 0.0) -> str:
    """Return the digest of all numbers and materials of the parts, whichever keys the scene gives."""
    sizes = probe.inner_radius, probe.hole_radius, probe.tube_radius, probe.core_height, probe.tube_height
    bodies = probe.model_dump(
        include={
            "inner": True,
            "outer": True,
            "groove": True,
            "film": True,
            "base": {"youngs_modulus", "poisson_ratio", "material"},
        }
    )
    edges = {"edge_radius": edge_radius} if edge_radius else {}  # sharp designs keep the digest from before edges could be round
    return compute_digest({"sizes": sizes, "base": astuple(find_base_sizes(probe)), "bodies": bodies, **edges})


def build_record(
    probe: Probe, drafts: Mapping[str, Path], old_record: PartsRecord | None, question: str | None, edge_radius: float = 0.0
) -> PartsRecord:
    """Return the record of new parts.

    Parameters
    ----------
    probe
        The probe whose parts they are.
    drafts
        Where each file is now, by the name that it will have.
    old_record
        The record of the same design in the same folder, whose other files stay valid.
    question
        See ``PartsRecord``.
    edge_radius
        Of the blocks' lower edges, m.
    """
    old_files, question_digest = ({}, question) if old_record is None else (old_record.files, question or old_record.asked)
    assumed = {key: str(format_mm(length)) for key, length in assume_sizes(probe).items()}
    files = {**old_files, **{name: _compute_file_sha256(path) for name, path in drafts.items()}}
    design = compute_design_digest(probe, edge_radius)
    return PartsRecord(design=design, assumed=assumed, files=files, asked=question_digest, provenance=build_provenance())


def check_same_design(folder: Path, probe: Probe, edge_radius: float = 0.0) -> PartsRecord | None:
    """Return the record of the parts in a folder, which are this probe's with these edges, or None where it holds none.

    Raises
    ------
    InputError
        It holds parts of another design, or parts whose design is unknown.
    """
    record = find_record(folder)
    if record is not None and record.design != compute_design_digest(probe, edge_radius):
        raise _build_refusal(folder, "those there are of another design")
    return record


def check_same_question(folder: Path, question: str) -> None:
    """Refuse a folder that holds parts of another design question, before the work.

    Raises
    ------
    InputError
        It does, or their design is unknown.
    """
    record = find_record(folder)
    if record is not None and record.asked != question:
        raise _build_refusal(folder, "those there are of another design")


def find_record(folder: Path) -> PartsRecord | None:
    """Return the record of the parts in a folder, or None where it holds none.

    Raises
    ------
    InputError
        The record is missing, damaged, or one of other files than those that are there.
    """
    present = [name for name in PART_FILES if os.path.lexists(folder / name)]
    if not present and not os.path.lexists(folder / RECORD_NAME):
        return None
    record = read_record(folder)
    if record is None:
        trouble = "damaged" if os.path.lexists(folder / RECORD_NAME) else "missing"
        raise _build_refusal(folder, f"the design of its parts is unknown: {RECORD_NAME} is {trouble}")
    for name in present:
        if record.files.get(name) != _compute_file_sha256(folder / name):
            raise _build_refusal(folder, f"{name} is not the file listed in {RECORD_NAME}")
    return record


def read_record(folder: Path) -> PartsRecord | None:
    """Return the record in a folder; None where there is none that can be read."""
    try:
        return PartsRecord.model_validate_json(read_text(folder / RECORD_NAME, "output"))
    except (InputError, ValidationError):
        return None


def remove_replaced(folder: Path, old_record: PartsRecord | None, written: Iterable[str]) -> None:
    """Remove the remaining files of a replaced design: its other parts, and unchanged files of its record."""
    new, recorded = set(written), {} if old_record is None else old_record.files
    for name in {*PART_FILES, *recorded} - new:
        path = folder / name
        if path.is_file() and (name in PART_FILES or _compute_file_sha256(path) == recorded[name]):
            path.unlink()


def _build_refusal(folder: Path, reason: str) -> InputError:
    """Return the error that refuses to replace the parts in a folder, with the reason in parentheses."""
    return InputError(
        "output", str(folder), f"a folder without parts, or with the same design's ({reason}); --force replaces them"
    )


def _compute_file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content; an empty text if the path is no file."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
