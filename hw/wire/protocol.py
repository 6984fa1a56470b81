"""Define the control requests of the vendor protocol and their data; ``docs/reference/protocol.md`` is the specification."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hw.common.errors import ProtocolError
from hw.common.samples import CHANNEL_NAMES
from hw.wire.frames import PROTOCOL_VERSION

VENDOR_ID, PRODUCT_ID = 0x1209, 0x0001  # pid.codes' number for tests: free to use, not for products on sale
VENDOR_CLASS = 0xFF
REQUEST_IN, REQUEST_OUT = 0xC0, 0x40  # bmRequestType of vendor requests to the device
GET_INFO, SET_RATE, START, STOP, GET_STATUS = 1, 2, 3, 4, 5

_INFO_FORMAT = struct.Struct("<BBHII4f16s")
_STATUS_FORMAT = struct.Struct("<HHIQ")
RATE_FORMAT = struct.Struct("<I")


@dataclass(frozen=True)
class Info:
    """The response to GET_INFO.

    Attributes
    ----------
    channels
        Number of channels, 2 or 3.
    rate
        Present rate, Hz.
    highest_rate
        Hz.
    scale
        Volts per count of each channel.
    firmware
        Name and version, 16 ASCII characters at most.
    frame_size
        Bytes in a frame; 0 on USB, whose packets have that size.
    """

    channels: int
    rate: float
    highest_rate: float
    scale: tuple[float, ...]
    firmware: str
    frame_size: int = 0

    def encode(self) -> bytes:
        """Encode the response as bytes."""
        scale = (*self.scale, 0.0, 0.0)[:4]  # the format holds four channels; unused ones are 0
        return _INFO_FORMAT.pack(
            PROTOCOL_VERSION,
            self.channels,
            self.frame_size,
            round(1e3 * self.rate),  # mHz
            round(1e3 * self.highest_rate),
            *scale,
            self.firmware.encode("ascii"),
        )

    @classmethod
    def decode(cls, data: bytes) -> Info:
        """Decode a device's response.

        Raises
        ------
        ProtocolError
            The response does not follow this version of the protocol.
        """
        if len(data) < _INFO_FORMAT.size:
            raise ProtocolError(f"the device described itself in {len(data)} bytes, not {_INFO_FORMAT.size}: update its firmware")
        version, channels, frame_size, rate, highest, *scale, firmware = _INFO_FORMAT.unpack_from(data)
        if version != PROTOCOL_VERSION:
            raise ProtocolError(
                f"the device speaks version {version} of the protocol, this program {PROTOCOL_VERSION}: update the older"
            )
        if not 2 <= channels <= len(CHANNEL_NAMES) or rate == 0 or not all(0 < factor < 1e3 for factor in scale[:channels]):
            raise ProtocolError(f"the device states {channels} channels, {rate / 1e3} Hz, {scale} V/count: correct its firmware")
        text = firmware.split(b"\0")[0].decode("ascii", "replace")
        return cls(channels, rate / 1e3, highest / 1e3, tuple(scale[:channels]), text, frame_size)


@dataclass(frozen=True)
class Status:
    """The response to GET_STATUS.

    Attributes
    ----------
    stream
        Number of the running stream; 0 when stopped.
    overruns
        Since START, modulo 2^16.
    sequence
        Of the next frame.
    index
        Of the next conversion.
    """

    stream: int
    overruns: int
    sequence: int
    index: int

    def encode(self) -> bytes:
        """Encode the response as bytes."""
        return _STATUS_FORMAT.pack(self.stream, self.overruns % 2**16, self.sequence % 2**32, self.index)

    @classmethod
    def decode(cls, data: bytes) -> Status:
        """Decode a device's response.

        Raises
        ------
        ProtocolError
            The response is too short.
        """
        if len(data) < _STATUS_FORMAT.size:
            raise ProtocolError(f"the device's status has {len(data)} bytes, not {_STATUS_FORMAT.size}: update its firmware")
        return cls(*_STATUS_FORMAT.unpack_from(data))
