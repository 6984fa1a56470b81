"""Somebody who always reads: a device's buffer holds 0.1 s, a slow disk or a fit takes longer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from queue import SimpleQueue
from threading import Thread

from hw.common.transport import Chunk, Transport

MOST = 400  # chunks that wait, of 50 ms each: what nobody fetches for 20 s stays in the device
LOOK = 0.1  # s between two looks whether there is room


class Drain:
    """Reads a transport on a thread of its own; iterate over it for the chunks, and close it.

    Whoever iterates may be interrupted at any point: a queue or an event that is written in Python would then keep its lock for
    good, and the thread wait for it.

    Args:
        transport: read from now on, by nobody else.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._chunks: SimpleQueue[Chunk | BaseException | None] = SimpleQueue()
        self._stopped = False
        self._thread = Thread(target=self._run, name="drain", daemon=True)
        self._thread.start()

    @property
    def behind(self) -> bool:
        """Whether chunks wait."""
        return not self._chunks.empty()

    def __iter__(self) -> Iterator[Chunk]:
        """Yield chunks until the source ends; raises what its ``read`` raised, after all that came before."""
        while (chunk := self._chunks.get()) is not None:
            if isinstance(chunk, BaseException):
                raise chunk
            yield chunk

    def close(self) -> None:
        """Stop, and wait for a read that goes on."""
        self._stopped = True
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopped:
                chunk = self._transport.read()
                self._chunks.put(chunk)
                if chunk is None:
                    return
                while self._chunks.qsize() >= MOST and not self._stopped:
                    time.sleep(LOOK)
        except BaseException as fault:  # handed on to who iterates
            self._chunks.put(fault)
