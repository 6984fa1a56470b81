"""Add properties to a DXF file, which CAD programs list: the design, and the program that wrote the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.cad.stamp import Stamp
from geometry.provenance.texts import split_block

if TYPE_CHECKING:
    from ezdxf.document import Drawing


MAX_PIECE_CHARACTERS = 2000  # characters: a string of a DXF file holds 2049


def add_properties(document: Drawing, stamp: Stamp) -> Drawing:
    """Return a DXF document with custom properties: design, program, and the provenance block as JSON, split if too long."""
    entries = {"design": stamp.design, "program": stamp.program}
    parts = split_block(stamp.provenance, MAX_PIECE_CHARACTERS)
    names = ["provenance"] if len(parts) == 1 else [f"provenance {number}" for number in range(1, len(parts) + 1)]
    for name, text in {**entries, **dict(zip(names, parts, strict=True))}.items():
        document.header.custom_vars.append(name, text)
    return document
