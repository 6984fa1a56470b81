"""Encode requests and decode responses on a serial port, in place of USB's control transfers (``docs/reference/protocol.md``)."""

from __future__ import annotations

import struct
import zlib

REQUEST_MAGIC, ANSWER_MAGIC, PACKET_VERSION = b"PQ", b"PA", 1
REFUSED_BIT = 0x80
_REQUEST_HEAD = struct.Struct("<2sBBHI")
_ANSWER_HEAD = struct.Struct("<2sBBH")
_CRC_FORMAT = struct.Struct("<I")
MAX_ANSWER_BYTES = 256  # bytes of a response's data at most


def encode_request(number: int, value: int = 0, data: int = 0) -> bytes:
    """Encode a request as 14 bytes."""
    body = _REQUEST_HEAD.pack(REQUEST_MAGIC, PACKET_VERSION, number, value, data)
    return body + _CRC_FORMAT.pack(zlib.crc32(body))


def encode_answer(number: int, data: bytes = b"") -> bytes:
    """Encode a response as bytes."""
    body = _ANSWER_HEAD.pack(ANSWER_MAGIC, PACKET_VERSION, number, len(data)) + data
    return body + _CRC_FORMAT.pack(zlib.crc32(body))


def find_answer(buffer: bytes, number: int) -> tuple[bool, bytes, bytes] | None:
    """Find the response to a request among the received bytes.

    Returns
    -------
    tuple[bool, bytes, bytes] | None
        Whether the request was granted, the response's data, and the remaining bytes, which belong to the stream; None if the
        response is not complete yet.
    """
    start = -1
    while (start := buffer.find(ANSWER_MAGIC, start + 1)) >= 0:
        head = buffer[start : start + _ANSWER_HEAD.size]
        if len(head) < _ANSWER_HEAD.size:
            return None
        _, version, answer_number, length = _ANSWER_HEAD.unpack(head)
        end = start + _ANSWER_HEAD.size + length + _CRC_FORMAT.size
        if version != PACKET_VERSION or answer_number & ~REFUSED_BIT != number or length > MAX_ANSWER_BYTES or end > len(buffer):
            continue
        body = buffer[start : end - _CRC_FORMAT.size]
        if _CRC_FORMAT.pack(zlib.crc32(body)) == buffer[end - _CRC_FORMAT.size : end]:
            return not answer_number & REFUSED_BIT, body[_ANSWER_HEAD.size :], buffer[:start] + buffer[end:]
    return None
