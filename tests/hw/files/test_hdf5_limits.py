"""HDF5 files that would reach elsewhere, claim more than they hold or hold impossible numbers: refused in words, under limits."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.files.columns import ColumnMap
from hw.files.hdf5_file import Hdf5File
from hw.reader import DEFAULT_COLUMNS, Reader
from tests.hw.files.test_hdf5 import ROWS, TIMES, VOLTS, got


def with_films(path: Path, add: Callable[[h5py.File], object]) -> None:
    """Write a good file of another program, and then what is to be refused."""
    with h5py.File(path, "w") as file:
        file["outer"] = VOLTS[:, 1]
        add(file)


def virtual_inner(source: str) -> Callable[[h5py.File], object]:
    layout = h5py.VirtualLayout((ROWS,), "f8")
    layout[:] = h5py.VirtualSource(source, "inner", (ROWS,))
    return lambda file: file.create_virtual_dataset("inner", layout)


@pytest.mark.parametrize("source", [".", "other.h5"])
def test_virtual_datasets_are_refused(source: str, tmp_path: Path) -> None:
    """One that names itself took the library down by signal 11; one of another file would copy what the user never named."""
    with_films(tmp_path / "a.h5", virtual_inner(source))
    with pytest.raises(InvalidSource, match="'inner' is not stored in this file: allowed: datasets within it"):
        got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_external_storage_is_refused_before_it_is_opened(tmp_path: Path) -> None:
    """A pipe that nobody writes to would never end; a file elsewhere would be copied into the recording."""
    os.mkfifo(tmp_path / "pipe")
    storage = [(str(tmp_path / "pipe"), 0, 8 * ROWS)]
    with_films(tmp_path / "a.h5", lambda file: file.create_dataset("inner", (ROWS,), "f8", external=storage))
    with pytest.raises(InvalidSource, match="'inner' is not stored in this file"):
        got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz")


@pytest.mark.parametrize("name", ["inner", "group/deep", "unrelated"])
def test_external_links_are_refused_wherever_they_are(name: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["inner"] = VOLTS[:, 0]
    with_films(tmp_path / "a.h5", lambda file: file.__setitem__(name, h5py.ExternalLink("other.h5", "/inner")))
    with pytest.raises(InvalidSource, match=f"'{name}' is not stored in this file"):
        got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz")


def test_a_soft_link_that_leads_round_in_a_circle_is_left_alone(tmp_path: Path) -> None:
    with_films(tmp_path / "a.h5", lambda file: file.__setitem__("inner", VOLTS[:, 0]))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["circle"], file["group/back"] = h5py.SoftLink("/circle"), file["/"]
    np.testing.assert_array_equal(got(tmp_path / "a.h5", "inner=inner V", "outer=outer V", rate="1 kHz").volts, VOLTS)


def packed_zeros(path: Path, rows: int, chunk: int) -> None:
    """Write columns of zeros that gzip packs a thousand times."""
    with h5py.File(path, "w") as file:
        for name in ("inner", "outer"):
            data = file.create_dataset(name, shape=(rows,), dtype="f8", chunks=(chunk,), compression="gzip", compression_opts=9)
            data[: min(rows, 20_000_000)] = 0.0


def test_limits_of_memory_hold_for_packed_samples(tmp_path: Path) -> None:
    packed_zeros(tmp_path / "a.h5", 20_000_000, 1_000_000)
    assert (tmp_path / "a.h5").stat().st_size < 1e6
    with pytest.raises(InvalidSource, match=r"allowed: up to 1 GB; --memory raises"):
        Reader.open(f"replay:{tmp_path / 'a.h5'}", 1e6, ColumnMap.from_texts(("inner=inner V", "outer=outer V")), ReadLimits(1e9))


def test_a_chunk_larger_than_the_memory_is_refused(tmp_path: Path) -> None:
    packed_zeros(tmp_path / "a.h5", 8_000_000, 8_000_000)
    with pytest.raises(InvalidSource, match=r"'inner' is stored in chunks of 0.064 GB: --memory raises"):
        Reader.open(f"replay:{tmp_path / 'a.h5'}", 1e6, ColumnMap.from_texts(("inner=inner V", "outer=outer V")), ReadLimits(1e8))


def test_limits_of_time_hold_while_a_file_is_read(tmp_path: Path) -> None:
    with_films(tmp_path / "a.h5", lambda file: file.__setitem__("inner", VOLTS[:, 0]))
    with pytest.raises(InvalidSource, match=r"takes longer than 0.001 s to read: --time raises"):
        Reader.open(f"replay:{tmp_path / 'a.h5'}", 1e3, DEFAULT_COLUMNS, ReadLimits(seconds=1e-3))


BEYOND_DOUBLES = np.longdouble("1e4000") if np.finfo(np.longdouble).maxexp > 2000 else 1e308


@pytest.mark.parametrize("large", [1e300, -1e308, np.inf, np.nan, BEYOND_DOUBLES])
@pytest.mark.parametrize("column", ["inner", "time"])
def test_numbers_beyond_reason_end_in_words_not_in_warnings(large: float, column: str, tmp_path: Path) -> None:
    """Warnings are errors in tests; samples beyond any voltage are saturated or refused, times are refused or left out."""
    columns = {"inner": VOLTS[:, 0], "outer": VOLTS[:, 1], "time": TIMES}
    columns[column] = columns[column].astype(np.longdouble)
    columns[column][7] = large
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
            file[name].attrs["units"] = "s" if name == "time" else "V"
    with suppress(InvalidSource):
        assert np.isfinite(got(tmp_path / "a.h5").volts).all()


def test_a_filter_that_is_not_installed_is_named(tmp_path: Path) -> None:
    """Blosc, LZ4 and the like need plugins, which a file must not load; the file itself is not damaged."""
    path = tmp_path / "a.h5"
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((100,))
    properties.set_filter(32004, h5py.h5z.FLAG_OPTIONAL, ())

    def add_packed(file: h5py.File) -> None:
        file["inner"] = VOLTS[:, 0]
        kind, space = h5py.h5t.IEEE_F64LE, h5py.h5s.create_simple((ROWS,))
        dataset = h5py.h5d.create(file.id, b"packed", kind, space, properties)
        for row in range(0, ROWS, 100):
            dataset.write_direct_chunk((row,), np.ones(100).tobytes())

    with_films(path, add_packed)
    assert len(got(path, "inner=inner V", "outer=outer V", rate="1 kHz"))  # what is not read may be packed by anything
    with pytest.raises(InvalidSource, match=r"'packed' is packed by filter 32004.*not installed.*h5repack"):
        got(path, "inner=packed V", "outer=outer V", rate="1 kHz")


def test_whole_numbers_of_64_bits_keep_their_sign(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    high = np.array([2**63, 2**63 + 2**62, 2**64 - 1] * 50, dtype=np.uint64)
    with_films(path, lambda file: file.create_dataset("counts", data=high))
    with Hdf5File(path, ReadLimits()) as file:
        assert file.read([("counts", None)])[0] == pytest.approx(high.astype(float))
