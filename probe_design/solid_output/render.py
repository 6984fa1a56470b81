"""Render faces in three dimensions in a child process, as VTK crashes without a message where OpenGL is missing."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import MissingLibrary
from geometry.processes.child import Died, Failure
from geometry.processes.programs import run_program
from probe_design.solid_output.faces import Faces, merge_faces

RENDER_PROGRAM = Path(__file__).with_name("render_program.py")
IMAGE_SIZE_PIXELS = (1800, 1300)  # pixels
RENDER_TIME_LIMIT_S = 300.0  # s: a software renderer needs a few for a large mesh
OPENGL_REMEDY = "install OpenGL with its software renderer: apt install libegl1 libgl1 (Debian, Ubuntu), mesa-libEGL (Fedora)"


def render_faces(parts: Sequence[Faces], colour: Callable[[int], tuple[float, float, float]], half_height: float = 0.0) -> Floats:
    """Render the part y >= 0 of faces without white margin; return pixels from 0 to 1, shape (height, width, 3).

    Parameters
    ----------
    parts
        Faces to draw.
    colour
        Returns red, green and blue of a body, from 0 to 1.
    half_height
        Half the height of the view about the origin, m; 0 shows everything.

    Raises
    ------
    MissingLibrary
        VTK could not render; the text names the package to install.
    """
    faces = merge_faces(parts)
    drawing = {
        "points": faces.points,
        "triangles": faces.triangles,
        "lines": faces.lines,
        "colours": (255 * np.array([colour(number) for number in faces.body.tolist()])).round().astype(np.uint8),
        "size": IMAGE_SIZE_PIXELS,
        "half_height": half_height,
    }
    try:
        pixels = run_program(RENDER_PROGRAM, drawing, RENDER_TIME_LIMIT_S)
    except Failure as fault:
        raise MissingLibrary(f"VTK cannot render ({_shorten_reason(fault)}): {OPENGL_REMEDY}") from fault
    is_drawn = (pixels < 0.99).any(axis=2)  # not white
    rows, columns = np.unique(np.nonzero(is_drawn)[0]), np.unique(np.nonzero(is_drawn)[1])
    if not len(rows):
        raise MissingLibrary(f"VTK renders an empty picture: {OPENGL_REMEDY}")
    return np.asarray(pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], dtype=np.float64)


def _shorten_reason(fault: Failure) -> str:
    """Return the first sentence of what VTK wrote last, without colours and the place in its sources."""
    text = (fault.last_line if isinstance(fault, Died) else "") or str(fault)
    return re.sub(r"\x1b\[\d*m", "", text.rsplit("| ", 1)[-1]).split(". ")[0]
