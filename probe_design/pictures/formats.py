"""Formats of pictures, by the suffix of the file name."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.common.files import written_whole
from geometry.provenance.texts import picture_metadata

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")


def check_format(path: Path) -> None:
    """Refuse a picture file of unknown format.

    Raises:
        InputError: the suffix is none of ``PICTURE_SUFFIXES``.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError("plot", path.name, f"a file name that ends in {', '.join(FORMATS)}")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as a whole or not at all, in the format of the file's suffix; return ``path``.

    Raises:
        OSError: the file cannot be written.
    """
    with written_whole(path) as draft, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # missing glyphs of a scene's name are drawn as boxes
        kind = path.suffix[1:].lower()
        figure.savefig(draft, format=kind, metadata=picture_metadata(kind))
    return path
