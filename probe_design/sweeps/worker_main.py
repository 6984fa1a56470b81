"""The program of a worker process: job and limits, then batches of designs on standard input, their rows on standard output.

One JSON value a line, whose floats read back the same. It ends when its input does: with whoever started it.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probe_design.sweeps.keys import Value
    from probe_design.sweeps.rows import Job

ENOUGH = 2.0  # seconds after which a batch is given back: rows that wait for its end are not on the disk


def main() -> None:
    """Answer until there is no more to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who started it to act on
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    from geometry.common.errors import InputError
    from geometry.common.resources import Limits, limited
    from probe_design.sweeps.rows import Job
    from solver.linalg.memory import give_back

    def tell(answer: Any) -> None:
        try:
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
        except BrokenPipeError:
            os._exit(1)

    told, limits = json.loads(sys.stdin.readline())
    job = Job(**told)
    job.load()
    tell("ready")
    with limited(Limits(**limits)):
        for line in sys.stdin:
            try:
                _answer(job, json.loads(line), tell)
                give_back()
            except InputError as fault:
                tell({"refused": str(fault)})


def _answer(job: Job, designs: list[list[Value]], tell: Callable[[Any], None]) -> None:
    """Tell the rows of a batch, piece by piece, as long as there is time."""
    until = monotonic() + ENOUGH
    for rows in job.pieces([tuple(values) for values in designs]):
        enough = monotonic() > until
        tell({"rows": rows, "enough": enough})
        if enough:
            return


if __name__ == "__main__":
    main()
