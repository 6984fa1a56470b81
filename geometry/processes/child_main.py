"""Run a file's function on each request from standard input: the child's side of ``child.py``.

It is run by its path, so that a child loads only what the file imports. Requests and responses are pickles; a response is
("part", a part of the result), ("end", None) or ("failure", a reason in one line).
"""

from __future__ import annotations

import io
import os
import pickle
import runpy
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress

ALARM_MARGIN_S = 5  # s after the limit that the parent enforces: this one holds even if the parent is killed


def main(program: str, seconds: int, memory: int) -> None:
    """Respond to requests until standard input ends, which it does when the parent ends.

    Parameters
    ----------
    program
        File that defines the function ``run``.
    seconds
        After which the process ends itself, where the system has alarms; 0 for no limit.
    memory
        Bytes that it may hold; 0 for no limit.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the process at once, without a traceback
    if seconds and hasattr(signal, "alarm"):
        signal.alarm(seconds + ALARM_MARGIN_S)
    if memory:
        _limit_memory(memory)
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # text that libraries print must not mix with the responses

    def send(kind: str, content: object) -> None:
        """Send a response; end the process if the parent is gone."""
        message = pickle.dumps((kind, content), pickle.HIGHEST_PROTOCOL)  # whole, or an error before anything is written
        try:
            replies.write(message)
            replies.flush()
        except BrokenPipeError:  # the parent is gone
            os._exit(1)

    requests = io.BufferedReader(io.FileIO(0))
    run = None
    while requests.peek(1):  # empty at the end of standard input
        try:
            request = pickle.load(requests)  # the outer of two pickles, see ``Child.send``: bytes, so no module is needed
            run = run or runpy.run_path(program)["run"]
            result = run(pickle.loads(request))
            for part in result if isinstance(result, Iterator) else [result]:
                send("part", part)
            send("end", None)
        except MemoryError:
            send("failure", "it needs more memory than it may have")
        except Exception as fault:  # libraries raise what they like
            send("failure", " ".join(str(fault).split()) or type(fault).__name__)


def _limit_memory(memory: int) -> None:
    """Limit the process's data to ``memory`` bytes, where the system can (Linux)."""
    with suppress(ImportError, AttributeError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
