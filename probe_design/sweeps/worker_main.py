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
    from geometry.scenes.keys import Value
    from probe_design.sweeps.rows import Job

MAX_BATCH_TIME_S = 2.0  # seconds after which the rest of a batch is returned: rows are committed only when a batch ends


def main() -> None:
    """Evaluate batches until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one handles Ctrl-C
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to standard error
    from geometry.common.errors import InputError
    from geometry.common.resources import Limits, use_limits
    from probe_design.sweeps.rows import Job
    from solver.linalg.memory import give_back

    def send(message: Any) -> None:
        try:
            answers.write(json.dumps(message) + "\n")
            answers.flush()
        except BrokenPipeError:
            os._exit(1)

    job_fields, limits = json.loads(sys.stdin.readline())
    job = Job(**job_fields)
    job.warm_up()
    send("ready")
    with use_limits(Limits(**limits)):
        for line in sys.stdin:
            try:
                _evaluate_batch(job, json.loads(line), send)
                give_back()
            except InputError as fault:
                send({"refused": str(fault)})


def _evaluate_batch(job: Job, designs: list[list[Value]], send: Callable[[Any], None]) -> None:
    """Evaluate a batch and send its rows part by part, until the time for a batch is over."""
    deadline = monotonic() + MAX_BATCH_TIME_S
    for rows in job.evaluate_parts([tuple(values) for values in designs]):
        is_late = monotonic() > deadline
        send({"rows": rows, "enough": is_late})
        if is_late:
            return


if __name__ == "__main__":
    main()
