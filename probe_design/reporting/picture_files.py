"""Formats of pictures, by the suffix of the file name."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.common.files import write_whole
from geometry.provenance.texts import build_picture_metadata

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE_SUFFIXES = (".png", ".svg", ".pdf")


def check_format(path: Path) -> None:
    """Refuse a picture file of unknown format.

    Raises
    ------
    InputError
        The suffix is none of ``PICTURE_SUFFIXES``.
    """
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise InputError("plot", path.name, f"a file name that ends in {', '.join(PICTURE_SUFFIXES)}")


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as a whole or not at all, in the format of the file's suffix; return ``path``.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    with write_whole(path) as draft, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # missing glyphs of a scene's name are drawn as boxes
        kind = path.suffix[1:].lower()
        figure.savefig(draft, format=kind, metadata=build_picture_metadata(kind))
    return path
