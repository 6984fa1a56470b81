"""Print how far each evaluator's charges are from those of independent codes, and what errors it states.

    python -m benchmarks.films.evaluators [--evaluator axisymmetric|equivalent-inclusion|contact|closed-form|solid]

The references are the probes on tissue of ``tests/reference/film``, of an uncertainty of 1e-4 to 4e-4 themselves. ``solid``
takes every seventh of them, at an accuracy of 0.02; the others take all, at 0.01. The load of 10 uN is so light that ``contact``,
too, gives the linear limit.

Duration: three minutes.
"""

from __future__ import annotations

import argparse
import statistics

from geometry.common.errors import ProbeError
from solver import evaluate
from tests.support.film_scenes import build_scene, list_tissue_cases, read_cases

SETTINGS = {
    "axisymmetric": (0.01, 1),
    "equivalent-inclusion": (0.01, 1),
    "contact": (0.01, 1),
    "closed-form": (0.01, 1),
    "solid": (0.02, 7),
}
"""By evaluator: the accuracy, and of how many references it takes one."""
LIGHT_LOAD_N = 1e-5


def main() -> None:
    """Print a line for each evaluator."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluator", choices=SETTINGS)
    chosen = parser.parse_args().evaluator
    print("| evaluator | charges | off: median | off: at most | stated: median | above stated |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, (accuracy, step) in SETTINGS.items():
        if chosen not in (None, name):
            continue
        deviations, stated = [], []
        for case in list_tissue_cases()[::step]:
            scene = build_scene(case).replace({"reading.observable": "charge", "load.force": LIGHT_LOAD_N})
            try:
                result = evaluate(scene, evaluator=name, accuracy=accuracy)
            except ProbeError as refusal:
                print(f"{name}, {case}: refused: {refusal}")
                continue
            uncertainty = read_cases()[case]["relative_uncertainty"]
            for block, expected in zip(("inner", "outer"), read_cases()[case]["charge_per_force"], strict=True):
                value, error = (getattr(result, f"charge_per_force_{block}{end}") for end in ("", "_error"))
                deviations.append(abs(value / (1e-12 * expected) - 1))
                stated.append(error + uncertainty)
        above = sum(deviation > error for deviation, error in zip(deviations, stated, strict=True))
        sizes = (statistics.median(deviations), max(deviations), statistics.median(stated))
        print(f"| `{name}` | {len(deviations)} | {' | '.join(f'{100 * size:.2g} %' for size in sizes)} | {above} |", flush=True)


if __name__ == "__main__":
    main()
