"""What the tests run among emulated devices: read, compare every sample with what its index calls for, print JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Any

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import Floats, Ints
from hw.reader import Reader
from hw.usb.device import UsbDevice
from hw.wire.stream import Patience, StreamTransport

PERIOD, SCALE = 65536, 2.0**-12


def expected(index: Ints) -> Floats:
    """What tests/support/hw/usb_emulator.py puts into its frames."""
    codes = np.column_stack([7919 * (index % PERIOD), 104729 * (index % PERIOD) + 12345]) % PERIOD
    return codes.astype(np.uint16).view(np.int16) * SCALE


def read(serial: str | None, seconds: float) -> dict[str, Any]:
    patience = Patience(read=0.1, silence=0.35, absence=1.0)
    with Reader(StreamTransport(UsbDevice(serial), patience=patience)) as reader:
        samples = reader.collect(seconds)
    restart = [gap.first for gap in samples.gaps if gap.count < 0]
    index = np.where(samples.index < restart[0], samples.index, samples.index - restart[0] - 1) if restart else samples.index
    return {
        "rows": len(samples), "last": int(samples.index[-1]), "gaps": [asdict(gap) for gap in samples.gaps],
        "wrong": int(np.count_nonzero(samples.volts != expected(index))),
        "steps": int(np.count_nonzero(np.diff(samples.index) != 1)), "source": samples.source,
    }  # fmt: skip


def look(resource: str) -> dict[str, Any]:
    """Read two acquisitions of tests/support/hw/usb_oscilloscope.py, and try a third."""
    index = np.arange(1200)
    truth = np.column_stack([(1e-3 * k) * ((k * index) % 200 + 20 - 117) for k in (1, 2)])
    with Reader.open(f"visa:{resource}") as reader:
        blocks = reader.blocks()
        wrong = sum(int(np.count_nonzero(~np.isclose(next(blocks).volts, truth, rtol=0, atol=1e-12))) for _ in range(2))
        try:
            next(blocks)
            third = "came"
        except HardwareError as error:
            third = f"{type(error).__name__} from {type(error.__cause__).__name__}"
    return {"wrong": wrong, "third": third, "source": reader.header.source}


def main() -> None:
    try:
        report = look(sys.argv[1]) if sys.argv[1].endswith("INSTR") else read(sys.argv[1] or None, float(sys.argv[2]))
    except HardwareError as error:
        report = {"error": type(error).__name__, "message": str(error), "cause": type(error.__cause__).__name__}
    print(json.dumps(report))


if __name__ == "__main__":
    main()
