"""Paths that are not ordinary files: absent, folders, pipes, devices, sockets, loops, unreadable, endless, huge, badly named."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

from benchmarks.robustness.attempt import Attempt
from benchmarks.robustness.damage import Random
from benchmarks.robustness.files import FILE, write_scene
from benchmarks.robustness.readables import readables

SPARSE_BYTES = 10 * 2**30  # bytes, none of them on the disk


def special(draw: Random, folder: Path) -> Attempt:
    """One of them in the place of any file that is read: a surface, or a file of its own."""
    kind, what = draw.choice(sorted(FILES)), draw.choice(["surface", "surface", *readables()])
    if what == "surface":
        name = _made(kind, folder, draw.choice([".stl", ".step"]))
        words: tuple[str, ...] = (draw.choice(["plan", "evaluate"]), write_scene(folder, {"surface": name}), "--json")
    else:
        name = _made(kind, folder, readables()[what].suffix)
        words = tuple(name if word == FILE else word for word in readables()[what].words)
    return Attempt(words, f"{kind} as {what}")


def _made(kind: str, folder: Path, suffix: str) -> str:
    path = folder / f"it{suffix}"
    return FILES[kind](path) or path.name


def _folder(path: Path) -> None:
    path.mkdir()


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        folder = Path.cwd()
        os.chdir(path.parent)  # its address is short
        server.bind(path.name)
        os.chdir(folder)


def _unreadable(path: Path) -> None:
    path.write_text("a = 1")
    path.chmod(0)  # as root it can be read all the same, and is no such file


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(SPARSE_BYTES)


FILES: dict[str, Callable[[Path], str | None]] = {
    "absent": lambda path: None,
    "empty": lambda path: path.touch(),
    "a folder": _folder,
    "a pipe": _pipe,
    "a socket": _socket,
    "a loop": lambda path: path.symlink_to(path.name),
    "unreadable": _unreadable,
    "sparse": _sparse,
    "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "/dev/urandom": lambda path: path.symlink_to("/dev/urandom"),
    "/dev/tty": lambda path: path.symlink_to("/dev/tty"),
    "itself": lambda path: path.symlink_to("/proc/self/mem"),
    "a long name": lambda path: "x" * 5000 + path.suffix,
    "a name of no letters": lambda path: "\n\x1b[31m" + path.suffix,
}
