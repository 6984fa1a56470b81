"""Sound files, written by Python's own ``wave`` and by scipy: volts, clipping, both directions of the range."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from hw.common.errors import InvalidSource
from hw.common.samples import Samples
from hw.files.columns import ColumnMap
from hw.files.wav_table import read_wav
from hw.reader import Reader

RATE = 44_100
CODES = np.column_stack([np.rint(20_000 * np.sin(0.01 * np.arange(9_000))), np.arange(9_000) * 7 % 30_011 - 15_000]).astype(int)
BOTH = ("inner=1 5 V", "outer=2 2.5 V")


def got(path: Path, *columns: str) -> Samples:
    with Reader.open(f"replay:{path}", columns=ColumnMap.from_texts(columns)) as reader:
        return reader.collect()


def written(path: Path, codes: np.ndarray, width: int) -> Path:
    """Little-endian PCM of so many bytes; eight bits are unsigned."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(codes.shape[1])
        file.setsampwidth(width)
        file.setframerate(RATE)
        file.writeframes(
            b"".join((int(code) + 128 * (width == 1)).to_bytes(width, "little", signed=width > 1) for code in codes.flat)
        )
    return path


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_integers_of_any_width(width: int, tmp_path: Path) -> None:
    full = 2.0 ** (8 * width - 1)
    codes = CODES if width > 1 else CODES // 256
    codes = codes * int(full // 2**15) if width > 2 else codes
    samples = got(written(tmp_path / "a.wav", codes[:300], width), *BOTH)
    np.testing.assert_allclose(samples.volts, codes[:300] / full * [5.0, 2.5], rtol=1e-12, atol=1e-15)
    assert (samples.rate, samples.saturated.any(), samples.gaps) == (RATE, np.False_, ())


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_codes_at_the_ends_are_saturated(width: int, tmp_path: Path) -> None:
    top = 2 ** (8 * width - 1) - 1
    step = 1 if width < 4 else 256  # scipy gives 24 bits and 32 alike
    codes = np.array([[top, 0], [top - step, -1], [-top - 1, 0], [step - top, top]])
    samples = got(written(tmp_path / "a.wav", codes, width), *BOTH)
    assert np.argwhere(samples.saturated).tolist() == [[0, 0], [2, 0], [3, 1]]


def test_floating_point(tmp_path: Path) -> None:
    values = (CODES / 32768).astype(np.float32)
    values[5, 1] = 1.0
    wavfile.write(tmp_path / "a.wav", RATE, values)
    samples = got(tmp_path / "a.wav", *BOTH)
    np.testing.assert_allclose(samples.volts, values * [5.0, 2.5], rtol=1e-7)
    assert np.argwhere(samples.saturated).tolist() == [[5, 1]]


def test_volts_have_to_be_told(tmp_path: Path) -> None:
    path = written(tmp_path / "a.wav", CODES[:99], 2)
    with pytest.raises(InvalidSource, match=r"column inner = missing: .*1 channel 1, 2 channel 2"):
        got(path)
    with pytest.raises(InvalidSource, match="column inner = without a unit"):
        got(path, "inner=1", "outer=2")


@pytest.mark.parametrize("cut", [0, 3, 20, 43, 44, 101])
def test_cut_files_are_refused(cut: int, tmp_path: Path) -> None:
    path = written(tmp_path / "a.wav", CODES[:99], 2)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InvalidSource):
        got(path, *BOTH)


def test_sound_without_an_end_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.wav").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(InvalidSource, match="1000000000000 bytes: allowed: up to 400000000 bytes of sound"):
        read_wav(tmp_path / "a.wav")


def test_mono_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSource, match=r"column outer = '2 2\.5 V'"):
        got(written(tmp_path / "a.wav", CODES[:99, :1], 2), *BOTH)
