"""Define the SCPI commands of each family of oscilloscopes, and decode their responses.

Keysight InfiniiVision, Rigol DS1000Z/MSO5000, Tektronix MSO/DPO/TBS2000 (older TDS use WFMPre and are not supported). All send
8-bit codes. One acquisition is taken and then read channel by channel, so that the channels are simultaneous. From code to volts:

    Keysight   (code - yreference) yincrement + yorigin     InfiniiVision 2000 X programmer's guide, :WAVeform, data conversion
    Rigol      (code - yorigin - yreference) yincrement     DS1000Z-E programming guide, :WAVeform:DATA?
    Tektronix  (code - YOFf) YMUlt + YZEro                  MSO4000/DPO4000 programmer manual, WFMInpre:YMUlt
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.common.errors import ProtocolError
from hw.common.samples import Bools, Floats


@dataclass(frozen=True)
class Scaling:
    """The scales of a channel: volts = (code - zero) * step + offset, one sample every ``interval`` s."""

    interval: float
    step: float
    zero: float
    offset: float

    def to_volts(self, codes: Floats) -> Floats:
        """Convert the converter's codes to volts, of the same shape."""
        return (codes - self.zero) * self.step + self.offset


@dataclass(frozen=True)
class Dialect:
    """The SCPI commands of one family of oscilloscopes.

    Attributes
    ----------
    makers
        Words in the response to *IDN? that identify the family.
    acquire
        Commands that take one acquisition.
    finished
        A query, and its response when the acquisition is complete.
    select
        Commands that select channel {channel} for the next queries.
    scaling
        A query for the fields of ``Scaling``.
    data
        A query for the codes, as a definite-length block.
    signed
        Whether codes are signed.
    ends
        Codes at or beyond which a value is at the end of the range.
    rate
        Commands that set a rate of {rate} Hz, or {division} s per division; empty where only the front panel sets it.
    """

    makers: tuple[str, ...]
    acquire: tuple[str, ...]
    finished: tuple[str, str]
    select: tuple[str, ...]
    scaling: str
    data: str
    signed: bool
    ends: tuple[int, int]
    rate: tuple[str, ...] = ()

    def read_scaling(self, response: str) -> Scaling:
        """Read the scales from the response to ``scaling``.

        Raises
        ------
        ProtocolError
            The response has another form.
        """
        try:
            fields = [float(word) for word in response.replace(";", ",").split(",")]
            if self is TEKTRONIX:
                interval, step, zero, offset = fields
                return _check_scaling(Scaling(interval, step, zero, offset), response)
            # format, type, points, count, then increment, origin and reference of x (time) and of y (voltage)
            _, _, _, _, interval, _, _, step, origin, reference = fields
        except ValueError as fault:
            raise ProtocolError(f"the oscilloscope's scales are {response!r}: not in the form of its family") from fault
        if self is RIGOL:  # Rigol's origin is in codes, Keysight's in volts
            return _check_scaling(Scaling(interval, step, origin + reference, 0.0), response)
        return _check_scaling(Scaling(interval, step, reference, origin), response)

    def decode(self, block: bytes, scaling: Scaling) -> tuple[Floats, Bools]:
        """Decode a block of codes to volts and saturation, shape (n,) each."""
        codes = np.frombuffer(block, np.int8 if self.signed else np.uint8)
        return scaling.to_volts(codes.astype(float)), (codes <= self.ends[0]) | (codes >= self.ends[1])


KEYSIGHT = Dialect(
    makers=("KEYSIGHT", "AGILENT"),
    acquire=(":DIGITIZE",),
    finished=("*OPC?", "1"),
    select=(
        ":WAVEFORM:SOURCE CHANNEL{channel}",
        ":WAVEFORM:FORMAT BYTE",
        ":WAVEFORM:UNSIGNED 1",
        ":WAVEFORM:POINTS:MODE RAW",
        ":WAVEFORM:POINTS MAX",
    ),
    scaling=":WAVEFORM:PREAMBLE?",
    data=":WAVEFORM:DATA?",
    signed=False,
    ends=(1, 255),
)
RIGOL = Dialect(
    makers=("RIGOL",),
    acquire=(":SINGLE", ":TFORCE"),
    finished=(":TRIGGER:STATUS?", "STOP"),
    select=(":WAVEFORM:SOURCE CHANNEL{channel}", ":WAVEFORM:MODE NORMAL", ":WAVEFORM:FORMAT BYTE"),
    scaling=":WAVEFORM:PREAMBLE?",
    data=":WAVEFORM:DATA?",
    signed=False,
    ends=(0, 255),
    rate=(":TIMEBASE:MAIN:SCALE {division:.6g}",),
)
TEKTRONIX = Dialect(
    makers=("TEKTRONIX",),
    acquire=("HEADER OFF", "ACQUIRE:STOPAFTER SEQUENCE", "ACQUIRE:STATE RUN"),
    finished=("*OPC?", "1"),
    select=("DATA:SOURCE CH{channel}", "DATA:ENCDG RIBINARY", "DATA:WIDTH 1", "DATA:START 1", "DATA:STOP 100000000"),
    scaling="WFMOUTPRE:XINCR?;YMULT?;YOFF?;YZERO?",
    data="CURVE?",
    signed=True,
    ends=(-128, 127),
    rate=("HORIZONTAL:MODE MANUAL", "HORIZONTAL:MODE:SAMPLERATE {rate:.6g}"),
)
DIALECTS = {"keysight": KEYSIGHT, "rigol": RIGOL, "tektronix": TEKTRONIX}


def find_dialect(identity: str) -> str:
    """Return the name of the dialect for an oscilloscope's response to *IDN?.

    Raises
    ------
    ProtocolError
        No family is known for it.
    """
    for name, dialect in DIALECTS.items():
        if any(maker in identity.upper() for maker in dialect.makers):
            return name
    raise ProtocolError(f"oscilloscope {identity.strip()!r}: only families of {', '.join(DIALECTS)} are known")


def _check_scaling(scaling: Scaling, response: str) -> Scaling:
    """Return scales unchanged if they can convert codes to volts. Raises ``ProtocolError`` for others."""
    finite = np.isfinite([scaling.interval, scaling.step, scaling.zero, scaling.offset]).all()
    if not (finite and scaling.interval > 0 and scaling.step > 0):
        raise ProtocolError(f"the oscilloscope's scales are {response!r}: is the channel switched on?")
    return scaling
