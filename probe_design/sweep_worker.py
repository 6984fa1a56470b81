"""A worker process of ``sweep_local``: a job, then batches of designs on standard input, their rows on standard output.

One JSON value a line, whose floats read back the same. It ends when its input does: with whoever started it.
"""

from __future__ import annotations

import json
import os
import signal
import sys


def main() -> None:
    """Answer until there is no more to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who started it to act on
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    from geometry.errors import InputError
    from probe_design.sweep_rows import Job

    job = Job(**json.loads(sys.stdin.readline()))
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        found: dict[str, object]
        try:
            found = {"rows": job.rows([tuple(values) for values in json.loads(line)])}
        except InputError as fault:
            found = {"refused": str(fault)}
        try:
            answers.write(json.dumps(found) + "\n")
            answers.flush()
        except BrokenPipeError:
            os._exit(1)


if __name__ == "__main__":
    main()
