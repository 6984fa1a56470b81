"""Read bytes, text and TOML from files of any content and size; refuse unusable files in one line."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject

LARGEST_FILE = 1_000_000  # bytes; a scene has a few hundred
# tomllib's time and the depth of what it returns grow with the parts of a dotted key; keys of ours have three
_LONG_KEY = re.compile(r"(?:\.[^.\n]*){100}")
_OTHER_KINDS = (  # pattern at the beginning of a text, what it is, and the command that takes it
    (r"\s*\{", "JSON", "probe-design rerun to repeat the run that wrote a JSON file"),
    (r"ISO-10303-21", "a STEP file", "it as `surface` of an [[inclusion]] in a scene file"),
    (r"solid \S*\s+facet", "an STL file", "it as `surface` of an [[inclusion]] in a scene file"),
    (r"\s*<(?:!doctype|html|svg)", "a page", "a browser to look at it"),
    (r"(?:#.*\n)*[^\n]*\b(?:stretch|strain)\b[^\n=]*[,;\t]", "a curve of a material, CSV", "probe-design material fit"),
    (r"[^\n=]*\bratio\b[^\n=]*\n", "readings of a scan, CSV", "--readings of probe-design locate or estimate"),
    (r"(?:[^\n=,;\t]*[,;\t])+[^\n=]*\n(?:[^\n=,;\t]*[,;\t])+", "CSV", "--replay of probe-design read for samples of a device"),
)


def read_text(path: Path | str, key: str, kind: str = "a TOML file", max_bytes: int = LARGEST_FILE) -> str:
    """Return the text of a file.

    Parameters
    ----------
    path
        Of the file.
    key
        Stands for the key in messages, such as "scene file".
    kind
        Of files that are allowed, for messages.
    max_bytes
        Bytes that it may have; no more are read.

    Raises
    ------
    InputError
        It cannot be read, is too large or no UTF-8 text.
    """
    try:
        return read_bytes(path, key, kind, max_bytes).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError(key, str(path), f"{kind}, which is UTF-8 text") from None


def read_bytes(path: Path | str, key: str, kind: str, max_bytes: int) -> bytes:
    """Return the bytes of a file; see ``read_text``. Raises ``InputError``: it cannot be read or is too large."""
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            content = file.read(max_bytes + 1)  # no more: devices and pipes have no size to ask for
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or str(fault)
        raise InputError(key, str(path), f"{kind} that can be read ({reason}{_name_file_within(path)})") from None
    if len(content) > max_bytes:
        raise InputError(key, str(path), f"{kind} of at most {max_bytes} bytes")
    return content


def _name_file_within(path: Path | str) -> str:
    """Return words that name a TOML file of a folder, first the design of an optimisation; empty for all else."""
    try:
        files = sorted(Path(path).glob("*.toml"), key=lambda file: (file.name != "design.toml", file.name))
    except (OSError, ValueError):
        return ""
    return f": a folder, which holds {files[0]}" if files else ""


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file; a pipe that nobody writes to is empty, where a plain ``open`` would wait for ever."""
    if os.name == "nt":
        return os.open(path, flags)
    handle = os.open(path, flags | os.O_NONBLOCK)
    os.set_blocking(handle, True)
    return handle


def parse_tables(text: str, name: str, allowed: str) -> JsonObject:
    """Parse TOML text to its tables.

    Parameters
    ----------
    text
        Of any content.
    name
        Where it is from, for messages.
    allowed
        What is accepted, likewise.

    Raises
    ------
    InputError
        It is no TOML.
    """
    try:
        if _LONG_KEY.search(text):
            raise tomllib.TOMLDecodeError("a line with 100 dots")
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        for pattern, kind, use in _OTHER_KINDS:
            if re.match(pattern, text, re.IGNORECASE):
                raise InputError(name, Words(f"{kind}, not TOML"), f"{allowed}; use {use}") from None
        raise InputError(name, Words(f"not TOML: {str(fault)[:200]}"), allowed) from None
    except (ValueError, RecursionError):  # as Python's limits on the digits of integers and on the depth of calls
        raise InputError(name, Words("TOML with a huge integer or deep nesting"), allowed) from None


def read_tables(path: Path | str, key: str, allowed: str = "a TOML file") -> JsonObject:
    """Return the tables of a TOML file; see ``read_text`` and ``parse_tables``."""
    return parse_tables(read_text(path, key, allowed), str(path), allowed)
