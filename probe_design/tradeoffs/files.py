"""What `probe-design tradeoff` leaves behind: a page, a plot and a JSON file."""

from __future__ import annotations

import json
from pathlib import Path

from geometry.common.files import write_text
from probe_design.tradeoffs.plot import plot
from probe_design.tradeoffs.study import Tradeoff
from probe_design.tradeoffs.tables import page


def write_all(study: Tradeoff, folder: Path) -> list[Path]:
    """Write everything into ``folder``, each file whole, the JSON file last; returns their paths.

    Raises:
        OSError: the folder cannot be written.
    """
    picture = plot(study, folder / "tradeoff.png")
    files = [picture, write_text(folder / "tradeoff.md", page(study, picture.name)), folder / "tradeoff.json"]
    summary = study.as_dict() | {"files": [str(file) for file in files]}
    write_text(files[-1], json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return files
