"""HDF5 files that another program, h5py, has written: read, or refused where they are damaged or hold no samples."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from hw.common.errors import InvalidSource
from hw.common.samples import Samples
from hw.files.columns import ColumnMap
from hw.reader import Reader

RATE, ROWS = 1000.0, 500
TIMES = np.arange(ROWS) / RATE
VOLTS = np.column_stack([0.3 * np.sin(31.0 * TIMES), 0.2 * np.cos(31.0 * TIMES)])


def got(path: Path, *columns: str, rate: str | None = None) -> Samples:
    with Reader.open(f"replay:{path}", columns=ColumnMap.from_texts(columns, rate)) as reader:
        return reader.collect()


def test_datasets_of_another_program(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/t"] = 1e3 * TIMES
        file["run/t"].attrs["units"] = "ms"
        file["run/films"] = np.asarray(1e3 * VOLTS, np.float32)
        file["run/films"].attrs["units"] = "mV"
        file["comment"] = "a text"
    samples = got(tmp_path / "a.h5", "time=run/t", "inner=run/films[1]", "outer=run/films[2]")
    np.testing.assert_allclose(samples.volts, VOLTS, rtol=1e-6, atol=1e-9)
    assert samples.rate == pytest.approx(RATE)


def test_names_units_and_rate_of_its_own(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in zip(("inner", "outer"), VOLTS.T, strict=True):
            file[name] = values
            file[name].attrs["unit"] = "V"
        file.attrs["sample_rate"] = RATE
    samples = got(tmp_path / "a.h5")
    np.testing.assert_array_equal(samples.volts, VOLTS)
    assert samples.rate == RATE


def write_films(path: Path) -> None:
    """Write both films in volts with checksums, as a careful program does."""
    with h5py.File(path, "w") as file:
        for name, values in zip(("inner", "outer"), VOLTS.T, strict=True):
            file.create_dataset(name, data=values, fletcher32=True, chunks=(ROWS,)).attrs["units"] = "V"
        file.attrs["sample_rate"] = RATE


@pytest.mark.parametrize("position", [0, 4, 100, 1000, 3000])
def test_damaged_files_are_refused_or_right(position: int, tmp_path: Path) -> None:
    write_films(tmp_path / "a.h5")
    data = bytearray((tmp_path / "a.h5").read_bytes())
    (tmp_path / "cut.h5").write_bytes(data[: max(position, 1)])
    data[position] ^= 0xFF
    (tmp_path / "flipped.h5").write_bytes(data)
    with pytest.raises(InvalidSource):
        got(tmp_path / "cut.h5")
    with suppress(InvalidSource):
        np.testing.assert_array_equal(got(tmp_path / "flipped.h5").volts, VOLTS)


@pytest.mark.parametrize("name", ["inner", "outer"])
def test_a_flipped_bit_among_the_samples_is_refused(name: str, tmp_path: Path) -> None:
    write_films(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        position = file[name].id.get_chunk_info(0).byte_offset
    data = bytearray((tmp_path / "a.h5").read_bytes())
    data[position + 1000] ^= 0x08
    (tmp_path / "a.h5").write_bytes(data)
    with pytest.raises(InvalidSource, match="damaged"):
        got(tmp_path / "a.h5")


@pytest.mark.parametrize("sign", [b"TREE", b"HEAP", b"SNOD", b"FADB"])
def test_damage_among_names_and_groups_is_refused(sign: bytes, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["inner"], file["outer"] = VOLTS[:, 0], VOLTS[:, 1]
    (tmp_path / "a.h5").write_bytes((tmp_path / "a.h5").read_bytes().replace(sign, b"\xff\xff\xff\xff"))
    with suppress(InvalidSource):
        np.testing.assert_array_equal(got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz").volts, VOLTS[:, :2])


def test_a_few_bytes_that_claim_a_terabyte_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("inner", "outer"):
            file.create_dataset(name, shape=(2**37,), dtype="f8", chunks=(1000,))
    with pytest.raises(InvalidSource, match="inner, which was never written"):
        got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz")
    with h5py.File(tmp_path / "b.h5", "w") as file:  # its first rows were written
        for name, values in zip(("inner", "outer"), VOLTS.T, strict=True):
            file.create_dataset(name, data=values, maxshape=(None,), chunks=(ROWS,)).resize(2**37, axis=0)
    with pytest.raises(InvalidSource, match=r"allowed: up to .* GB; --memory raises"):
        got(tmp_path / "b.h5", "inner=inner V", "outer=outer V", rate="1 kHz")


def test_what_holds_no_samples_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["image"] = np.zeros((30, 30))
    with pytest.raises(InvalidSource, match="no columns of numbers"):
        got(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["inner"], file["outer"] = VOLTS[:, 0], VOLTS[1:, 1]
    with pytest.raises(InvalidSource, match="the same number of samples"):
        got(tmp_path / "b.h5", "inner=inner V", "outer=outer V", rate="1 kHz")
