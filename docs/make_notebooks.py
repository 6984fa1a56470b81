"""Execute the notebooks of ``examples/notebooks`` and store their outputs; run it after every change of what they print."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "notebooks"
CELL_TIMEOUT_S = 120


def execute_notebook(path: Path) -> Any:
    """Return a notebook with the outputs of its cells, which are executed in a kernel of this environment."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook, timeout=CELL_TIMEOUT_S, coalesce_streams=True, resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    for index, cell in enumerate(notebook.cells):
        cell.id = f"cell-{index + 1}"  # the same in every run
        cell.metadata = {}
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


if __name__ == "__main__":
    names = sys.argv[1:] or [path.name for path in sorted(FOLDER.glob("*.ipynb"))]
    for name in names:
        nbformat.write(execute_notebook(FOLDER / name), FOLDER / name)
