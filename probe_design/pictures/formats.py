"""The formats of pictures, known by the ends of their files' names."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.common.files import written_whole
from geometry.provenance.block import provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")


def check_format(path: Path) -> None:
    """Refuse a picture whose format is not known.

    Raises:
        InputError: the file's name ends in none of ``FORMATS``.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError("plot", path.name, f"a file name that ends in {', '.join(FORMATS)}")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure, whole or not at all, in the format of the file's name; returns ``path``.

    Raises:
        OSError: the file cannot be written.
    """
    with written_whole(path) as draft, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # of a scene's name in a script that the font has not: boxes stand for it
        kind = path.suffix[1:].lower()
        figure.savefig(draft, format=kind, metadata={"Subject" if kind == "pdf" else "Description": json.dumps(provenance())})
    return path
