"""Render faces in three dimensions in a separate process, as VTK crashes without a message where OpenGL is missing."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import MissingLibrary
from probe_design.solid_output.faces import Faces

RENDER_PROGRAM = Path(__file__).with_name("render_process.py")
IMAGE_SIZE_PIXELS = (1800, 1300)  # pixels
RENDER_TIME_LIMIT_S = 300.0  # s: a software renderer needs a few for a large mesh
OPENGL_REMEDY = "install OpenGL with its software renderer: apt install libegl1 libgl1 (Debian, Ubuntu), mesa-libEGL (Fedora)"


def render_faces(parts: Sequence[Faces], colour: Callable[[int], tuple[float, float, float]], half_height: float = 0.0) -> Floats:
    """Render the part y >= 0 of faces without white margin; return pixels from 0 to 1, shape (height, width, 3).

    Args:
        parts: faces to draw.
        colour: returns red, green and blue of a body, from 0 to 1.
        half_height: half the height of the view about the origin, m; 0 shows everything.

    Raises:
        MissingLibrary: VTK could not render; the text names the package to install.
    """
    start = np.cumsum([0, *(len(part.points) for part in parts)])[:-1]
    body = np.concatenate([part.body for part in parts])
    arrays: dict[str, Any] = {
        "points": np.vstack([part.points for part in parts]),
        "triangles": np.vstack([part.triangles + n for part, n in zip(parts, start, strict=True)]),
        "lines": np.vstack([part.lines + n for part, n in zip(parts, start, strict=True)]),
        "colours": (255 * np.array([colour(number) for number in body.tolist()])).round().astype(np.uint8),
        "size": np.array(IMAGE_SIZE_PIXELS),
        "close": np.array(half_height),
    }
    with tempfile.TemporaryDirectory() as folder:
        source, picture = Path(folder, "arrays.npz"), Path(folder, "picture.png")
        np.savez(source, **arrays)
        _run_program(source, picture)
        return _crop_picture(picture)


def _run_program(arrays: Path, picture: Path) -> None:
    """Run the rendering program; raise ``MissingLibrary`` if it fails."""
    command = [sys.executable, "-P", str(RENDER_PROGRAM), str(arrays), str(picture)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=RENDER_TIME_LIMIT_S, check=False)
    except subprocess.TimeoutExpired as fault:
        raise MissingLibrary(f"VTK has not rendered the mesh in {RENDER_TIME_LIMIT_S:g} s: {OPENGL_REMEDY}") from fault
    if run.returncode or not picture.exists():
        lines = [line for line in run.stderr.strip().splitlines() if line.strip()]
        reason = (
            re.sub(r"\x1b\[\d*m", "", lines[-1].rsplit("| ", 1)[-1]).split(". ")[0] if lines else f"exit code {run.returncode}"
        )
        raise MissingLibrary(f"VTK cannot render ({reason}): {OPENGL_REMEDY}")


def _crop_picture(picture: Path) -> Floats:
    """Read a picture without its white margin."""
    from matplotlib.image import imread

    pixels = np.asarray(imread(picture), dtype=np.float64)[:, :, :3]
    is_drawn = (pixels < 0.99).any(axis=2)
    rows, columns = np.unique(np.nonzero(is_drawn)[0]), np.unique(np.nonzero(is_drawn)[1])
    if not len(rows):
        raise MissingLibrary(f"VTK renders an empty picture: {OPENGL_REMEDY}")
    return pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
