"""The notebooks run from the first cell to the last, and print what is stored in them and so shown on the site."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.page_output import Line, find_missing
from tests.support.paths import DOCS, EXAMPLES

NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))
CHANGING = ("seconds", "<Figure")  # lines that differ from run to run


def read_outputs(notebook: Any) -> list[tuple[list[str], int]]:
    """Return for each cell with code the lines that it printed, and the number of its pictures."""
    outputs_shown = []
    for cell in notebook.cells:
        outputs = [output.get("data", {"text/plain": output.get("text", "")}) for output in cell.get("outputs", [])]
        lines = [line for output in outputs for line in output["text/plain"].splitlines()]
        shown = [line for line in lines if line.strip() and not line.startswith(CHANGING)]
        outputs_shown.append((shown, sum("image/png" in output for output in outputs)))
    return outputs_shown


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_prints_what_it_shows(path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat

    monkeypatch.syspath_prepend(str(DOCS))
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # with Agg no notebook shows a picture
    make_notebooks = __import__("make_notebooks")
    stored, printed = nbformat.read(path, as_version=4), make_notebooks.execute_notebook(path)
    for (lines, pictures), (new_lines, new_pictures) in zip(read_outputs(stored), read_outputs(printed), strict=True):
        assert find_missing(Line("", tuple(lines)), "\n".join(new_lines)) is None, new_lines
        assert pictures == new_pictures


def test_notebooks_hold_outputs_without_errors_and_few_words() -> None:
    import nbformat

    assert len(NOTEBOOKS) == 6
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        assert all(output["output_type"] != "error" for cell in notebook.cells for output in cell.get("outputs", []))
        assert sum(pictures for _, pictures in read_outputs(notebook)) or "built" in path.stem
        assert sum(len(cell.source.split()) for cell in notebook.cells if cell.cell_type == "markdown") < 120
        assert path.stat().st_size < 300_000
