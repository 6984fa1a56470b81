"""Encode requests and decode responses on a serial port, in place of USB's control transfers (``docs/reference/protocol.md``)."""

from __future__ import annotations

import struct
import zlib

REQUEST, ANSWER, VERSION = b"PQ", b"PA", 1
REFUSED = 0x80
_ASKED = struct.Struct("<2sBBHI")
_TOLD = struct.Struct("<2sBBH")
_CRC = struct.Struct("<I")
LONGEST = 256  # bytes of an answer's data at most


def request(number: int, value: int = 0, data: int = 0) -> bytes:
    """Encode a request as 14 bytes."""
    body = _ASKED.pack(REQUEST, VERSION, number, value, data)
    return body + _CRC.pack(zlib.crc32(body))


def answer(number: int, data: bytes = b"") -> bytes:
    """Encode an answer as bytes."""
    body = _TOLD.pack(ANSWER, VERSION, number, len(data)) + data
    return body + _CRC.pack(zlib.crc32(body))


def found(buffer: bytes, number: int) -> tuple[bool, bytes, bytes] | None:
    """Find the answer to a request among the received bytes.

    Returns:
        Whether the request was granted, the answer's data, and the remaining bytes, which belong to the stream; None if the
        answer is not complete yet.
    """
    at = -1
    while (at := buffer.find(ANSWER, at + 1)) >= 0:
        head = buffer[at : at + _TOLD.size]
        if len(head) < _TOLD.size:
            return None
        _, version, told, length = _TOLD.unpack(head)
        end = at + _TOLD.size + length + _CRC.size
        if version != VERSION or told & ~REFUSED != number or length > LONGEST or end > len(buffer):
            continue
        body = buffer[at : end - _CRC.size]
        if _CRC.pack(zlib.crc32(body)) == buffer[end - _CRC.size : end]:
            return not told & REFUSED, body[_TOLD.size :], buffer[:at] + buffer[end:]
    return None
