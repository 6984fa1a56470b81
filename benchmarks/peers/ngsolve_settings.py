"""Find the cheapest NGSolve settings for the scenes of ``axisymmetric.py`` by trying many with the true values known.

``python -m benchmarks.peers.ngsolve_settings`` tries them again and writes ``ngsolve_settings.json``; it takes about 45 minutes.
A user without the true values has to solve on a second mesh to know the error, and does not find the cheapest. Kinds:

- "0.005", "0.0001": one evaluation of one scene with this error at most; some owe it to errors that happen to cancel;
- under "all": one setting that meets it in every scene;
- "curve": a curve of one scene, its largest error 0.005.

Duration: 45 minutes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import product
from pathlib import Path
from time import process_time

import ngsolve as ngs

from benchmarks.peers.measured import KnownScene, RatioCurve, cases
from benchmarks.peers.ngsolve_curve import solve_by_looping, solve_by_reusing
from benchmarks.peers.ngsolve_meridian import ALL_SINGULAR, CONTACT, ENDS_TOO, MeridianSetting, evaluate

FILE = Path(__file__).with_suffix(".json")
ACCURACIES = COARSE, FINE = (0.005, 0.0001)
EXACT = MeridianSetting(order=7, size=0.8, grading=0.35, layers=7, singular=ALL_SINGULAR)  # what curves are compared with
SIZES, GRADINGS, SINGULAR = (0.7, 1.0, 1.4, 2.0, 3.0), (0.3, 0.5, 0.7, 0.9), (CONTACT, ENDS_TOO, ALL_SINGULAR)
ORDERS = {COARSE: (2, 3, 4), FINE: (3, 4, 5, 6)}
LAYERS = {
    COARSE: ((1, 0.125), (2, 0.25), (2, 0.125), (3, 0.25)),
    FINE: ((2, 0.125), (2, 0.06), (3, 0.125), (3, 0.06), (4, 0.125)),
}
SAMPLES = 5  # moduli that stand for a curve
FINALISTS, ROUNDS = 24, 9
Trial = Callable[[MeridianSetting], float]
"""Runs with a setting and returns the true error."""


def cheapest(scene: str, kind: str) -> MeridianSetting:
    """Return the cheapest setting found for a scene, or for "all"."""
    stored = json.loads(FILE.read_text(encoding="utf-8"))[scene][kind]
    return MeridianSetting(**stored | {"singular": tuple(stored["singular"])})


def settings(accuracy: float) -> list[MeridianSetting]:
    """Return all settings to be tried."""
    return [
        MeridianSetting(order, size, grading, *layers, corners, smoothing=1)
        for order, size, grading, layers, corners in product(ORDERS[accuracy], SIZES, GRADINGS, LAYERS[accuracy], SINGULAR)
    ]


def search(name: str, trials: Sequence[Trial], accuracy: float) -> MeridianSetting:
    """Try all settings once, then the cheapest good ones in turns, with more and less smoothing of the mesh."""
    tried = settings(accuracy)
    first = [cost(trials, setting, accuracy) for setting in tried]
    good = [pair for pair in sorted(zip(first, tried, strict=True), key=lambda pair: pair[0]) if pair[0] < math.inf]
    rivals = [replace(setting, smoothing=rounds) for _, setting in good[:FINALISTS] for rounds in (0, 1, 3)]
    turns = [[cost(trials, setting, accuracy) for setting in rivals] for _ in range(ROUNDS)]
    lowest = [min(costs) for costs in zip(*turns, strict=True)]
    best = rivals[lowest.index(min(lowest))]
    error = max(trial(best) for trial in trials)
    print(f"{name}: {len(good)} of {len(tried)} good; {best}, error {error:.1e}, {min(lowest) * 1e3:.1f} ms", flush=True)
    return best


def cost(trials: Sequence[Trial], setting: MeridianSetting, accuracy: float) -> float:
    """Return the seconds of all trials, inf if one misses: of the processor, to be free of the machine's other work."""
    start = process_time()
    good = all(trial(setting) <= accuracy for trial in trials)
    return process_time() - start if good else math.inf


def single(case: KnownScene, setting: MeridianSetting) -> float:
    return case.error(evaluate(case.scene, setting).ratio)


def compute_curve_error(case: KnownScene, true: RatioCurve, setting: MeridianSetting) -> float:
    return solve_by_looping(case.scene, setting, true.youngs_modulus).curve.largest_difference(true)[0]


def main() -> None:
    ngs.SetNumThreads(1)
    all_cases, chosen = cases(), dict[str, dict[str, MeridianSetting]]()
    for accuracy in ACCURACIES:
        kind = f"{accuracy:g}"
        chosen.setdefault("all", {})[kind] = search(f"all, {kind}", [partial(single, case) for case in all_cases], accuracy)
        for case in all_cases:
            chosen.setdefault(case.name, {})[kind] = search(f"{case.name}, {kind}", [partial(single, case)], accuracy)
    for case in all_cases:
        true = solve_by_reusing(case.scene, EXACT, case.moduli(SAMPLES)).curve
        chosen[case.name]["curve"] = search(f"{case.name}, curve", [partial(compute_curve_error, case, true)], COARSE)
    written = {name: {kind: asdict(setting) for kind, setting in kinds.items()} for name, kinds in chosen.items()}
    FILE.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
