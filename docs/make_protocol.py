"""Print the bytes that ``docs/reference/protocol.md`` shows: Microsoft's descriptors, and the test vectors of frames.

By the OS 2.0 descriptors Windows gives the board its WinUSB driver automatically. Layouts: Microsoft OS 2.0 Descriptors
Specification (platform capability, set header, compatible ID, registry property).

``python docs/make_protocol.py``
"""

from __future__ import annotations

import struct
import sys
import uuid
import zlib
from pathlib import Path

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from hw.wire.frames import MAX_CODE, MIN_CODE, OVERRUN_FLAG, SATURATED_FLAG, Codes, FrameLayout, encode_frame

PLATFORM_UUID = uuid.UUID("d8dd60df-4589-4cc7-9cd2-659d9e648a9f")
INTERFACE_GUID = "{6c2d9a41-3f0b-4e58-9b1c-7a5de20c8f36}"  # drawn for this project; libusb finds the device by it
WINDOWS_VERSION = 0x06030000  # 8.1, the first that knows these descriptors
MS_OS_20 = 0x20  # vendor code of the descriptor set


def build_descriptor_set() -> bytes:
    """Build the response to bRequest MS_OS_20, wIndex 7: compatible with WinUSB, and an interface GUID."""
    compatible = struct.pack("<HH8s8s", 20, 3, b"WINUSB", b"")
    name = "DeviceInterfaceGUIDs\0".encode("utf-16-le")
    value = f"{INTERFACE_GUID}\0\0".encode("utf-16-le")
    head = struct.pack("<HHHH", 10 + len(name) + len(value), 4, 7, len(name))  # 7: REG_MULTI_SZ
    registry = head + name + struct.pack("<H", len(value)) + value
    body = compatible + registry
    return struct.pack("<HHIH", 10, 0, WINDOWS_VERSION, 10 + len(body)) + body


def build_bos() -> bytes:
    """Build the binary object store, by which Windows requests the descriptor set."""
    capability_data = struct.pack("<IHBB", WINDOWS_VERSION, len(build_descriptor_set()), MS_OS_20, 0)
    capability = struct.pack("<BBBB", 28, 16, 5, 0) + PLATFORM_UUID.bytes_le + capability_data
    return struct.pack("<BBHB", 5, 15, 5 + len(capability), 1) + capability


def build_test_vectors() -> dict[str, tuple[FrameLayout, Codes, bytes]]:
    """Return layout, codes and bytes of each test vector by its description."""
    ramp = np.arange(20, dtype=np.int16).reshape(10, 2)
    ends = np.array([[MAX_CODE, MIN_CODE, -1], [1, 2, 3]], np.int16)
    two, three = FrameLayout(64, 2), FrameLayout(64, 3)
    last, flags = 2**32 - 1, OVERRUN_FLAG | SATURATED_FLAG
    return {
        "64 bytes, two channels, the first frame of stream 1": (
            two, ramp, encode_frame(two, ramp, stream=1, sequence=0, index=0)
        ),
        "64 bytes, the last sequence number before it wraps": (
            two, -ramp, encode_frame(two, -ramp, stream=1, sequence=last, index=10 * last)
        ),
        "64 bytes, three channels, two rows, overrun, inner channel saturated": (
            three, ends, encode_frame(three, ends, stream=0xBEEF, sequence=7, index=2**40, flags=flags)
        ),
    }  # fmt: skip


def format_hex(data: bytes) -> str:
    """Format bytes as lines of sixteen in hexadecimal, each with its offset."""
    return "\n".join(f"{offset:04x}  {data[offset : offset + 16].hex(' ')}" for offset in range(0, len(data), 16))


def format_descriptors() -> str:
    """Return both descriptors as the page shows them."""
    bos, descriptor_set = build_bos(), build_descriptor_set()
    return (
        f"BOS descriptor, {len(bos)} bytes:\n{format_hex(bos)}\n\n"
        f"MS OS 2.0 descriptor set, {len(descriptor_set)} bytes:\n{format_hex(descriptor_set)}"
    )


def format_test_vectors() -> str:
    """Return the test vectors as the page shows them."""
    parts = [f"CRC-32 of the nine bytes '123456789': {zlib.crc32(b'123456789'):08x}"]
    return "\n\n".join([*parts, *(f"{name}:\n{format_hex(data)}" for name, (_, _, data) in build_test_vectors().items())])


if __name__ == "__main__":
    print(f"{format_descriptors()}\n\n{format_test_vectors()}")
