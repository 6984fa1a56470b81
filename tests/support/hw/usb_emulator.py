"""Probes for the real libusb: the kernel's usbfs, emulated under umockdev, and in it a firmware from docs/reference/protocol.md.

``umockdev-wrapper python3 usb_emulator.py DEVICES PROGRAM ...`` connects the devices (JSON) and runs the program among them.
Needs Debian's python3 with GObject introspection; shares no code with ``hw``, whose encoder it is a check of.
"""

from __future__ import annotations

import ctypes
import errno
import json
import math
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib

import gi

from tests.support.hw.usb_oscilloscope import Oscilloscope

gi.require_version("UMockdev", "1.0")
from gi.repository import UMockdev  # noqa: E402

CAPABILITIES, SUBMIT, DISCARD, REAP, CLAIM, RELEASE = 0x8004551A, 0x8038550A, 0x550B, 0x4008550D, 0x8004550F, 0x80045510
CLEAR_HALT, SET_CONFIGURATION, SET_INTERFACE, SPEED = 0x80045515, 0x80045505, 0x80085504, 0x551F
URB = struct.Struct("<BBxxiIxxxxQiiiiiIQ")  # type, endpoint, status, flags, buffer, length, actual, ...
BUFFER, CONTROL, IN = 16, 2, 0x80
PERIOD = 65536
TABLE = b"".join(struct.pack("<HH", 7919 * k % PERIOD, (104729 * k + 12345) % PERIOD) for k in range(PERIOD)) * 2
LOAD_PERIOD, LOAD_COUNTS = 20_000, (2700, 4000)  # samples of a load of 5 Hz, and its amplitude in both channels
LOAD = b"".join(
    struct.pack("<hh", *(round(counts * math.sin(2 * math.pi * k / LOAD_PERIOD)) for counts in LOAD_COUNTS))
    for k in range(2 * LOAD_PERIOD)
)
LOAD_SCALE = 2.0**-24  # V a count: both films show 20 mN
SCALE, RATE = 2.0**-12, 100_000.0


class Probe:
    """The firmware: vendor requests, frames, and the faults that it was given."""

    def __init__(self, settings: dict) -> None:
        self.settings, self.packet = settings, settings.get("packet", 512)
        self.rows = (self.packet - 24) // 4
        self.faults = [tuple(fault) for fault in settings.get("faults", [])]  # (frame, kind, how often)
        self.stream = self.index = self.sequence = self.made = 0
        self.halted = False
        self.begun = time.monotonic()

    def descriptors(self) -> bytes:
        device = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0210, 0, 0, 0, 64, 0x1209, 1, 0x0100, 0, 0, 3, 1)
        endpoint = struct.pack("<BBBBHB", 7, 5, 0x81, 2, self.packet, 0)
        interface = struct.pack("<9B", 9, 4, 0, 0, 1, 0xFF, 0, 0, 0)
        return device + struct.pack("<BBHBBBBB", 9, 2, 9 + 9 + 7, 1, 1, 0, 0x80, 50) + interface + endpoint

    def control(self, kind: int, request: int, value: int) -> bytes | None:
        """The response to a request; None refuses it."""
        if (kind, request, value) == (0x80, 6, 0x0303):
            text = self.settings["serial"].encode("utf-16-le")
            return bytes([2 + len(text), 3]) + text
        if (kind, request) == (0xC0, 1):
            scale = LOAD_SCALE if self.settings.get("load") else SCALE
            return struct.pack("<BBHII4f16s", 1, 2, 0, 100_000_000, 100_000_000, scale, scale, 0, 0, b"emulated 1")
        if (kind, request) == (0xC0, 5):
            return struct.pack("<HHIQ", self.stream, 0, self.sequence % 2**32, self.index)
        if (kind, request) == (0x40, 3):
            self.stream, self.index, self.begun = value, 0, time.monotonic()
            self.sequence = self.settings.get("sequence", 0)
            return b""
        if (kind, request) == (0x40, 4):
            self.stream = 0
            return b""
        return None

    def frame(self) -> bytes:
        table, period = (LOAD, LOAD_PERIOD) if self.settings.get("load") else (TABLE, PERIOD)
        offset = 4 * (self.index % period)
        head = struct.pack("<2sBBIQHBB", b"PD", 1, 2, self.sequence % 2**32, self.index, self.stream, self.rows, 0)
        body = (head + table[offset : offset + 4 * self.rows]).ljust(self.packet - 4, b"\0")
        self.lose(1)
        return body + struct.pack("<I", zlib.crc32(body))

    def lose(self, frames: int) -> None:
        self.index, self.sequence = self.index + frames * self.rows, self.sequence + frames

    def bulk(self, size: int) -> tuple[bytes, str]:
        """What a read brings, and how it ends: "", or a fault's kind."""
        data = b""
        while len(data) + self.packet <= size and not self.halted and self.stream:
            if self.faults and self.made >= self.faults[0][0]:
                frame, kind, often = self.faults.pop(0)
                if often > 1:
                    self.faults.insert(0, (frame, kind, often - 1))
                if kind == "partial":  # a third of a frame, then nothing; the rest comes with the next read
                    whole = self.frame()
                    self.owed, cut = whole[self.packet // 3 :], whole[: self.packet // 3]
                    self.faults.insert(0, (0, "owed", 1))
                    return data + cut, "timeout"
                if kind == "owed":
                    data += self.owed
                    continue
                self.lose(1 if kind in ("drop", "stall", "error") else 0)
                if kind == "drop":
                    continue
                self.halted = kind == "stall"
                return data, kind
            self.made += 1
            data += self.frame()
        if self.settings.get("pace"):  # samples no sooner than they would have been taken
            time.sleep(max(0.0, self.begun + self.index / RATE - time.monotonic()))
        return data, "" if data else "stall" if self.halted else "timeout"


class Port(UMockdev.IoctlBase):
    """One device node: usbfs requests from libusb, to which a probe responds."""

    def __init__(self, bed: UMockdev.Testbed, probe: Probe | Oscilloscope, number: int) -> None:
        super().__init__()
        self.bed, self.probe, self.number, self.gone = bed, probe, number, False
        self.done: list = []  # URBs to be reaped
        self.waiting: list = []  # URBs that only a time-out or an unplug ends
        self.path = f"/devices/pci0000:00/0000:00:01.0/usb1/1-{number}"
        node = f"bus/usb/001/{number + 1:03d}"
        facts = [f"P: {self.path}", f"N: {node}", "E: SUBSYSTEM=usb", "E: DEVTYPE=usb_device", f"E: DEVNAME=/dev/{node}"]
        facts += [f"A: {name}\\n" for name in ("bConfigurationValue=1", "busnum=1", f"devnum={number + 1}", "speed=480")]
        bed.attach_ioctl(f"/dev/{node}", self)  # before the node is there to be opened
        bed.add_from_string("\n".join([*facts, f"H: descriptors={probe.descriptors().hex().upper()}", ""]))
        self.node = os.path.join(bed.get_root_dir(), "dev", node)
        if probe.settings.get("denied"):
            os.chmod(self.node, 0)

    def do_handle_ioctl(self, client: UMockdev.IoctlClient) -> bool:
        try:
            result, error = self.answer(client, client.get_arg(), client.get_request() & 0xFFFFFFFF)
        except Exception as fault:  # a traceback in another thread would leave the program waiting
            print("emulator:", repr(fault), file=sys.stderr, flush=True)
            result, error = -1, errno.EINVAL
        client.complete(result, error)
        return True

    def answer(self, client, argument, request: int) -> tuple[int, int]:
        if request == REAP:
            return self.reap(argument)
        if self.gone:
            return -1, errno.ENODEV
        if request == CAPABILITIES:
            argument.resolve(0, 4).update(0, struct.pack("<I", 0x15))  # zero packets, no size limit, reap after disconnect
        elif request == CLAIM and self.probe.settings.get("busy"):
            return -1, errno.EBUSY
        elif request == SUBMIT:
            self.submit(argument.resolve(0, URB.size))
        elif request == DISCARD:
            return self.discard(client)
        elif request == CLEAR_HALT:
            self.probe.halted = False
        elif request == SPEED:
            return 3, 0
        elif request not in (CLAIM, RELEASE, SET_CONFIGURATION, SET_INTERFACE):
            return -1, errno.ENOTTY
        return 0, 0

    def submit(self, urb) -> None:
        kind, endpoint, _, _, _, length, *_ = URB.unpack(bytes(urb.retrieve()))
        buffer = urb.resolve(BUFFER, length)
        if kind == CONTROL:
            what, request, value, _, wanted = struct.unpack("<BBHHH", bytes(buffer.retrieve())[:8])
            answer = self.probe.control(what, request, value)
            if answer and what & IN:
                buffer.update(8, answer[:wanted])
            self.finish(urb, -errno.EPIPE if answer is None else 0, len((answer or b"")[:wanted]) if what & IN else wanted)
            return
        if not endpoint & IN:
            self.probe.write(bytes(buffer.retrieve()))
            self.finish(urb, 0, length)
            return
        data, end = self.probe.bulk(length)
        if data:
            buffer.update(0, data)
        status = {"stall": -errno.EPIPE, "error": -errno.EPROTO}
        if end == "timeout":
            self.waiting.append((urb, len(data)))
        elif end in ("unplug", "power"):
            self.waiting.append((urb, len(data)))
            threading.Timer(0.02, self.unplug, [end]).start()
        else:
            self.finish(urb, status.get(end, 0), len(data))

    def finish(self, urb, status: int, actual: int) -> None:
        urb.update(4, struct.pack("<i", status))
        urb.update(28, struct.pack("<i", actual))
        self.done.append(urb)

    def discard(self, client) -> tuple[int, int]:
        if not self.waiting:
            return -1, errno.EINVAL
        for urb, actual in self.waiting:
            self.finish(urb, -errno.ENOENT, actual)
        self.waiting = []
        return 0, 0

    def reap(self, argument) -> tuple[int, int]:
        if self.done:
            argument.resolve(0, 8).set_ptr(0, self.done.pop(0))
            return 0, 0
        if self.gone:
            return -1, errno.ENODEV
        time.sleep(0.001)  # the node always polls as ready
        return -1, errno.EAGAIN

    def unplug(self, how: str) -> None:
        """Take the device away in mid-read; it comes back at another port, counting on or having lost its power."""
        self.gone = True
        for urb, actual in self.waiting:
            self.finish(urb, -errno.ESHUTDOWN, actual)
        self.waiting = []
        self.bed.remove_device("/sys" + self.path)
        if how == "power":
            self.probe.stream = 0
        if self.probe.settings.get("returns", True):
            time.sleep(0.1)
            self.probe.lose(5)
            PORTS.append(Port(self.bed, self.probe, self.number + 10))


PORTS: list[Port] = []


def without_root() -> None:
    """Let file permissions hold for root too: drop CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH; let Ctrl-C end the program alone."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)


def main() -> int:
    bed = UMockdev.Testbed.new()
    for number, settings in enumerate(json.loads(sys.argv[1]), 1):
        PORTS.append(Port(bed, Oscilloscope(settings) if "acquisitions" in settings else Probe(settings), number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return subprocess.run(sys.argv[2:], preexec_fn=without_root, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
