"""Every kind of file that the program reads, by its name."""

from __future__ import annotations

import tomllib
from functools import cache
from typing import Any

from benchmarks.robustness.files import FILE, LIMITS, ROOT, SCENE, VIRTUAL, Readable, example
from benchmarks.robustness.samples import recordings
from benchmarks.robustness.written_files import answers

SWEEP = {
    "scene": SCENE, "evaluator": "closed-form", "accuracy": 0.1, "time_limit": "9 s",
    "sample": {"kind": "sobol", "n": 4, "seed": 1}, "constraints": ["probe.gap < 0.1 * probe.inner_radius"],
    "variables": {
        "probe.gap": {"from": "0.1 mm", "to": "0.3 mm", "scale": "log"}, "inclusion.depth": {"from": "8 mm", "to": "9 mm"},
    },
}  # fmt: skip
READINGS = {"reading": [{"x": "-10 mm", "ratio": 0.6, "noise": 0.05}, {"ratio": 0.62, "stiffness": "80 N/m"}]}
CSV = b"x, y, ratio, noise, stiffness, stiffness_noise\n-8 mm, 0 mm, 0.55, 0.05, 79 N/m, 0.02\n0 mm, 0 mm, 0.62, 0.05, 81, 0.02\n"
DESIGN = {
    "scene": SCENE, "population": {"depth": ["8 mm", "12 mm"], "diameter": ["6 mm", "8 mm"], "samples": 2, "seed": 1},
    "protocol": {"positions": ["0 mm"], "blank": True, "false_alarm": 0.05}, "noise": {"white": 0.01, "charge": "0.01 pC"},
    "limits": {"force": "0.01 N", "wall": "0.5 mm"}, "objective": {"maximise": "detection", "statistic": "mean"},
    "variables": {
        "inner_radius": "fixed", "area_ratio": [0.5, 2.0], "gap": {"choices": ["0.1 mm", "0.2 mm"]}, "height": "fixed",
        "inner_modulus": "fixed", "outer_modulus": "fixed",
    },
}  # fmt: skip
SEARCH_SECONDS = 300.0  # s: of a small search from its start to its report, on a machine that is busy
LAYERS = example("skin.toml")
PRESSED = SCENE | {"contact": {"interface": "unilateral", "friction": 0.3, "edge_radius": "0.05 mm"}, "load": {"force": "40 mN"}}
TWO_TUMOURS = example("two-tumours.toml") | {"noise": {"white": 0.01, "gain": 0.05, "charge": "0.01 pC", "tilt": 0.001}}


SCENES = (SCENE, SCENE, TWO_TUMOURS, LAYERS, PRESSED)


@cache
def readables() -> dict[str, Readable]:
    """Return every kind; right ones that the program itself writes are had from it."""
    return _tables() | recordings() | answers()


def _tables() -> dict[str, Readable]:
    scene = (str(ROOT / "examples" / "scene.toml"),)
    bench = tomllib.loads((ROOT / "probe_design" / "data" / "bench.toml").read_text(encoding="utf-8"))
    return {
        "scene": Readable(".toml", ("evaluate", FILE, *LIMITS, "--json"), example("two-tumours.toml")),
        "sweep": Readable(".toml", ("sweep", FILE, "-o", "out", "--workers", "1", "--json"), SWEEP),
        "design": Readable(".toml", ("export", FILE, "-o", "out", "--json"), SCENE),
        "bench": Readable(".toml", ("read", *scene, *VIRTUAL, "--bench", FILE, "--json"), bench),
        "readings": Readable(".toml", ("estimate", *scene, "--readings", FILE, *LIMITS, "--json"), READINGS),
        "readings as CSV": Readable(".csv", ("estimate", *scene, "--readings", FILE, *LIMITS, "--json"), CSV),
        "calibration": Readable(".toml", ("read", *scene, *VIRTUAL, "--calibration", FILE, "--json"), _calibration(bench)),
        "design file": Readable(".toml", ("optimize", FILE, "-o", "out", *LIMITS, "--json"), DESIGN, SEARCH_SECONDS),
        "bench of doctor": Readable(".toml", ("doctor", *scene, *VIRTUAL, "--bench", FILE, "--json"), bench),
        "bench of tolerances": Readable(".toml", ("tolerances", *scene, "--samples", "64", "--bench", FILE, "--json"), bench),
        "bench of calibrate": Readable(
            ".toml", ("calibrate", *scene, *VIRTUAL, "--bench", FILE, "-o", "c.toml", "--json"), bench
        ),
        "bench of check": Readable(".toml", ("check", *scene, *VIRTUAL, "--bench", FILE, "--json"), bench),
    }


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
