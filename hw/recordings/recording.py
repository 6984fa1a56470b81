"""Write and read recordings: files of raw bytes, stored before they are decoded, with a header that describes them.

A line of JSON, then records: ``READ``, time (s since the start), stream number, lengths of note and data, note, data, CRC-32 of
the record. A record ``DONE`` ends a file that was closed. A cut file is readable up to the cut. Of a damaged record the complete
frames are readable, and all records after it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import struct
import time
import zlib
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import BinaryIO, ClassVar, Literal

from hw.common.closing import Closing
from hw.common.errors import InvalidSource
from hw.common.transport import Chunk, FileTransport, Header

FILE_FORMAT: Literal["probe-design recording"] = "probe-design recording"
FORMAT_VERSION: Literal[1] = 1
_RECORD_HEAD = struct.Struct("<4sdHHI")
_CRC_FORMAT = struct.Struct("<I")
_TAG_PATTERN = re.compile(b"READ|DONE")
WINDOW_BYTES = 1 << 20  # bytes searched at a time
MAX_SALVAGED_BYTES = 100_000  # bytes: frames are searched for in shorter damage only


class Recorder(Closing):
    """Write chunks to a new file; an existing file is never overwritten.

    Raises
    ------
    FileExistsError
        The file exists.
    """

    def __init__(self, path: Path | str, header: Header) -> None:
        """Create the file at ``path``, and write ``header`` as its first line."""
        self._file = Path(path).open("xb", buffering=0)  # noqa: SIM115 - closed by close(); unbuffered
        self._begin, self._end = time.monotonic(), 0
        line = json.dumps({"format": FILE_FORMAT, "version": FORMAT_VERSION} | header.as_dict())
        try:
            self._append(line.encode() + b"\n")
        except OSError:  # the disk is full already
            self._file.close()
            Path(path).unlink(missing_ok=True)
            raise

    def write(self, chunk: Chunk) -> None:
        """Append a chunk, completely or not at all.

        Raises
        ------
        OSError
            The disk is full, or another fault; earlier records stay readable.
        """
        self._append_record(b"READ", chunk)

    def close(self) -> None:
        """Mark the end, flush to disk and close."""
        if not self._file.closed:
            with suppress(OSError):  # on a full disk the file ends like a cut one
                self._append_record(b"DONE", Chunk(b""))
                os.fsync(self._file.fileno())
            self._file.close()

    def _append_record(self, tag: bytes, chunk: Chunk) -> None:
        """Append a record of a chunk, with its checksum; ``tag`` is READ or DONE."""
        note = chunk.note.encode()[:65535]  # 16 bits state its length
        when = time.monotonic() if chunk.time is None else chunk.time
        head = _RECORD_HEAD.pack(tag, when - self._begin, chunk.stream, len(note), len(chunk.data))
        body = head + note + chunk.data
        self._append(body + _CRC_FORMAT.pack(zlib.crc32(body)))

    def _append(self, data: bytes) -> None:
        """Write all bytes, or restore the file's previous length."""
        try:
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) or 0 :]
        except OSError:
            with suppress(OSError):
                self._file.truncate(self._end)
                self._file.seek(self._end)
            raise
        self._end += len(data)


class Recording:
    """A recorded file that is read chunk by chunk.

    Attributes
    ----------
    header
        How to decode it, and its origin.
    cut
        Where the file was cut, as text, or None; set once all chunks are read.
    damaged
        Byte positions of damaged records; complete once all chunks are read.

    Raises
    ------
    InvalidSource
        The file cannot be read, is not a recording, or has another version.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file at ``path``, and read its header."""
        self.path = Path(path)
        self.cut: str | None = None
        self.damaged: list[int] = []
        if not os.path.isfile(path):  # a folder, a pipe (cannot be read twice) or too long a name
            reason = "it is no file" if os.path.exists(path) else "there is no such file"
            raise InvalidSource(f"{path} is not a recording: {reason}")
        try:
            with self.path.open("rb") as file:
                self.header = _read_header(file.readline(1 << 20), self.path)  # at most 1 MB: another file may have no lines
                self._data_begins = file.tell()
        except OSError as fault:
            raise InvalidSource(f"{path} cannot be read ({fault.strerror})") from fault

    def read_chunks(self) -> Generator[Chunk, None, None]:
        """Yield the chunks in order, up to the end or the cut; a damaged record gives a chunk of its bytes as they are."""
        stream = self.header.stream
        with self.path.open("rb") as file:
            file.seek(self._data_begins)
            while True:
                position = file.tell()
                tag, chunk = _read_record(file)
                if tag == b"DONE":
                    return
                if tag == b"READ":
                    stream = chunk.stream
                    yield chunk
                    continue
                next_record = _find_record(file, position + 1)
                if next_record is None:
                    self.cut = f"{self.path.name} was cut or damaged at byte {position}; what stands before is whole"
                    return
                self.damaged.append(position)
                file.seek(position)
                damaged_bytes = (
                    file.read(next_record - position)
                    if self.header.kind == "frames" and next_record - position <= MAX_SALVAGED_BYTES
                    else b""
                )
                if self.header.kind == "frames":  # frames have their own checksums; acquisitions have none
                    yield Chunk(damaged_bytes, stream, f"the recording is damaged at byte {position}")
                file.seek(next_record)


class Replay(FileTransport):
    """A transport that replays a recorded file, without pauses.

    It adds ``replayed`` to the header's source, and texts ``cut`` and ``damaged`` once such a place is reached.
    """

    def __init__(self, path: Path) -> None:
        """Open the recording at ``path``."""
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


def compute_sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file in hexadecimal, by which a calibration record identifies its raw data."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class _Kind:
    """The keys of the first line that all versions share."""

    format: Literal["probe-design recording"]
    version: int
    __pydantic_config__: ClassVar = {"strict": True}


@dataclass(frozen=True)
class _FirstLine(Header):
    """The first line of a file, as validated by pydantic."""

    format: Literal["probe-design recording"]
    version: Literal[1]
    __pydantic_config__: ClassVar = {"strict": True, "extra": "forbid", "allow_inf_nan": False}

    def __post_init__(self) -> None:
        """Raise ``ValueError`` for values that no source of samples has."""
        json.dumps(self.source, allow_nan=False)
        if self.kind not in ("frames", "waveforms", "volts"):
            raise ValueError("kind: frames, waveforms or volts")
        if not 1e-6 < self.rate < 1e12:
            raise ValueError("rate: in Hz, above 0")
        if not 2 <= len(self.channels) == len(self.scale) <= 3 or not all(1e-18 < abs(factor) < 1e6 for factor in self.scale):
            raise ValueError("scale: volts per count of two or three channels")
        # limits of docs/reference/protocol.md
        if not 0 <= self.stream < 1 << 16 or (self.kind == "frames" and not 32 <= self.size <= 1024):
            raise ValueError("stream and size: of no frames")


def _read_header(line: bytes, path: Path) -> Header:
    """Read the header from a file's first line. Raises ``InvalidSource`` if it describes no recording of this version."""
    from pydantic import TypeAdapter, ValidationError

    try:
        version = TypeAdapter(_Kind).validate_json(line).version
        if version != FORMAT_VERSION:
            raise InvalidSource(
                f"{path} is a {FILE_FORMAT} of version {version}: this program reads {FILE_FORMAT} of version {FORMAT_VERSION}"
            )
        first = TypeAdapter(_FirstLine).validate_json(line)
    except ValidationError as fault:
        key = ".".join(map(str, fault.errors(include_url=False)[0]["loc"][:2]))
        wrong = f" ({key})" if key.isascii() and 0 < len(key) < 40 else ""
        raise InvalidSource(f"{path} is not a recording: it does not begin with the line that describes it{wrong}") from fault
    return Header(**{field.name: getattr(first, field.name) for field in fields(Header)})


def _find_record(file: BinaryIO, begin: int) -> int | None:
    """Return the position of the next complete record from ``begin`` on, or None."""
    position = begin
    while True:
        file.seek(position)
        window = file.read(WINDOW_BYTES)
        for match in _TAG_PATTERN.finditer(window):
            file.seek(position + match.start())
            if _read_record(file)[0]:
                return position + match.start()
        if len(window) < WINDOW_BYTES:
            return None
        position += len(window) - 3  # a tag of 4 bytes may cross the window's end


def _read_record(file: BinaryIO) -> tuple[bytes, Chunk]:
    """Read a record; return its tag and chunk. The tag is empty where the file ends or is damaged."""
    head = file.read(_RECORD_HEAD.size)
    if len(head) < _RECORD_HEAD.size:
        return b"", Chunk(b"")
    tag, when, stream, note, length = _RECORD_HEAD.unpack(head)
    body = file.read(note + length) if length < 1 << 30 else b""  # a damaged head may state any length
    crc = file.read(_CRC_FORMAT.size)
    if len(body) < note + length or crc != _CRC_FORMAT.pack(zlib.crc32(head + body)):
        return b"", Chunk(b"")
    if tag not in (b"READ", b"DONE"):
        return b"", Chunk(b"")
    return tag, Chunk(body[note:], stream, body[:note].decode("utf-8", "replace"), when)
