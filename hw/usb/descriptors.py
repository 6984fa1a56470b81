"""Build Microsoft's OS 2.0 descriptors, by which Windows gives the board its WinUSB driver automatically.

``python -m hw.usb.descriptors`` prints the bytes that ``docs/reference/protocol.md`` shows. Layouts: Microsoft OS 2.0 Descriptors
Specification (platform capability, set header, compatible ID, registry property).
"""

from __future__ import annotations

import struct
import uuid

from hw.wire.frames import format_hex
from hw.wire.protocol import MS_OS_20

_PLATFORM_UUID = uuid.UUID("d8dd60df-4589-4cc7-9cd2-659d9e648a9f")
_INTERFACE_GUID = "{6c2d9a41-3f0b-4e58-9b1c-7a5de20c8f36}"  # drawn for this project; libusb finds the device by it
_WINDOWS_VERSION = 0x06030000  # 8.1, the first that knows these descriptors


def build_descriptor_set() -> bytes:
    """Build the response to bRequest MS_OS_20, wIndex 7: compatible with WinUSB, and an interface GUID."""
    compatible = struct.pack("<HH8s8s", 20, 3, b"WINUSB", b"")
    name = "DeviceInterfaceGUIDs\0".encode("utf-16-le")
    value = f"{_INTERFACE_GUID}\0\0".encode("utf-16-le")
    head = struct.pack("<HHHH", 10 + len(name) + len(value), 4, 7, len(name))  # 7: REG_MULTI_SZ
    registry = head + name + struct.pack("<H", len(value)) + value
    body = compatible + registry
    return struct.pack("<HHIH", 10, 0, _WINDOWS_VERSION, 10 + len(body)) + body


def build_bos() -> bytes:
    """Build the binary object store, by which Windows requests the descriptor set."""
    capability_data = struct.pack("<IHBB", _WINDOWS_VERSION, len(build_descriptor_set()), MS_OS_20, 0)
    capability = struct.pack("<BBBB", 28, 16, 5, 0) + _PLATFORM_UUID.bytes_le + capability_data
    return struct.pack("<BBHB", 5, 15, 5 + len(capability), 1) + capability


def main() -> None:
    """Print both descriptors."""
    print(f"BOS descriptor, {len(build_bos())} bytes:\n{format_hex(build_bos())}")
    print(f"\nMS OS 2.0 descriptor set, {len(build_descriptor_set())} bytes:\n{format_hex(build_descriptor_set())}")


if __name__ == "__main__":
    main()
