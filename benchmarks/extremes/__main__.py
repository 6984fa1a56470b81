"""Run scenes at the limits of the range of designs by every evaluator, and classify each result: right, refused, null or wrong.

``python -m benchmarks.extremes -o FOLDER --document docs/evidence/extremes.md`` runs what FOLDER does not hold yet and writes the
document; ``--only TEXT`` runs those cells whose name ("group/scene evaluator") contains a text.

Duration: ten minutes.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from benchmarks.extremes.document import document
from tests.support.extremes.cells import cells
from tests.support.extremes.classification import Outcome, classify, evaluate_row
from tests.support.extremes.rows import Row, rows


def read_outcomes(path: Path) -> dict[tuple[str, str], Outcome]:
    """Return the results that a file of JSON lines holds, by row and evaluator."""
    if not path.exists():
        return {}
    outcomes = [Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(outcome.row, outcome.evaluator): outcome for outcome in outcomes}


def run(path: Path, wanted: list[tuple[Row, str]]) -> None:
    """Append each result to the file as soon as it is known."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for k, (row, evaluator) in enumerate(wanted, 1):
        outcome = evaluate_row(row, evaluator)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(outcome)) + "\n")
        cell = classify(row, outcome)
        print(
            f"{k}/{len(wanted)} {row.key} {evaluator}: {cell.mark} {cell.reason}, {cell.seconds:.2g} s",
            file=sys.stderr,
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of outcomes.jsonl")
    parser.add_argument("--document", type=Path, help="write the document to this file")
    parser.add_argument("--only", default="", help="run the cells whose name contains this")
    options = parser.parse_args()
    path, cases = options.output / "outcomes.jsonl", rows()
    wanted, done = list(cells(cases)), read_outcomes(path)
    run(
        path,
        [
            (row, evaluator)
            for row, evaluator in wanted
            if options.only in f"{row.key} {evaluator}" and (row.key, evaluator) not in done
        ],
    )
    done = read_outcomes(path)
    classified = [classify(row, done[row.key, evaluator]) for row, evaluator in wanted if (row.key, evaluator) in done]
    if options.document is not None:
        options.document.write_text(document(cases, classified), encoding="utf-8")
    for cell in classified:
        if cell.mark == "wrong":
            print(f"wrong: {cell.row} by {cell.evaluator}: {cell.reason}")
    print(f"{len(classified)} of {len(wanted)} cells, {sum(cell.mark == 'wrong' for cell in classified)} wrong")


if __name__ == "__main__":
    main()
