"""Describe a file that the program reads: valid content, as tables or bytes, and the command that reads it."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.robustness.attempt import ANSWER_SECONDS, STARTUP_SECONDS

ROOT = Path(__file__).parents[2]
FILE = "FILE"  # stands for the file's name in words
LIMITS = ("--time", f"{ANSWER_SECONDS:g} s")


@dataclass(frozen=True)
class Readable:
    """A kind of file.

    Attributes
    ----------
    suffix
        Of its name.
    words
        That have the program read it, ``FILE`` for its name.
    right
        A right one: tables, or bytes.
    seconds
        After which it counts as a hang.
    """

    suffix: str
    words: tuple[str, ...]
    right: Any
    seconds: float = ANSWER_SECONDS + STARTUP_SECONDS

    @property
    def content(self) -> bytes:
        """The right one's bytes."""
        return self.right if isinstance(self.right, bytes) else self.dump(self.right)

    def dump(self, tables: Any) -> bytes:
        """Return other tables as such a file; integers of more digits than Python writes are left to the bytes."""
        try:
            text = json.dumps(tables, default=str) if self.suffix == ".json" else tomli_w.dumps(tables)
        except ValueError:
            return b"a = " + b"9" * 5000
        return text.encode("utf-8", "surrogatepass")


def example(name: str) -> dict[str, Any]:
    """Return the tables of an example."""
    return tomllib.loads((ROOT / "examples" / name).read_text(encoding="utf-8"))


SCENE = example("scene.toml")
VIRTUAL = ("--virtual", "--seconds", "4")


def write_scene(folder: Path, body: dict[str, Any], name: str = "scene.toml", **tables: Any) -> str:
    """Write the example's scene with another inclusion, of the same depth and material, and return its name."""
    inclusion = {key: value for key, value in SCENE["inclusion"][0].items() if key != "diameter"}
    (folder / name).write_text(tomli_w.dumps(SCENE | {"inclusion": [inclusion | body]} | tables), encoding="utf-8")
    return name
