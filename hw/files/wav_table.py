"""Read WAV files as tables; a sound card states no volts."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from hw.common.samples import Floats
from hw.files.columns import build_refusal
from hw.files.table import ColumnTable

# lowest, highest and zero code by type; scipy returns 24-bit codes in the upper part of 32 bits
_CODE_RANGES = {np.dtype(np.uint8): (0.0, 255.0, 128.0), np.dtype(np.int16): (-32768.0, 32767.0, 0.0),
         np.dtype(np.int32): (-(2.0**31), 2.0**31 - 256, 0.0)}  # fmt: skip
LARGEST_FILE = 400_000_000  # bytes; reading takes four times as much memory


def read_wav(path: Path) -> ColumnTable:
    """Read a WAV file; its channels become columns of numbers from -1 to 1 of the full range.

    Raises
    ------
    InvalidSource
        The file is no WAV file, or was cut.
    """
    from scipy.io import wavfile

    if path.stat().st_size > LARGEST_FILE:
        raise build_refusal(
            path.name, f"{path.stat().st_size} bytes", f"up to {LARGEST_FILE} bytes of sound: longer ones as HDF5"
        )
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="Reached EOF")  # the file was cut
            warnings.filterwarnings("ignore", message="Chunk")  # texts and marks besides the samples
            rate, data = wavfile.read(path)
    except (ValueError, OSError, EOFError, ArithmeticError, RuntimeError, UserWarning, IndexError) as fault:
        raise build_refusal(path.name, f"no whole WAV file ({type(fault).__name__}: {fault})", "PCM or floating point") from fault
    except Exception as fault:  # struct.error, and what else damaged headers bring
        raise build_refusal(path.name, "no WAV file", "PCM or floating point") from fault
    codes = data.reshape(len(data), -1) if data.size else np.zeros((0, 1))
    if not rate > 0:
        raise build_refusal(path.name, f"{rate} samples a second", "a rate above 0")
    low, high, middle = _CODE_RANGES.get(codes.dtype, (-1.0, 1.0, 0.0))
    full = middle - low  # codes of the full range, which becomes 1

    def read(wanted: list[int]) -> Floats:
        """Return the channels of these indices, in fractions of the full range, shape (rows, channels)."""
        return np.asarray((codes[:, wanted].astype(float) - middle) / full)

    names = tuple(f"channel {k + 1}" for k in range(codes.shape[1]))
    ends = ((low - middle) / full, (high - middle) / full)
    return ColumnTable(path.name, names, ("",) * len(names), read, float(rate), ends, {"transport": "wav"})
