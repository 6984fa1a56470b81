"""Read a transport on a thread of its own: a device's buffer holds 0.1 s, and a slow disk or a fit takes longer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from queue import SimpleQueue
from threading import Thread

from hw.common.transport import Chunk, Transport

MAX_WAITING_CHUNKS = 400  # chunks of 50 ms: 20 s of samples wait in memory, later ones stay in the device
POLL_INTERVAL_S = 0.1  # s between two checks whether the queue has space


class Drain:
    """Read a transport on a thread of its own. Iterate over it for the chunks, then close it.

    The iterating thread may be interrupted at any point. ``SimpleQueue`` is written in C for that reason: a queue or event
    written in Python could keep its lock for ever, and the thread would wait for it.

    Parameters
    ----------
    transport
        Read by this object only, from now on.
    """

    def __init__(self, transport: Transport) -> None:
        """Start the thread."""
        self._transport = transport
        self._chunks: SimpleQueue[Chunk | BaseException | None] = SimpleQueue()
        self._stopped = False
        self._thread = Thread(target=self._run, name="drain", daemon=True)
        self._thread.start()

    @property
    def is_behind(self) -> bool:
        """Whether chunks have been read that the iterating thread has not fetched yet."""
        return not self._chunks.empty()

    def __iter__(self) -> Iterator[Chunk]:
        """Yield chunks until the source ends. An exception of its ``read`` is raised after the chunks before it."""
        while (chunk := self._chunks.get()) is not None:
            if isinstance(chunk, BaseException):
                raise chunk
            yield chunk

    def close(self) -> None:
        """Stop the thread, and wait for its last read to end."""
        self._stopped = True
        self._thread.join()

    def _run(self) -> None:
        """Read the transport until it ends or the drain is closed, and wait while too many chunks are in the queue."""
        try:
            while not self._stopped:
                chunk = self._transport.read()
                self._chunks.put(chunk)
                if chunk is None:
                    return
                while self._chunks.qsize() >= MAX_WAITING_CHUNKS and not self._stopped:
                    time.sleep(POLL_INTERVAL_S)
        except BaseException as fault:  # raised again in the iterating thread
            self._chunks.put(fault)
