"""Write the provenance block into text files as a TOML comment or an HTML script, which other programs ignore, and read it."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

from geometry.common.errors import InputError, Words
from geometry.common.text_files import LARGEST_FILE, read_bytes
from geometry.provenance.block import BLOCK_FORMAT, BLOCK_VERSION, Provenance, build_provenance

TOML_LEAD = "# provenance = "
MARKDOWN_LEAD = "<!-- provenance = "
MAX_PIECE_CHARACTERS = 200  # characters: a string of a STEP file's header holds 256
HTML_SCRIPT = '<script type="application/json" id="{}">'
RECORD_FILES = ("provenance.json", "optimize.json", "tradeoff.json", "parts.json")  # of a folder: the first that exists is read
MAX_PAGE_BYTES = 200 * LARGEST_FILE  # bytes of a page with its pictures
_ALLOWED = "a JSON object, TOML file or page that probe-design made, or a folder of its files (of a drawing or solid its folder)"


def format_toml_comment(block: Provenance) -> str:
    """Return the comment line at the beginning of a TOML file."""
    return f"{TOML_LEAD}{json.dumps(block)}\n"


def format_html_script(name: str, content: object) -> str:
    """Return an HTML script that holds JSON and does nothing; no ``<`` in the JSON can end the script."""
    text = json.dumps(content, allow_nan=False).replace("<", "\\u003c")
    return f"{HTML_SCRIPT.format(name)}{text}</script>"


def format_markdown_comment(block: Provenance) -> str:
    """Return the comment line at the end of a Markdown page; no ``>`` in the block can end the comment."""
    text = json.dumps(block).replace(">", "\\u003e")
    return f"{MARKDOWN_LEAD}{text} -->\n"


def split_block(block: Provenance, max_characters: int = MAX_PIECE_CHARACTERS) -> list[str]:
    """Return the block's JSON, ASCII, in pieces of at most ``max_characters`` characters, for formats that hold short strings."""
    text = json.dumps(block)
    return [text[start : start + max_characters] for start in range(0, len(text), max_characters)]


def build_picture_metadata(kind: str, block: Provenance | None = None) -> dict[str, str]:
    """Return the metadata of a picture of kind "png", "svg" or "pdf": its provenance block as JSON."""
    return {"Subject" if kind == "pdf" else "Description": json.dumps(build_provenance() if block is None else block)}


def read_block(path: Path) -> tuple[Provenance, dict[str, object]]:
    """Return the provenance block of a file or folder, and the numbers that it documents.

    Raises
    ------
    InputError
        The file or folder cannot be read, or holds no block.
    """
    if path.is_dir():
        path = next((path / name for name in RECORD_FILES if (path / name).is_file()), path / RECORD_FILES[0])
    text = read_bytes(path, "file", _ALLOWED, MAX_PAGE_BYTES).decode("utf-8", errors="replace")
    content = _parse_content(text)
    block = content.pop("provenance", None)
    if not isinstance(block, dict) or block.get("format") != BLOCK_FORMAT:
        raise InputError("file", str(path), f"{_ALLOWED}, with its block of provenance")
    if block.get("version") != BLOCK_VERSION:
        raise InputError("file", str(path), f"a block of provenance of version {BLOCK_VERSION}")
    if not _holds_texts(block.get("command"), list) or not all(
        _holds_texts(block.get(key), dict) for key in ("inputs", "dependencies")
    ):
        raise InputError("file", str(path), "a block of provenance as it was written")
    return block, content


def _holds_texts(values_or_none: object, kind: type) -> bool:
    """Return whether a value is None, a list of texts, or a table of texts in which a version may be missing."""
    if values_or_none is None:
        return True
    if not isinstance(values_or_none, kind) or not isinstance(values_or_none, list | dict):
        return False
    values = values_or_none.values() if isinstance(values_or_none, dict) else values_or_none
    return all(isinstance(text, str) or (text is None and kind is dict) for text in values)


def _parse_content(text: str) -> dict[str, object]:
    """Return the content of JSON, an HTML page or TOML, with the block under ``provenance``; empty for any other text."""
    script = re.search(re.escape(HTML_SCRIPT.format("answer")) + "(.*?)</script>", text, re.S)
    try:
        if text.lstrip().startswith("{") or script:
            content = json.loads(text if script is None else script[1])
            return content if isinstance(content, dict) else {}
        lines = [line for line in text.splitlines()[:20] if line.startswith(TOML_LEAD)]
        if lines:
            return _parse_toml(text) | {"provenance": json.loads(lines[0].removeprefix(TOML_LEAD))}
    except (ValueError, RecursionError):
        pass
    return {}


def _parse_toml(text: str) -> dict[str, object]:
    """Return the tables of a TOML text. Raises ``InputError``."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise InputError("file", Words(f"not TOML: {str(fault)[:200]}"), _ALLOWED) from None
