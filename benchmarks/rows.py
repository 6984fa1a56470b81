"""Rows of long benchmarks in files of JSON lines: a run that was cut off continues where it stopped."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class RowFile:
    """Rows by their keys, each computed once and written at once.

    Parameters
    ----------
    path
        Of the file; None: rows are kept in memory alone.
    """

    def __init__(self, path: Path | None) -> None:
        self.path, self.rows = path, dict[str, Row]()
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                if line.endswith("}"):  # the last line of a run that was cut off may be half a line
                    row = json.loads(line)
                    self.rows[row.pop("key")] = row

    def get(self, key: str, compute: Callable[[], Row]) -> Row:
        """Return the row of a key, computed and appended to the file where it is not known."""
        if key not in self.rows:
            row = compute()
            self.rows[key] = row
            if self.path is not None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"key": key, **row}) + "\n")
        return self.rows[key]
