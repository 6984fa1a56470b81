"""HDF5 both ways, h5py being the other party: files of other programs read, our recordings read by it and again by us."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from hw.common.errors import InvalidSource
from hw.common.samples import Samples
from hw.files.columns import ColumnMap
from hw.files.hdf5_recorder import Hdf5Recorder
from hw.reader import Reader
from tests.support.hw.faulty_probe import Fault
from tests.support.hw.virtual_probes import probe

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


def test_a_recording_is_read_by_h5py_and_again(tmp_path: Path) -> None:
    """With a gap of known length, one of unknown length, saturation and an overrun; units, times and digests for everybody."""
    faults = (Fault("drop", 70, 3), Fault("power", 140, 1, 0.02), Fault("overrun", 180, 2))
    with Reader.open(probe(*faults)) as reader:
        reader.header.source["scene_sha256"] = "ab" * 32
        live = reader.collect(0.03, record=tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["inner"][:], live.volts[:, 0])
        np.testing.assert_array_equal(file["outer"][:], live.volts[:, 1])
        np.testing.assert_allclose(file["time"][:], live.index / live.rate, rtol=1e-15)
        assert (file["inner"].attrs["units"], file["time"].attrs["units"]) == ("V", "s")
        assert file["inner"].dims[0][0] == file["time"]
        assert (file.attrs["scene_sha256"], file.attrs["serial"], file.attrs["rate"]) == ("ab" * 32, "V1", live.rate)
        assert file.attrs["started"].startswith("20")
    samples = got(tmp_path / "a.h5")
    assert {gap.count for gap in live.gaps} >= {-1, 30}
    assert (samples.gaps, samples.overruns, samples.rate, samples.channels) == (
        live.gaps,
        live.overruns,
        live.rate,
        live.channels,
    )
    for key in ("index", "volts", "saturated"):
        np.testing.assert_array_equal(getattr(samples, key), getattr(live, key))


def test_what_was_told_of_the_clock_stands(tmp_path: Path) -> None:
    with Reader.open(probe()) as reader:
        reader.header.source["transport"] = "usb"
        reader.collect(0.03, record=tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file.attrs["clock"] = "time stamps tell another rate"
    assert got(tmp_path / "a.h5").notes == ("time stamps tell another rate",)


@pytest.mark.parametrize("factor", [0.9, 0.995, 1.005, 1.1])
def test_a_rate_that_the_file_s_own_times_contradict_is_told(factor: float, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with Reader.open(probe()) as reader:
        rate = reader.header.rate
        reader.collect(2.0, path)
    assert "clock" not in got(path).source
    with h5py.File(path, "r+") as file:
        file.attrs["rate"] = factor * rate
    assert f"not the stated {factor * rate:.6g}" in got(path).source["clock"]


def samples() -> Samples:
    index = np.arange(ROWS)
    return Samples(RATE, ("inner", "outer"), index, VOLTS, np.zeros((ROWS, 2), bool), (), 0, {"transport": "here"})


def test_saturation_and_long_recordings_survive(tmp_path: Path) -> None:
    """More rows than one chunk, flagged by amplifiers at values that mean nothing."""
    whole = samples()
    saturated = whole.saturated.copy()
    saturated[3, 1] = True
    parts = [replace(whole, index=whole.index + ROWS * k, saturated=saturated) for k in range(80)]
    with Reader.open(probe()) as reader:
        header = reader.header
    with Hdf5Recorder(tmp_path / "a.h5", replace(header, rate=RATE)) as recorder:
        for part in parts:
            recorder.write_samples(part)
    replayed = got(tmp_path / "a.h5")
    np.testing.assert_array_equal(replayed.index, np.arange(80 * ROWS))
    np.testing.assert_array_equal(np.flatnonzero(replayed.saturated[:, 1]), 3 + ROWS * np.arange(80))
    assert not replayed.saturated[:, 0].any()


def test_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with Reader.open(probe()) as reader:
        stream = reader.blocks(0.05, record=tmp_path / "a.h5")
        next(stream)
        assert not (tmp_path / "a.h5").exists()
        stream.close()  # type: ignore[attr-defined]
    assert got(tmp_path / "a.h5").gaps == ()
    with Reader.open(probe()) as reader, pytest.raises(FileExistsError):
        reader.collect(0.01, record=tmp_path / "a.h5")
    with Reader.open(probe()) as reader, pytest.raises(FileNotFoundError):
        reader.collect(0.01, record=tmp_path / "none" / "b.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


FULL = """
import resource, sys
from pathlib import Path
import numpy as np
from hw.reader import Reader
from hw.simulation.virtual import make_virtual_probe

resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
source = make_virtual_probe(lambda times: np.column_stack([np.sin(31 * times), np.cos(31 * times)]), 1e5, scale=1e-4)
with Reader.open(source) as reader:
    live = reader.collect(0.6, record=Path(sys.argv[1]))
print(len(live), *live.notes)
"""


@pytest.mark.parametrize(("room", "kept"), [(0, 0), (30_000, 5000), (1_500_000, 60_000)])
def test_a_full_disk_costs_the_file_not_the_reading_nor_its_raw_data(room: int, kept: int, tmp_path: Path) -> None:
    """In a process of its own: a file that HDF5 could not close took the program down at its end, by signal 11."""
    words = [sys.executable, "-W", "error", "-c", FULL, str(tmp_path / "a.h5"), str(room)]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("60000 there is no HDF5 file")
    assert "file too large" in ended.stdout
    assert [path.name for path in tmp_path.iterdir()] == (["a.h5.probe"] if kept else [])
    if kept:
        assert "what was read is in a.h5.probe" in ended.stdout
        assert kept <= len(got(tmp_path / "a.h5.probe")) <= 61_000


def test_a_disk_that_is_full_from_the_beginning_leaves_no_empty_recording(tmp_path: Path) -> None:
    words = [sys.executable, "-c", FULL, str(tmp_path / "a.probe"), "0"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "File too large" in ended.stderr
    assert list(tmp_path.iterdir()) == []


KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from hw.reader import Reader
from hw.simulation.virtual import make_virtual_probe

source = make_virtual_probe(lambda times: np.column_stack([np.sin(31 * times), np.cos(31 * times)]), 1e4, scale=1e-4)
with Reader.open(source) as reader:
    for block in reader.blocks(60.0, record=Path(sys.argv[1])):
        if block.index[-1] > 20_000:
            print("recorded", flush=True)
            time.sleep(1000)
"""


def test_a_killed_recording_is_read_up_to_the_kill(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "a.h5")], stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"recorded\n"
        running.kill()
    samples = got(tmp_path / "a.h5.probe")
    assert len(samples) > 20_000
    assert any("was cut" in note for note in samples.notes)
    np.testing.assert_allclose(samples.volts[:, 0], np.sin(31 * samples.times), atol=1e-4)
    with pytest.raises(InvalidSource, match=r"until it was interrupted is in .*a\.h5\.probe"):
        got(tmp_path / "a.h5")


def test_a_recording_that_ends_well_leaves_one_file_and_one_of_a_replay_writes_no_other(tmp_path: Path) -> None:
    with Reader.open(probe()) as reader:
        reader.collect(0.05, record=tmp_path / "a.probe")
    with Reader.open(f"replay:{tmp_path / 'a.probe'}") as reader:
        stream = reader.blocks(record=tmp_path / "a.h5")
        next(stream)
        assert not (tmp_path / "a.h5.probe").exists()
        list(stream)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5", "a.probe"]


@pytest.mark.parametrize("position", [0, 4, 100, 1000, 3000])
def test_damaged_files_are_refused_or_right(position: int, tmp_path: Path) -> None:
    with Reader.open(probe()) as reader:
        live = reader.collect(0.01, record=tmp_path / "a.h5")
    data = bytearray((tmp_path / "a.h5").read_bytes())
    (tmp_path / "cut.h5").write_bytes(data[: max(position, 1)])
    data[position] ^= 0xFF
    (tmp_path / "flipped.h5").write_bytes(data)
    with pytest.raises(InvalidSource):
        got(tmp_path / "cut.h5")
    try:
        samples = got(tmp_path / "flipped.h5")
    except InvalidSource:
        return
    np.testing.assert_array_equal(samples.index, live.index)


@pytest.mark.parametrize("name", ["inner", "index", "saturated"])
def test_a_flipped_bit_among_the_samples_is_refused(name: str, tmp_path: Path) -> None:
    with Reader.open(probe()) as reader:
        reader.collect(0.05, record=tmp_path / "a.h5")
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
    with Reader.open(probe()) as reader:
        reader.collect(0.01, record=tmp_path / "b.h5")
    with h5py.File(tmp_path / "b.h5", "a") as file:
        for name in ("inner", "outer", "index", "time"):
            file[name].resize(2**37, axis=0)
        file["saturated"].resize(2**37, axis=0)
    with pytest.raises(InvalidSource, match="damaged"):
        got(tmp_path / "b.h5")


def test_what_holds_no_samples_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["image"] = np.zeros((30, 30))
    with pytest.raises(InvalidSource, match="no columns of numbers"):
        got(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["inner"], file["outer"] = VOLTS[:, 0], VOLTS[1:, 1]
    with pytest.raises(InvalidSource, match="the same number of samples"):
        got(tmp_path / "b.h5", "inner=inner V", "outer=outer V", rate="1 kHz")
