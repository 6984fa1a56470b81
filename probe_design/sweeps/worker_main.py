"""The program of a worker process: reads job, limits and batches of designs from standard input, writes rows to standard output.

Each line is one JSON value with exact floats. The program ends when its input ends, that is with the process that started it.
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

ENOUGH = 2.0  # seconds after which the rest of a batch is returned: rows are committed only when a batch ends


def main() -> None:
    """Evaluate batches until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one handles Ctrl-C
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to standard error
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
    """Evaluate a batch and send its rows part by part, until the time for a batch is over."""
    until = monotonic() + ENOUGH
    for rows in job.pieces([tuple(values) for values in designs]):
        enough = monotonic() > until
        tell({"rows": rows, "enough": enough})
        if enough:
            return


if __name__ == "__main__":
    main()
