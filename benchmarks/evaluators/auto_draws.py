"""Check that no scene ends the program or passes its limits: mutated scenes, each given to ``auto``.

Each line: number, what was changed, how it ended (result, refused, SIGNAL or code), seconds, peak memory, and the message.

    python -m benchmarks.evaluators.auto_draws --scenes 60 --seed 0

Duration: minutes.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geometry import Scene, read_scene, scene_to_toml
from geometry.common.resources import Limits

ROOT = Path(__file__).parents[2]
BASES = [*sorted((ROOT / "examples").glob("*scene.toml")), ROOT / "examples" / "two-tumours.toml",
         *sorted((ROOT / "tests" / "reference" / "solid").glob("*.toml"))]  # fmt: skip
LIMIT_SLACK_FACTOR, STARTUP_S = 1.05, 3.0  # of the limits, and s: what a process's own beginning and end take
MAX_SECONDS = 600.0  # s after which a program is ended


def draws(seed: int) -> Iterator[tuple[str, Scene]]:
    """Yield descriptions of changes, and scenes that the models allow, without end."""
    random = np.random.default_rng(seed)
    bases = [read_scene(path).model_dump(exclude_unset=True) for path in BASES]
    while True:
        scene, words = bases[random.integers(len(bases))], []
        for _ in range(random.integers(1, 5)):
            change = CHANGES[random.integers(len(CHANGES))]
            scene, word = change(scene, random)
            words.append(word)
        try:
            yield ", ".join(words), Scene.model_validate(scene)
        except ValueError:
            continue


def _number(scene: dict[str, Any], random: np.random.Generator) -> tuple[dict[str, Any], str]:
    """Multiply a number anywhere by up to a hundred, either way."""
    places = list(_numbers(scene, ()))
    place = places[random.integers(len(places))]
    times = float(np.exp(random.normal(0.0, 1.5)))
    return _put(scene, place, lambda value: value * times), f"{'.'.join(map(str, place))} x {times:.2g}"


def _ellipsoid(scene: dict[str, Any], random: np.random.Generator) -> tuple[dict[str, Any], str]:
    """Add a flat or needle-like body, shallow as often as not."""
    axes = np.exp(random.uniform(math.log(3e-4), math.log(2e-2), 3))
    body = {
        "diameters": tuple(axes.tolist()),
        "orientation": tuple(random.choice([0.0, 30.0, 90.0], 3).tolist()),
        "depth": float(axes.max() * random.uniform(0.3, 3)),
        "x": float(random.uniform(-15e-3, 15e-3) * random.integers(2)),
        "y": float(random.uniform(-15e-3, 15e-3) * random.integers(2)),
        "youngs_modulus": float(np.exp(random.uniform(math.log(1e2), math.log(1e7)))),
        "poisson_ratio": 0.45,
        "target": not any(item.get("target") for item in scene.get("inclusion", ())),
    }
    said = "x".join(f"{1e3 * item:.2g}" for item in axes)
    kept = scene.get("inclusion", ()) if random.random() < 0.7 else ()
    return scene | {"inclusion": (*kept, body)}, f"ellipsoid {said} mm"


def _film(scene: dict[str, Any], random: np.random.Generator) -> tuple[dict[str, Any], str]:
    film = {"thickness": float(random.uniform(5e-6, 2e-4)), "youngs_modulus": float(10 ** random.uniform(5, 9.5))}
    return scene | {"probe": scene["probe"] | {"film": film}}, "film"


def _groove(scene: dict[str, Any], random: np.random.Generator) -> tuple[dict[str, Any], str]:
    groove = {"width": float(random.uniform(2e-4, 5e-3)), "depth": float(random.uniform(1e-4, 3e-3))}
    return scene | {"probe": scene["probe"] | {"groove": groove}}, "groove"


def _place(scene: dict[str, Any], random: np.random.Generator) -> tuple[dict[str, Any], str]:
    position = {"x": float(random.uniform(-0.04, 0.04)), "y": float(random.uniform(-0.02, 0.02) * random.integers(2))}
    return scene | {"placement": position | {"tilt": float(random.uniform(-0.15, 0.15) * random.integers(2))}}, "place"


CHANGES = (_number, _number, _ellipsoid, _film, _groove, _place)


def _numbers(value: Any, place: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, (*place, key))
    elif isinstance(value, tuple | list):
        for key, item in enumerate(value):
            yield from _numbers(item, (*place, key))
    elif isinstance(value, float) and not isinstance(value, bool):
        yield place


def _put(value: Any, place: tuple[Any, ...], change: Any) -> Any:
    if not place:
        return change(value)
    key = place[0]
    if isinstance(value, dict):
        return {**value, key: _put(value[key], place[1:], change)}
    return tuple(_put(item, place[1:], change) if k == key else item for k, item in enumerate(value))


def run_program(scene: Scene, folder: Path, seconds: float) -> tuple[str, float, float, str]:
    """How the program ended, its seconds and peak bytes, its meshers' included, and its last line; ``seconds`` are allowed."""
    path, said = folder / "scene.toml", folder / "said"
    path.write_text(scene_to_toml(scene), encoding="utf-8")
    start = time.perf_counter()
    with said.open("wb") as errors:
        command = [sys.executable, "-m", "probe_design", "evaluate", str(path), "--json", "--time", f"{seconds:g} s"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, cwd=ROOT)
        pid = ended = 0
        while not pid:
            pid, ended, usage = os.wait4(process.pid, os.WNOHANG)
            if time.perf_counter() - start > MAX_SECONDS:
                process.kill()
            time.sleep(0.05)
    process.returncode = code = os.waitstatus_to_exitcode(ended)
    how = {0: "answered", 2: "refused"}.get(code, f"SIGNAL {-code}" if code < 0 else f"CODE {code}")
    lines = said.read_text(errors="replace").strip().splitlines()
    return how, time.perf_counter() - start, 1024.0 * usage.ru_maxrss, lines[-1] if lines else ""


def main() -> None:
    """Draw, ask, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="the number of the first that is asked")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time", type=float, default=Limits().seconds, help="s that each result may take")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for number, (words, scene) in zip(range(options.first + options.scenes), draws(options.seed), strict=False):
        if number < options.first:
            continue
        with tempfile.TemporaryDirectory() as folder:
            how, seconds, memory, said = run_program(scene, Path(folder), options.time)
        past = seconds > LIMIT_SLACK_FACTOR * options.time + STARTUP_S or memory > LIMIT_SLACK_FACTOR * Limits().memory
        counts.update([how.split()[0], *(["past the limits"] if past else [])])
        print(
            f"{number:3} {words}: {how} {seconds:.0f} s {memory / 1e9:.2f} GB{' PAST' if past else ''} {said[:160]}", flush=True
        )
    print(dict(counts))


if __name__ == "__main__":
    main()
