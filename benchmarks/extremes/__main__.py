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
from tests.support.extremes.judge import Answer, answer, judged
from tests.support.extremes.rows import Row, rows


def read_answers(path: Path) -> dict[tuple[str, str], Answer]:
    """Return the results that a file of JSON lines holds, by row and evaluator."""
    if not path.exists():
        return {}
    replies = [Answer(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(reply.row, reply.evaluator): reply for reply in replies}


def run(path: Path, wanted: list[tuple[Row, str]]) -> None:
    """Append each result to the file as soon as it is known."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for k, (row, level) in enumerate(wanted, 1):
        reply = answer(row, level)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(reply)) + "\n")
        cell = judged(row, reply)
        print(f"{k}/{len(wanted)} {row.key} {level}: {cell.mark} {cell.why}, {cell.seconds:.2g} s", file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of answers.jsonl")
    parser.add_argument("--document", type=Path, help="write the document to this file")
    parser.add_argument("--only", default="", help="run the cells whose name contains this")
    options = parser.parse_args()
    path, cases = options.output / "answers.jsonl", rows()
    wanted, done = list(cells(cases)), read_answers(path)
    run(path, [(row, level) for row, level in wanted if options.only in f"{row.key} {level}" and (row.key, level) not in done])
    done = read_answers(path)
    judged_cells = [judged(row, done[row.key, level]) for row, level in wanted if (row.key, level) in done]
    if options.document is not None:
        options.document.write_text(document(cases, judged_cells), encoding="utf-8")
    for cell in judged_cells:
        if cell.mark == "wrong":
            print(f"wrong: {cell.row} by {cell.evaluator}: {cell.why}")
    print(f"{len(judged_cells)} of {len(wanted)} cells, {sum(cell.mark == 'wrong' for cell in judged_cells)} wrong")


if __name__ == "__main__":
    main()
