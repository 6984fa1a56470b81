"""Keep solved probes in a file, one line each, so that an interrupted study can go on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from geometry.common.arrays import Floats


class SolvedProbes:
    """ln(F_inner / F_outer) on its blocks, of each probe by seed and by the variable that is off.

    Parameters
    ----------
    path
        Where they are kept; None: nowhere.
    block_tolerance
        Of the bench on whose blocks they were solved; None: the built-in one's.
    """

    def __init__(self, path: Path | None, block_tolerance: float | None) -> None:
        self._path, self._tolerance = path, block_tolerance
        lines = path.read_text().splitlines() if path is not None and path.exists() else []
        rows = [json.loads(line) for line in lines if line.endswith("}")]  # the last one may have been cut
        self._rows = {tuple(row["key"]): np.array(row["log_ratios"]) for row in rows}

    def get(self, seed: int, off: str | None, solve: Callable[[], Floats]) -> Floats:
        """Return those of a probe, solved where they are not known."""
        key = (self._tolerance, seed, off)
        if key not in self._rows:
            self._rows[key] = solve()
            self._keep({"key": key, "log_ratios": self._rows[key].tolist()})
        return self._rows[key]

    def _keep(self, row: dict[str, object]) -> None:
        if self._path is not None:
            with self._path.open("a") as file:
                file.write("\n" * (not self._whole) + json.dumps(row) + "\n")

    @property
    def _whole(self) -> bool:
        """Whether the file ends with a whole line."""
        return self._path is None or not self._path.exists() or self._path.read_text()[-1:] in ("", "\n")
