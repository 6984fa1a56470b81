"""Run the robustness tests and count failures.

Every try is drawn from the seed, its kind and its number alone, so that ``--first`` repeats one of them.

    python -m benchmarks.robustness --tries 200 --seed 0
    python -m benchmarks.robustness --kind step --tries 1 --first 17 --seed 0

Duration: minutes.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.robustness.attempt import failures, prepare, run_attempt
from benchmarks.robustness.kinds import KINDS
from benchmarks.robustness.multi_step import LOST_ROWS, TRIALS, Trial
from benchmarks.robustness.samples import remove

WRONG = ("signal", "hang", "traceback", "defect", "exit code", "stray lines", "JSON", LOST_ROWS)
COLUMNS = ("tries", "answered", "refused", *WRONG, "slowest, s")


def try_once(kind: str, number: int, seed: int) -> Trial:
    """Run one trial of a kind in a folder of its own."""
    folder, draw = Path(tempfile.mkdtemp(prefix="robustness-")), random.Random(f"{seed} {kind} {number}")
    try:
        if kind in TRIALS:
            return TRIALS[kind](draw, folder)
        attempt = KINDS[kind](draw, folder)
        ended = run_attempt(attempt, folder)
        words = " ".join(word[:80] for word in attempt.words)
        return Trial(f"{attempt.said}: {words!r}", ended, tuple(failures(attempt, ended)))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run_trials(kind: str, numbers: range, seed: int) -> Counter[str]:
    """Run the trials of one kind, print each failure, and count the outcomes."""
    counts: Counter[str] = Counter()
    for number in numbers:
        trial = try_once(kind, number, seed)
        ended, outcome = trial.ended, {0: ["answered"], 2: ["refused"]}
        counts.update(["tries", *trial.wrong, *outcome.get(-1 if ended.code is None else ended.code, [])])
        counts["slowest, s"] = max(counts["slowest, s"], round(ended.seconds))
        if trial.wrong:
            said = " | ".join(ended.errors.splitlines()[-3:])
            print(f"{kind} {number}: {', '.join(trial.wrong)}: {trial.said}: {said[:300]!r}", file=sys.stderr, flush=True)
    return counts


def main() -> int:
    """Print the table; 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--kind", action="append", choices=sorted(KINDS | TRIALS), help="one kind; again for more  [default: all]"
    )
    parser.add_argument("--tries", type=int, default=100, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.environ["PROBE_DESIGN_CACHE"] = tempfile.mkdtemp(prefix="robustness-cache-")
    prepare()
    start, total = time.perf_counter(), Counter[str]()
    print(f"seed {options.seed}, tries {options.first} to {options.first + options.tries - 1} of each kind\n")
    print(f"| kind | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 1)}", flush=True)
    for kind in options.kind or [*KINDS, *TRIALS]:
        counts = run_trials(kind, range(options.first, options.first + options.tries), options.seed)
        print(f"| {kind} | {' | '.join(str(counts[column]) for column in COLUMNS)} |", flush=True)
        total.update(counts)
    shutil.rmtree(os.environ["PROBE_DESIGN_CACHE"], ignore_errors=True)
    remove()
    print(f"\n{time.perf_counter() - start:.0f} s", file=sys.stderr)
    return int(any(total[column] for column in WRONG))


if __name__ == "__main__":
    sys.exit(main())
