"""Encode requests and decode responses on a serial port, in place of USB's control transfers (``docs/reference/protocol.md``)."""

from __future__ import annotations

import struct
import zlib

REQUEST_MAGIC, RESPONSE_MAGIC, PACKET_VERSION = b"PQ", b"PA", 1
REFUSED_BIT = 0x80
_REQUEST_HEAD = struct.Struct("<2sBBHI")
_RESPONSE_HEAD = struct.Struct("<2sBBH")
_CRC_FORMAT = struct.Struct("<I")
MAX_RESPONSE_BYTES = 256  # bytes of a response's data at most


def encode_request(number: int, value: int = 0, data: int = 0) -> bytes:
    """Encode a request as 14 bytes: its number, a value of 16 bits and data of 32 bits (docs/reference/protocol.md)."""
    body = _REQUEST_HEAD.pack(REQUEST_MAGIC, PACKET_VERSION, number, value, data)
    return body + _CRC_FORMAT.pack(zlib.crc32(body))


def encode_response(number: int, data: bytes = b"") -> bytes:
    """Encode the response to a request: head, data and checksum; ``number`` is the request's, with REFUSED_BIT if refused."""
    body = _RESPONSE_HEAD.pack(RESPONSE_MAGIC, PACKET_VERSION, number, len(data)) + data
    return body + _CRC_FORMAT.pack(zlib.crc32(body))


def find_response(buffer: bytes, number: int) -> tuple[bool, bytes, bytes] | None:
    """Find the response to the request of this number among the received bytes.

    Returns
    -------
    tuple[bool, bytes, bytes] | None
        Whether the request was granted, the response's data, and the remaining bytes, which belong to the stream; None if the
        response is not complete yet.
    """
    start = -1
    while (start := buffer.find(RESPONSE_MAGIC, start + 1)) >= 0:
        head = buffer[start : start + _RESPONSE_HEAD.size]
        if len(head) < _RESPONSE_HEAD.size:
            return None
        _, version, response_number, length = _RESPONSE_HEAD.unpack(head)
        end = start + _RESPONSE_HEAD.size + length + _CRC_FORMAT.size
        is_response = version == PACKET_VERSION and response_number & ~REFUSED_BIT == number
        # these may be bytes of a frame that happen to equal the magic; a later match may be the response
        if not is_response or length > MAX_RESPONSE_BYTES or end > len(buffer):
            continue
        body = buffer[start : end - _CRC_FORMAT.size]
        if _CRC_FORMAT.pack(zlib.crc32(body)) == buffer[end - _CRC_FORMAT.size : end]:
            return not response_number & REFUSED_BIT, body[_RESPONSE_HEAD.size :], buffer[:start] + buffer[end:]
    return None
