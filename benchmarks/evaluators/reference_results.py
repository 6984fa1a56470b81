"""Print the result of every evaluator for every reference scene to the last digit, to show that a change only moves code.

Usage: ``python -m benchmarks.evaluators.reference_results [EVALUATOR ...] [--folder NAME]``: a line for each scene and
evaluator, and at the end the SHA-256 of all lines. Run it before and after the change, and compare. The evaluators' seconds are
left out; ``solid``, whose meshes take minutes where they are not cached, runs where it is named.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

from geometry import ProbeError, read_scene
from solver import evaluate, plan

REFERENCE = next(parent / "tests" / "reference" for parent in Path(__file__).resolve().parents if (parent / "tests").is_dir())
EVALUATORS = ("published", "closed-form", "equivalent-inclusion", "axisymmetric", "plan")


def describe_result(path: Path, evaluator: str) -> str:
    """Return the evaluator's result as JSON in which every float stands in full, or its refusal."""
    try:
        if evaluator == "plan":
            return repr(plan(read_scene(path)))
        fields = evaluate(read_scene(path), evaluator).as_dict()
    except ProbeError as refusal:
        return f"{type(refusal).__name__}: {refusal}"
    del fields["seconds"]
    return json.dumps(fields)


def main() -> None:
    """Print all results and their digest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evaluators", nargs="*", default=EVALUATORS)
    parser.add_argument("--folder", default="*", help="of tests/reference")
    options = parser.parse_args()
    digest = hashlib.sha256()
    for path in sorted(REFERENCE.glob(f"{options.folder}/*.toml")):
        for evaluator in options.evaluators:
            line = f"{path.parent.name}/{path.stem} {evaluator}: {describe_result(path, evaluator)}"
            digest.update(f"{line}\n".encode())
            print(line, flush=True)
    print(digest.hexdigest())


if __name__ == "__main__":
    main()
