"""Right files of every kind that the program reads, as tables or bytes, and the words that have it read one."""

from __future__ import annotations

import tempfile
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.attacks.attempt import USUAL
from hw.reader import Reader
from tests.support.hw.virtual_probes import probe

ROOT = Path(__file__).parents[2]
FILE = "FILE"  # stands for the file's name in words
LIMITS = ("--time", f"{USUAL:g} s")


@dataclass(frozen=True)
class Readable:
    """A kind of file.

    Attributes:
        suffix: of its name.
        words: that have the program read it, ``FILE`` for its name.
        right: a right one: tables, or bytes.
    """

    suffix: str
    words: tuple[str, ...]
    right: Any

    @property
    def content(self) -> bytes:
        """The right one's bytes."""
        return self.right if isinstance(self.right, bytes) else tomli_w.dumps(self.right).encode()


def _example(name: str) -> dict[str, Any]:
    return tomllib.loads((ROOT / "examples" / name).read_text(encoding="utf-8"))


SCENE = _example("scene.toml")
VIRTUAL = ("--virtual", "--seconds", "4")
SWEEP = {
    "scene": SCENE, "evaluator": "closed-form", "accuracy": 0.1, "time_limit": "9 s",
    "sample": {"kind": "sobol", "n": 4, "seed": 1}, "constraints": ["probe.gap < 0.1 * probe.inner_radius"],
    "variables": {
        "probe.gap": {"from": "0.1 mm", "to": "0.3 mm", "scale": "log"}, "inclusion.depth": {"from": "8 mm", "to": "9 mm"},
    },
}  # fmt: skip
READINGS = {"reading": [{"x": "-10 mm", "ratio": 0.6, "noise": 0.05}, {"ratio": 0.62, "stiffness": "80 N/m"}]}
CSV = b"x, y, ratio, noise, stiffness, stiffness_noise\n-8 mm, 0 mm, 0.55, 0.05, 79 N/m, 0.02\n0 mm, 0 mm, 0.62, 0.05, 81, 0.02\n"


def scene_with(folder: Path, body: dict[str, Any], name: str = "scene.toml", **more: Any) -> str:
    """Write the example's scene with another inclusion, of the same depth and material, and return its name."""
    own = {key: value for key, value in SCENE["inclusion"][0].items() if key != "diameter"}
    (folder / name).write_text(tomli_w.dumps(SCENE | {"inclusion": [own | body]} | more), encoding="utf-8")
    return name


@cache
def readables() -> dict[str, Readable]:
    """Every kind by its name."""
    scene = tuple(str(ROOT / "examples" / name) for name in ("scene.toml",))
    bench = tomllib.loads((ROOT / "probe_design" / "data" / "bench.toml").read_text(encoding="utf-8"))
    return {
        "scene": Readable(".toml", ("evaluate", FILE, *LIMITS, "--json"), _example("two-tumours.toml")),
        "sweep": Readable(".toml", ("sweep", FILE, "-o", "out", "--workers", "1", "--json"), SWEEP),
        "design": Readable(".toml", ("export", FILE, "-o", "out", "--json"), SCENE),
        "bench": Readable(".toml", ("read", *scene, *VIRTUAL, "--bench", FILE, "--json"), bench),
        "readings": Readable(".toml", ("estimate", *scene, "--readings", FILE, *LIMITS, "--json"), READINGS),
        "readings as CSV": Readable(".csv", ("estimate", *scene, "--readings", FILE, *LIMITS, "--json"), CSV),
        "recording": Readable(".probe", ("read", *scene, "--replay", FILE, "--json"), _recording()),
        "calibration": Readable(".toml", ("read", *scene, *VIRTUAL, "--calibration", FILE, "--json"), _calibration(bench)),
    }


def _recording() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.probe")
        with Reader.open(probe()) as reader:
            reader.collect(0.02, record=path)
        return path.read_bytes()


def _calibration(bench: dict[str, Any]) -> dict[str, Any]:
    return {
        "format": "probe-design calibration", "version": 1, "software": "probe-design", "date": "2024-01-01T00:00:00+00:00",
        "device": "virtual", "frequency": 5.0, "absolute": True, "entries": ["a", "b", "c", "d"],
        "matrix": [[1.0, 0.01], [0.02, 0.9]], "covariance": [[1e-4 * (i == j) for j in range(4)] for i in range(4)],
        "cross_talk_resolved": [True, False], "offsets": [0.0, 0.1], "offsets_sd": [1e-3, 1e-3], "chi_square": 3.0,
        "degrees_of_freedom": 4, "variables": ["probe.gap"], "slopes": [[0.1], [0.0], [0.0], [0.2]], "workshop": [2e-5],
        "warnings": ["none"], "scene": SCENE, "bench": bench,
        "reading": [{"on": "pin", "films": [0.1, 0.2], "films_sd": [1e-3, 1e-3], "force": 0.1, "sha256": "ab" * 32, "file": "r"}],
    }  # fmt: skip
