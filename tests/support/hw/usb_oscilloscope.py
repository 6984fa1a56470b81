"""An oscilloscope for usb_emulator.py: USBTMC 1.0 (tables 1, 3, 4, 9 and 37) and the words that a Rigol DS1000Z responds to."""

from __future__ import annotations

import struct

POINTS, INTERVAL = 1200, 2e-5


class Oscilloscope:
    """Takes messages from its bulk OUT endpoint and responds to them on its bulk IN endpoint."""

    def __init__(self, settings: dict) -> None:
        self.settings, self.packet, self.halted = settings, 512, False
        self.words: list[bytes] = []
        self.answer = b""
        self.channel, self.acquired = 1, 0

    def descriptors(self) -> bytes:
        device = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0, 0, 0, 64, 0x1AB1, 0x04CE, 0x0100, 0, 0, 3, 1)
        endpoints = b"".join(struct.pack("<BBBBHB", 7, 5, address, 2, self.packet, 0) for address in (0x02, 0x82))
        interface = struct.pack("<9B", 9, 4, 0, 0, 2, 0xFE, 3, 1, 0)
        return device + struct.pack("<BBHBBBBB", 9, 2, 9 + 9 + 14, 1, 1, 0, 0xC0, 0) + interface + endpoints

    def control(self, kind: int, request: int, value: int) -> bytes | None:
        """The response to a request; None refuses it."""
        if (kind, request, value) == (0x80, 6, 0x0300):
            return b"\x04\x03\x09\x04"
        if (kind, request, value) == (0x80, 6, 0x0303):
            text = self.settings["serial"].encode("utf-16-le")
            return bytes([2 + len(text), 3]) + text
        if (kind, request) == (0xA1, 7):  # GET_CAPABILITIES: none beyond the standard's
            return b"\x01\x00\x00\x01".ljust(24, b"\0")
        return None

    def write(self, data: bytes) -> None:
        """DEV_DEP_MSG_OUT carries words; REQUEST_DEV_DEP_MSG_IN asks for what they call for."""
        message, tag, inverse, size = struct.unpack_from("<BBBxL", data)
        assert tag ^ inverse == 0xFF
        if message == 1:
            self.take(data[12 : 12 + size].decode().strip())
        elif message == 2:
            part, self.answer = self.answer[:size], self.answer[size:]
            head = struct.pack("<BBBxLBxxx", 2, tag, tag ^ 0xFF, len(part), not self.answer)
            self.words.append((head + part).ljust(-(-(12 + len(part)) // 4) * 4, b"\0"))

    def take(self, word: str) -> None:
        self.acquired += word == ":SINGLE"
        if ":SOURCE" in word:
            self.channel = int(word[-1])
        self.answer += {
            "*IDN?": b"RIGOL TECHNOLOGIES,DS1104Z,DS1,00.04\n", ":TRIGGER:STATUS?": b"STOP\n",
            ":WAVEFORM:PREAMBLE?": b"0,0,%d,1,%g,-6e-3,0,%g,-10,127\n" % (POINTS, INTERVAL, 1e-3 * self.channel),
            ":WAVEFORM:DATA?": b"#9%09d" % POINTS + bytes((self.channel * k) % 200 + 20 for k in range(POINTS)) + b"\n",
        }.get(word, b"")  # fmt: skip

    def bulk(self, size: int) -> tuple[bytes, str]:
        """What a read brings, and how it ends."""
        if self.acquired > self.settings.get("acquisitions", 1_000_000):
            return b"", "unplug"
        if not self.words:
            return b"", "timeout"
        word, remainder = self.words[0][:size], self.words[0][size:]
        self.words[:1] = [remainder] if remainder else []
        return word, ""
