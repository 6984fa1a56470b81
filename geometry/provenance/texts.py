"""The block in texts: a comment line of TOML, a script of HTML, which other readers pass over; and out of them again."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError, Words
from geometry.common.text_files import LARGEST_FILE, read_bytes
from geometry.provenance.block import FORMAT, VERSION, Provenance, provenance

LEAD = "# provenance = "
REMARK = "<!-- provenance = "
PIECE = 200  # characters: a string of a STEP file's header holds 256
SCRIPT = '<script type="application/json" id="{}">'
KEEPERS = ("provenance.json", "optimize.json", "tradeoff.json", "parts.json")  # of a folder: the first that is there tells
MOST = 200 * LARGEST_FILE  # bytes of a page with its pictures
_ALLOWED = "a JSON object, TOML file or page that probe-design made, or a folder of its files (of a drawing or solid its folder)"


def toml_comment(block: Provenance) -> str:
    """Return the comment line that a TOML file begins with."""
    return f"{LEAD}{json.dumps(block)}\n"


def html_script(name: str, content: Any) -> str:
    """Return a script of an HTML page that holds JSON and does nothing; no ``<`` in it can end it."""
    text = json.dumps(content, allow_nan=False).replace("<", "\\u003c")
    return f"{SCRIPT.format(name)}{text}</script>"


def markdown_comment(block: Provenance) -> str:
    """Return the comment line that a page of Markdown ends with; no ``>`` in it can end it."""
    text = json.dumps(block).replace(">", "\\u003e")
    return f"{REMARK}{text} -->\n"


def pieces(block: Provenance, most: int = PIECE) -> list[str]:
    """Return the block's JSON, ASCII, in pieces of at most ``max_characters`` characters, for formats that hold short strings."""
    text = json.dumps(block)
    return [text[start : start + most] for start in range(0, len(text), most)]


def picture_metadata(kind: str, block: Provenance | None = None) -> dict[str, str]:
    """Return what a picture of a kind, "png", "svg" or "pdf", says of itself: its block of provenance as JSON."""
    return {"Subject" if kind == "pdf" else "Description": json.dumps(provenance() if block is None else block)}


def block_of(path: Path) -> tuple[Provenance, dict[str, Any]]:
    """Return the block of a file or folder, and the numbers that stand beside it.

    Raises:
        InputError: it cannot be read, or holds no block.
    """
    if path.is_dir():
        path = next((path / name for name in KEEPERS if (path / name).is_file()), path / KEEPERS[0])
    text = read_bytes(path, "file", _ALLOWED, MOST).decode("utf-8", errors="replace")
    content = _content(text)
    block = content.pop("provenance", None)
    if not isinstance(block, dict) or block.get("format") != FORMAT:
        raise InputError("file", str(path), f"{_ALLOWED}, with its block of provenance")
    if block.get("version") != VERSION:
        raise InputError("file", str(path), f"a block of provenance of version {VERSION}")
    if not _texts(block.get("command"), list) or not all(_texts(block.get(key), dict) for key in ("inputs", "dependencies")):
        raise InputError("file", str(path), "a block of provenance as it was written")
    return block, content


def _texts(some: Any, kind: type) -> bool:
    """Whether it is nothing, or a list of texts, or a table of them, of which a version may be missing."""
    values = some.values() if isinstance(some, dict) else some or []
    return some is None or (
        isinstance(some, kind) and all(isinstance(one, str) or (one is None and kind is dict) for one in values)
    )


def _content(text: str) -> dict[str, Any]:
    """What JSON, a page or TOML holds, the block under ``provenance``; empty where it is none of them."""
    script = re.search(re.escape(SCRIPT.format("answer")) + "(.*?)</script>", text, re.S)
    try:
        if text.lstrip().startswith("{") or script:
            found = json.loads(text if script is None else script[1])
            return found if isinstance(found, dict) else {}
        lines = [line for line in text.splitlines()[:20] if line.startswith(LEAD)]
        if lines:
            return _tables(text) | {"provenance": json.loads(lines[0].removeprefix(LEAD))}
    except (ValueError, RecursionError):
        pass
    return {}


def _tables(text: str) -> dict[str, Any]:
    import tomllib

    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise InputError("file", Words(f"not TOML: {str(fault)[:200]}"), _ALLOWED) from None
