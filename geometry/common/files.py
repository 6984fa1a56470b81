"""Files written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside ``path`` that takes its place, flushed to disk, if the block succeeds.

    Example:
        >>> with written_whole(Path("table.txt")) as draft:  # doctest: +SKIP
        ...     draft.write_text("whole")
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent)
    draft = Path(folder, path.name)  # keeps the suffix, from which some writers choose the format
    try:
        yield draft
        _flush(draft)
        os.replace(draft, path)
        _flush(path.parent)
    finally:
        draft.unlink(missing_ok=True)
        os.rmdir(folder)


def check_writable(folder: Path) -> None:
    """Make sure that files can be written into ``folder``, making it if needed. Raises ``OSError``."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass


def write_text(path: Path, text: str) -> Path:
    """Write UTF-8 text whole; returns ``path``."""
    with written_whole(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path


def _flush(path: Path) -> None:
    if path.is_dir() and os.name == "nt":  # Windows opens no folders
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
