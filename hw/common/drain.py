"""Somebody who always reads: a device's buffer holds 0.1 s, a slow disk or a fit takes longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Event, Thread

from hw.common.transport import Chunk, Transport

MOST = 400  # chunks that wait, of 50 ms each: what nobody fetches for 20 s stays in the device
LOOK = 0.1  # s between two looks whether to stop


class Drain:
    """Reads a transport on a thread of its own; iterate over it for the chunks, and close it.

    Args:
        transport: read from now on, by nobody else.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._chunks: Queue[Chunk | BaseException | None] = Queue(MOST)
        self._stop = Event()
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
        self._stop.set()
        with suppress(Empty):
            while True:
                self._chunks.get_nowait()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                chunk = self._transport.read()
                self._put(chunk)
                if chunk is None:
                    return
        except BaseException as fault:  # handed on to who iterates
            self._put(fault)

    def _put(self, chunk: Chunk | BaseException | None) -> None:
        while not self._stop.is_set():
            try:
                return self._chunks.put(chunk, timeout=LOOK)
            except Full:
                continue
        return None
