"""What `probe-design tradeoff` leaves behind: a page, a plot and a JSON file."""

from __future__ import annotations

import json
from pathlib import Path

from geometry.common.files import written_together
from geometry.provenance.block import provenance
from probe_design.tradeoffs.plot import plot
from probe_design.tradeoffs.study import Tradeoff
from probe_design.tradeoffs.tables import page

NAMES = ("tradeoff.png", "tradeoff.md", "tradeoff.json")


def write_all(study: Tradeoff, folder: Path) -> list[Path]:
    """Write everything into ``folder``, all of it or nothing; returns the paths.

    Raises:
        OSError: the folder cannot be written.
    """
    files = [folder / name for name in NAMES]
    summary = study.as_dict() | {"files": [str(file) for file in files], "provenance": provenance()}
    with written_together(folder, NAMES) as new:
        picture, table, data = (new / name for name in NAMES)
        plot(study, picture)
        table.write_text(page(study, picture.name), encoding="utf-8")
        data.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return files
