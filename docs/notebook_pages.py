"""Write a notebook as a page: its words, its code and the outputs that are stored in it. No kernel runs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = "examples/notebooks"


def write_page(path: Path) -> str:
    """Return the Markdown text of a notebook, pictures included."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    blocks = [block for cell in cells for block in _list_blocks(cell)]
    note = f"*This page is the notebook `{FOLDER}/{path.name}`, with the outputs of its last run.*"
    return "\n\n".join([blocks[0], note, *blocks[1:]]) + "\n"


def _list_blocks(cell: dict[str, Any]) -> Iterator[str]:
    """Yield the blocks of a cell."""
    if cell["cell_type"] == "markdown":
        yield "".join(cell["source"])
        return
    yield f"```python\n{''.join(cell['source'])}\n```"
    for output in cell["outputs"]:
        data = output.get("data", {"text/plain": output.get("text", "")})
        text = {kind: "".join(value) for kind, value in data.items() if isinstance(value, str | list)}
        if "image/png" in text:
            yield f'<img alt="figure" src="data:image/png;base64,{text["image/png"].replace(chr(10), "")}">'
        elif "text/html" in text and "xr-" not in text["text/html"]:  # xarray's needs its own style sheet
            yield _clean_html(text["text/html"])
        else:
            yield f"```text\n{text['text/plain'].rstrip()}\n```"


def _clean_html(html: str) -> str:
    """Return a table without pandas' styles and empty headings, and without empty lines, at which Markdown would end it."""
    html = re.sub(r"<style.*?</style>", "", html, flags=re.S).replace("<th></th>", "<td></td>")
    return "\n".join(line.strip() for line in html.splitlines() if line.strip())
