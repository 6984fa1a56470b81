"""Replay a recording in place of the device."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hw.common.transport import Chunk, FileTransport
from hw.recordings.recording import Recording


class Replay(FileTransport):
    """A transport that replays a recorded file, without pauses.

    It adds ``replayed`` to the header's source, and texts ``cut`` and ``damaged`` once such a place is reached.
    """

    def __init__(self, path: Path) -> None:
        self._recording = Recording(path)
        source = {"replayed": str(path)}
        self.header = replace(self._recording.header, source=self._recording.header.source | source)
        self._chunks = self._recording.read_chunks()

    def read(self) -> Chunk | None:
        """Return the next chunk; None at the end."""
        chunk = super().read()
        if self._recording.cut:
            self.header.source["cut"] = self._recording.cut
        if places := self._recording.damaged:
            location = f"at byte {places[0]}" + (f" and {len(places) - 1} places more" if len(places) > 1 else "")
            self.header.source["damaged"] = f"{self._recording.path.name} is damaged {location}: what is not whole was left out"
        return chunk
