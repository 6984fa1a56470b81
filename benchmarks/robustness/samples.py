"""Make recordings as this program and others write them, with descriptions of the columns."""

from __future__ import annotations

import shutil
import tempfile
import wave
from functools import cache
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from benchmarks.robustness.files import FILE, LIMITS, ROOT, VIRTUAL, Readable
from benchmarks.robustness.written_files import read_printed
from hw.reader import Reader

SCENE = str(ROOT / "examples" / "scene.toml")
VOLTS_PER_COUNT = 2e-6  # V a count of the sound
COLUMNS = {"rate": "1 kHz", "range": "1 V", "inner": "A mV", "outer": {"column": "B", "unit": "mV"}}


def recordings() -> dict[str, Readable]:
    """Return every kind of them by its name."""
    folder, read = write_samples(), ("read", SCENE, "--replay")
    columns = ("--column", "inner=A mV", "--column", "outer=B mV", "--rate", "1 kHz")
    sound = tuple(word for key, n in (("inner", 1), ("outer", 2)) for word in ("--column", f"{key}={n} 65.536 mV"))
    return {
        "recording": Readable(".probe", (*read, FILE, "--json"), _bytes("run.probe")),
        "HDF5": Readable(".h5", (*read, FILE, *columns, "--json"), _bytes("other.h5")),
        "samples as CSV": Readable(".csv", (*read, FILE, *columns, "--json"), _bytes("other.csv")),
        "WAV": Readable(".wav", (*read, FILE, *sound, "--json"), _bytes("other.wav")),
        "columns": Readable(".toml", (*read, str(folder / "other.csv"), "--column", FILE, "--json"), COLUMNS),
        "a field reading": Readable(".probe", ("estimate", SCENE, "--reading", FILE, *LIMITS, "--json"), _bytes("run.probe")),
    }


def _bytes(name: str) -> bytes:
    return (write_samples() / name).read_bytes()


@cache
def write_samples() -> Path:
    """Return the folder of one short reading as all of these files."""
    folder = Path(tempfile.mkdtemp(prefix="robustness-samples-"))
    read_printed("read", SCENE, *VIRTUAL, "--record", str(folder / "run.probe"), "--json")
    with Reader.open(f"replay:{folder / 'run.probe'}") as reader:
        samples = reader.collect()
    _as_others(folder, samples.volts[:, :2], round(samples.rate))
    return folder


def remove() -> None:
    """Remove that folder."""
    shutil.rmtree(write_samples(), ignore_errors=True)


def _as_others(folder: Path, volts: NDArray[np.float64], rate: int) -> None:
    with h5py.File(folder / "other.h5", "w") as file:
        for name, values in zip("AB", 1e3 * volts.T, strict=True):
            file[name] = values
    np.savetxt(folder / "other.csv", 1e3 * volts, delimiter=",", header="A,B", comments="")
    with wave.open(str(folder / "other.wav"), "wb") as sound:
        sound.setnchannels(volts.shape[1])
        sound.setsampwidth(2)
        sound.setframerate(rate)
        sound.writeframes(np.clip(volts / VOLTS_PER_COUNT, -32768, 32767).astype("<i2").tobytes())
