"""Find the cheapest NGSolve and CalculiX settings for the scenes of ``solid.py`` by trying many with the true values known.

``python -m benchmarks.peers.solid_settings --log FILE`` tries them again and writes ``solid_settings.json``; it takes about 20
minutes on a quiet core and resumes from the log. A setting counts for an accuracy if its ratio is that exact, and stays so
with all sizes multiplied by 0.8: fewer lucky hits. Cost is processor time, the least of several runs in turns. CalculiX has
the elements of NGSolve's order 2 without layers, so its candidates are those that NGSolve found exact enough; it refuses
some of netgen's curved tetrahedra as inverted, such settings do not count for it. Stored settings of the last scene, and
those marked "all", with which both stresses are as exact as that too, were picked by hand from such trials.
A user without the true values has to solve on a second mesh to know the error, and does not find the cheapest.

Duration: twenty minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.peers import calculix_solid as peer_calculix_solid
from benchmarks.peers import ngsolve_solid as peer_ngsolve_solid
from benchmarks.peers.measured_solid import ACCURACIES, SCENES, SolidAnswer, read_expected, scene_file
from benchmarks.peers.solid_mesh import SolidSetting, tetrahedra
from geometry import Scene, read_scene

FILE = Path(__file__).with_suffix(".json")
FINER_FACTOR = 0.8
DRAW_COUNT, SEED = 110, 2
ROUNDS, FINALISTS, CANDIDATES = 2, 3, 30
MAX_TETRAHEDRA = {
    0: 9000,
    1: 4500,
    2: 3200,
    3: 1500,
    4: 1000,
}  # tetrahedra at order - 2 + layers: what is above cannot be the cheapest
SOLVERS = {"ngsolve": {2: ("sparsecholesky",), 3: ("sparsecholesky",)}, "calculix": {2: ("SPOOLES",)}}
Evaluate = Callable[[Scene, SolidSetting], SolidAnswer]
EVALUATE: dict[str, Evaluate] = {"ngsolve": peer_ngsolve_solid.evaluate, "calculix": peer_calculix_solid.evaluate}


def finer(setting: SolidSetting, factor: float) -> SolidSetting:
    """Multiply all sizes."""
    lengths = {name: round(getattr(setting, name) * factor, 4) for name in ("rim", "block", "tumour", "end", "far")}
    return replace(setting, **lengths)


def draws() -> Iterator[SolidSetting]:
    """Draw settings, seeded."""
    random = np.random.default_rng(SEED)
    while True:
        order = int(random.choice(ORDERS))
        layers, factor = LAYERS[random.integers(len(LAYERS))]
        min_size = MIN_RIM_SIZES[min(order - 2 + layers, 2)]
        rim = round(float(np.exp(random.uniform(np.log(min_size), np.log(1.3)))), 3)
        pick: dict[str, Any] = {name: float(random.choice(values)) for name, values in CHOICES.items()}
        yield SolidSetting(order, rim, **pick, layers=layers, factor=factor, solver="sparsecholesky")


ORDERS = (2, 2, 2, 2, 3)  # a first round of 22 settings showed order 3 and ``fill=False`` to be dearer at these accuracies
LAYERS = ((0, 0.125), (0, 0.125), (1, 0.125), (1, 0.25), (2, 0.25))
MIN_RIM_SIZES = (0.15, 0.4, 0.6)  # sizes at the rims: plain order 2, one more in order or layers, two more
CHOICES = {
    "block": (1.2, 2.0, 3.0),
    "tumour": (1.5, 2.5, 4.0),
    "end": (0.7, 1.2, 2.0),
    "far": (12.0, 25.0),
    "grading": (0.3, 0.4, 0.5, 0.6),
}


class Trials:
    """Runs settings once, and remembers them in a file."""

    def __init__(self, log: Path) -> None:
        self.log, self.done = log, dict[str, dict[str, Any]]()
        if log.exists():
            for line in log.read_text(encoding="utf-8").splitlines():
                record = json.loads(line)
                self.done[record["key"]] = record
        self.scenes = {name: read_scene(scene_file(name)) for name in SCENES}
        self.true = {name: read_expected(name)["ratio"] for name in SCENES}

    def __call__(self, peer: str, name: str, setting: SolidSetting) -> dict[str, Any]:
        """Return error and seconds; an infinite error where there is no mesh."""
        key = json.dumps([peer, name, asdict(setting)])
        if key not in self.done:
            record: dict[str, Any] = {"key": key, "error": float("inf"), "seconds": float("inf")}
            try:
                solved = EVALUATE[peer](self.scenes[name], setting)
                record |= {"error": abs(solved.ratio / self.true[name] - 1), "seconds": sum(solved.process.values())}
                record |= {"unknowns": solved.unknowns, "elements": solved.elements, "stages": solved.process}
            except Exception as fault:  # netgen's are of many kinds
                record["why"] = repr(fault)[:100]
            self._keep(record)
        return self.done[key]

    def has_few_elements(self, name: str, setting: SolidSetting) -> bool:
        """Whether a setting's mesh is small enough to be worth a solve."""
        key = json.dumps(["mesh", name, asdict(setting)])
        if key not in self.done:
            try:
                count = len(tetrahedra(self.scenes[name], setting).Elements3D())
            except Exception:  # netgen's are of many kinds
                count = 10**9
            self._keep({"key": key, "count": count})
        return bool(self.done[key]["count"] <= MAX_TETRAHEDRA[setting.order - 2 + setting.layers])

    def _keep(self, record: dict[str, Any]) -> None:
        self.done[record["key"]] = record
        with self.log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")

    def is_sound(self, peer: str, name: str, setting: SolidSetting, accuracy: float) -> bool:
        """Whether a setting and the finer ones are exact enough."""
        return all(self(peer, name, tested)["error"] <= accuracy for tested in (setting, finer(setting, FINER_FACTOR)))

    def time_again(self, peer: str, name: str, settings: list[SolidSetting]) -> list[float]:
        """Return the least seconds of several runs, in turns."""
        turns = [
            [sum(EVALUATE[peer](self.scenes[name], setting).process.values()) for setting in settings] for _ in range(ROUNDS)
        ]
        return [min(seconds) for seconds in zip(*turns, strict=True)]


def search(trials: Trials, peer: str, name: str, tried: list[SolidSetting], accuracy: float) -> SolidSetting:
    """Return the cheapest sound setting."""
    good = sorted(
        (setting for setting in tried if trials(peer, name, setting)["error"] <= accuracy),
        key=lambda s: trials(peer, name, s)["seconds"],
    )
    sound: list[SolidSetting] = []
    for setting in good[:CANDIDATES]:
        if trials.is_sound(peer, name, setting, accuracy):
            sound.append(setting)
        if len(sound) == FINALISTS:
            break
    if not sound:
        raise SystemExit(f"{peer}, {name}, {accuracy:g}: no setting of {len(tried)} is sound, {len(good)} good")
    rivals = [replace(setting, solver=solver) for setting in sound for solver in SOLVERS[peer][setting.order]]
    seconds = trials.time_again(peer, name, rivals)
    best = rivals[int(np.argmin(seconds))]
    print(f"{peer}, {name}, {accuracy:g}: {len(good)} good, {len(sound)} sound; {best}, {min(seconds):.2f} s", flush=True)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, required=True, help="file of all trials, read again if it exists")
    parser.add_argument("--scene", action="append", choices=SCENES, help="only this scene; the others' settings stay")
    chosen = parser.parse_args()
    ngs.SetNumThreads(1)
    trials = Trials(chosen.log)
    generator = draws()
    tried = [setting for setting in (next(generator) for _ in range(DRAW_COUNT)) if trials.has_few_elements(SCENES[0], setting)]
    document: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {peer: {} for peer in EVALUATE}
    for name in chosen.scene or SCENES:
        first = [setting for setting in tried if name == SCENES[0] or is_promising(trials, setting)]
        for accuracy in ACCURACIES:
            best = search(trials, "ngsolve", name, first, accuracy)
            document["ngsolve"].setdefault(name, {})[f"{accuracy:g}"] = asdict(best)
            plain = [
                setting
                for setting in first
                if setting.order == 2 and not setting.layers and trials("ngsolve", name, setting)["error"] <= 1.1 * accuracy
            ]
            plain = sorted(plain, key=lambda s: trials("ngsolve", name, s)["elements"])
            plain = [setting for setting in plain if trials.is_sound("ngsolve", name, setting, 1.1 * accuracy)][:8]
            best = search(trials, "calculix", name, [replace(setting, solver="SPOOLES") for setting in plain], accuracy)
            document["calculix"].setdefault(name, {})[f"{accuracy:g}"] = asdict(best)
            FILE.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def is_promising(trials: Trials, setting: SolidSetting) -> bool:
    """Whether a setting is worth trying in the other scenes: near both accuracies at least in the first."""
    return bool(trials("ngsolve", SCENES[0], setting)["error"] <= 1.2 * max(ACCURACIES))


if __name__ == "__main__":
    main()
