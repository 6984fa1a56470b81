"""The matrix of extremes: scenes at the limits by every evaluator, each answer right, refused, null or wrong.

``python -m benchmarks.extremes -o FOLDER --document docs/evidence/extremes.md`` runs what FOLDER does not hold yet and writes the
document; ``--only TEXT`` runs those cells whose name ("group/scene evaluator") contains a text.
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


def kept(path: Path) -> dict[tuple[str, str], Answer]:
    """Return the answers that a file of JSON lines holds, by row and evaluator."""
    if not path.exists():
        return {}
    every = [Answer(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(one.row, one.evaluator): one for one in every}


def run(path: Path, wanted: list[tuple[Row, str]]) -> None:
    """Append each answer to the file as soon as it is known."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for k, (row, level) in enumerate(wanted, 1):
        told = answer(row, level)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(told)) + "\n")
        one = judged(row, told)
        print(f"{k}/{len(wanted)} {row.key} {level}: {one.mark} {one.why}, {one.seconds:.2g} s", file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of answers.jsonl")
    parser.add_argument("--document", type=Path, help="write the document to this file")
    parser.add_argument("--only", default="", help="run the cells whose name contains this")
    options = parser.parse_args()
    path, found = options.output / "answers.jsonl", rows()
    wanted, done = list(cells(found)), kept(path)
    run(path, [(row, level) for row, level in wanted if options.only in f"{row.key} {level}" and (row.key, level) not in done])
    done = kept(path)
    told = [judged(row, done[row.key, level]) for row, level in wanted if (row.key, level) in done]
    if options.document is not None:
        options.document.write_text(document(found, told), encoding="utf-8")
    for one in told:
        if one.mark == "wrong":
            print(f"wrong: {one.row} by {one.evaluator}: {one.why}")
    print(f"{len(told)} of {len(wanted)} cells, {sum(one.mark == 'wrong' for one in told)} wrong")


if __name__ == "__main__":
    main()
