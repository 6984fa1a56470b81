"""Pass on the messages of a piece of work in a worker process while it goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from queue import SimpleQueue
from threading import Thread
from typing import Any

from geometry.common.errors import ProbeError
from hw.common.errors import HardwareError

Message = tuple[str, Any]
Put = Callable[[str, Any], None]


def stream_messages(work: Callable[[Put], object]) -> Iterator[Message]:
    """Yield what ``work`` puts, then ("result", what it returns) or ("refused", the reason in words)."""
    queue: SimpleQueue[Message] = SimpleQueue()

    def put(kind: str, content: Any) -> None:
        """Put one message."""
        queue.put((kind, content))

    def run() -> None:
        """Work, and put how it ended."""
        try:
            put("result", work(put))
        except (ProbeError, HardwareError, OSError) as refusal:
            put("refused", str(refusal))
        except Exception as fault:  # libraries raise what they like
            put("refused", f"{type(fault).__name__}: {fault}")

    Thread(target=run, daemon=True).start()
    while True:
        message = queue.get()
        yield message
        if message[0] in ("result", "refused"):
            return
