"""The virtual probe that tests read, and what every sample of it must be."""

from __future__ import annotations

import numpy as np

from hw.common.samples import Floats, Samples
from hw.reader import Reader
from hw.simulation.virtual import VirtualProbe
from hw.usb.device import UsbDevice
from hw.wire.stream import Patience, StreamTransport
from tests.support.hw.faulty_probe import Fault, make_faulty_probe

RATE, SCALE = 1e5, 2.0**-12
LOST = "frames were lost or damaged on the way"
HURRIED = Patience(silence=0.0, absence=0.2)


def signals(t: Floats) -> Floats:
    """Volts that are whole counts, different for every index of a test."""
    index = np.rint(t * RATE).astype(np.int64)
    return np.asarray(np.column_stack([7919 * index % 65533 - 32766, 104729 * index % 65533 - 32766]) * SCALE, dtype=np.float64)


def probe(*faults: Fault, packet: int = 64) -> VirtualProbe:
    return make_faulty_probe(signals, RATE, serial="V1", faults=faults, scale=SCALE, packet=packet)


def read(source: VirtualProbe, seconds: float = 0.02, patience: Patience = HURRIED) -> Samples:
    with Reader(StreamTransport(UsbDevice("V1", source), patience=patience)) as reader:
        return reader.collect(seconds)


def right(samples: Samples) -> bool:
    return bool((samples.volts == signals(samples.times)).all())
