"""Check that ``evaluate`` does what ``plan`` states, on random scenes of several kinds.

Usage: ``python -m benchmarks.plans.agreement --scenes 12 --seed 0``, so many of each kind; ``--solid 0`` leaves out what only
``solid`` evaluates beyond so many scenes of each kind (some 20 to 60 s each). Printed are the scenes on which both differ.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from itertools import islice

from rich.console import Console

from benchmarks.plans.draws import KINDS, scenes
from benchmarks.tables import MeasuredTable
from geometry import Refusal, Scene
from geometry.common.resources import LimitReached
from solver import evaluate, plan

OUTCOMES = ("answered as planned", "both refuse", "solid, not asked", "stopped by limits", "planned, then refused", "another")


def outcome(scene: Scene, accuracy: float, solid: bool) -> tuple[str, str]:
    """Ask both; return one of ``OUTCOMES`` and what was said.

    Parameters
    ----------
    scene
        Any.
    accuracy
        Of both.
    solid
        Whether ``solid`` is to run where it is named.
    """
    try:
        planned = plan(scene, accuracy)
        if planned.evaluator == "solid" and not solid:
            return OUTCOMES[2], ""
        result = evaluate(scene, accuracy=accuracy)
    except LimitReached as fault:
        return OUTCOMES[3], str(fault)
    except Refusal as fault:
        if planned.refusal is None:
            return OUTCOMES[4], f"{planned.evaluator}: {fault}"
        return OUTCOMES[1 if str(planned.refusal) == str(fault) else 5], str(fault)
    is_same = result.evaluator == planned.evaluator
    return OUTCOMES[0 if is_same else 5], f"{planned.evaluator}, {result.evaluator} {result.error_estimate}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=12, help="of each kind (12)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--solid", type=int, default=2, help="scenes of each kind that solid answers (2)")
    parser.add_argument("--accuracy", type=float, default=0.01)
    parser.add_argument("--kind", action="append", choices=tuple(KINDS), help="only this one")
    given = parser.parse_args()
    table = MeasuredTable(f"plan and evaluate, seed {given.seed}, accuracy {given.accuracy:g}", ("kind", *OUTCOMES))
    for kind in given.kind or KINDS:
        counts, solids = Counter[str](), 0
        for number, scene in enumerate(islice(scenes(kind, given.seed), given.scenes)):
            result_kind, said = outcome(scene, given.accuracy, solids < given.solid)
            solids += said.startswith("solid")
            counts[result_kind] += 1
            print(kind, number, result_kind, said, file=sys.stderr, flush=True)
        table.add(kind, *(counts[outcome_name] for outcome_name in OUTCOMES))
    table.print(Console(width=160))


if __name__ == "__main__":
    main()
