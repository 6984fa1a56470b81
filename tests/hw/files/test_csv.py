"""Text files as spreadsheets, loggers and oscilloscopes write them: read right or refused with what is missing."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Gap, Samples
from hw.files.columns import ColumnMap
from hw.files.volts import GAP_REASON
from hw.reader import Reader

RATE, ROWS = 1000.0, 400
TIMES = np.arange(ROWS) / RATE
VOLTS = np.column_stack([0.3 * np.sin(31.0 * TIMES) + 0.01, 0.2 * np.cos(31.0 * TIMES), 0.1 * np.sin(31.0 * TIMES + 0.2)])
NAMES = ("inner", "outer", "force")


def got(path: Path, *columns: str, rate: str | None = None) -> Samples:
    with Reader.open(f"replay:{path}", columns=ColumnMap.from_texts(columns, rate)) as reader:
        return reader.collect()


def text(path: Path, head: str, rows: np.ndarray, delimiter: str = ",", comma: bool = False) -> Path:
    """A file of a head and rows with nine digits."""
    body = "\n".join(delimiter.join(f"{value:.9g}" for value in row) for row in rows)
    path.write_text(head + (body.replace(".", ",") if comma else body) + "\n", encoding="utf-8")
    return path


def lines(volts: np.ndarray = VOLTS[:, :2], scale: float = 1.0) -> np.ndarray:
    return np.column_stack([TIMES, volts * scale])


def test_what_csv_of_python_writes(tmp_path: Path) -> None:
    with (tmp_path / "a.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time (s)", "inner (V)", "outer (V)", "force (V)"])
        writer.writerows(np.column_stack([TIMES, VOLTS]).tolist())
    samples = got(tmp_path / "a.csv")
    assert (samples.channels, samples.gaps, samples.saturated.any()) == (NAMES, (), np.False_)
    assert samples.rate == pytest.approx(RATE, rel=1e-9)
    np.testing.assert_array_equal(samples.index, np.arange(ROWS))
    np.testing.assert_allclose(samples.volts, VOLTS, rtol=1e-15)


HEADS = {  # head, delimiter, decimal comma, what the numbers are worth, options
    "spreadsheet": ("Zeit [ms];CH1 [mV];CH2 [mV]\n", ";", True, (1e3, 1e3), ("inner=CH1", "outer=CH2")),
    "no names": ("", "\t", False, (1.0, 1.0), ("time=1 s", "inner=2 V", "outer=3 V")),
    "numpy": ("# time inner outer\n", " ", False, (1.0, 1.0), ("time=time s", "inner=inner V", "outer=outer V")),
    "pico": ("Time,Channel A,Channel B\n(ms),(mV),(mV)\n\n", ",", False, (1e3, 1e3), ("inner=Channel A", "outer=Channel B")),
    "keysight": ("x-axis,1,2\nsecond,Volt,Volt\n", ",", False, (1.0, 1.0), ("inner=1", "outer=2")),
    "tektronix": (
        "Model,MSO24\nFirmware Version,1.2\n\nSample Interval,1.0E-03,s\nRecord Length,400\nLabels,,\nTIME,CH1,CH2\n",
        ",", False, (1.0, 1.0), ("time=TIME s", "inner=CH1 V", "outer=CH2 V"),
    ),
    "siglent": (
        "Record Length,Analog:400\nSample Interval,0.001\nSource,CH1,CH2\nSecond,Volt,Volt\nTime(s),CH1(V),CH2(V)\n",
        ",", False, (1.0, 1.0), ("inner=CH1", "outer=CH2"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", HEADS)
def test_kinds_of_head(kind: str, tmp_path: Path) -> None:
    head, delimiter, comma, (per_second, per_volt), options = HEADS[kind]
    rows = np.column_stack([per_second * TIMES, per_volt * VOLTS[:, :2]])
    samples = got(text(tmp_path / "a.csv", head, rows, delimiter, comma), *options)
    assert samples.rate == pytest.approx(RATE, rel=1e-7)
    np.testing.assert_allclose(samples.volts, VOLTS[:, :2], rtol=1e-8, atol=1e-12)
    assert len(samples) == ROWS


def test_rigol_tells_its_interval_in_the_head(tmp_path: Path) -> None:
    """As a DS1000Z writes it: a count in place of times, and a comma at each row's end."""
    head = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-6.0e-03,1.000e-03\n"
    body = "".join(f"{k},{a:.9g},{b:.9g},\n" for k, (a, b) in enumerate(VOLTS[:, :2]))
    (tmp_path / "a.csv").write_text(head + body)
    samples = got(tmp_path / "a.csv", "inner=CH1", "outer=CH2")
    assert samples.rate == pytest.approx(RATE)
    np.testing.assert_allclose(samples.volts, VOLTS[:, :2], rtol=1e-8, atol=1e-12)


def test_map_as_a_file(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text('rate = "1 kHz"\nrange = "0.25 V"\nouter = "CH2 mV"\ninner = "CH1 2.0 mV"\n')
    path = text(tmp_path / "a.csv", "CH1;CH2\n", 1e3 * VOLTS[:, :2] / [2.0, 1.0], ";", True)
    samples = got(path, str(tmp_path / "map.toml"))
    np.testing.assert_allclose(samples.volts, VOLTS[:, :2], rtol=1e-8, atol=1e-12)
    np.testing.assert_array_equal(samples.saturated, np.abs(VOLTS[:, :2]) >= 0.25)
    assert samples.saturated.any()


@pytest.mark.parametrize("entry", ['""', "true", '{ column = "CH1", unit = "mV" }', f'"1 1{400 * "0"} V"'])
def test_an_entry_that_is_no_column_is_refused(entry: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(f'rate = "1 kHz"\ninner = {entry}\nouter = "2 V"\n')
    with pytest.raises(InvalidSource, match="inner"):
        got(text(tmp_path / "a.csv", "", VOLTS[:, :2]), str(tmp_path / "map.toml"))


@pytest.mark.parametrize("word", ["nan", "", "NaN", "--"])
def test_rows_without_numbers_are_gaps(word: str, tmp_path: Path) -> None:
    rows = [[f"{value:.9g}" for value in row] for row in lines()]
    for k in (50, 51, 200):
        rows[k][1] = word
    (tmp_path / "a.csv").write_text("time (s),inner (V),outer (V)\n" + "\n".join(map(",".join, rows)))
    samples = got(tmp_path / "a.csv")
    assert samples.gaps == (Gap(50, 2, GAP_REASON), Gap(200, 1, GAP_REASON))
    np.testing.assert_array_equal(samples.index, [k for k in range(ROWS) if k not in (50, 51, 200)])
    np.testing.assert_allclose(samples.volts, VOLTS[samples.index, :2], rtol=1e-8, atol=1e-12)


def test_times_that_jump_are_gaps(tmp_path: Path) -> None:
    keep = [k for k in range(ROWS) if not 100 <= k < 117]
    samples = got(text(tmp_path / "a.csv", "time (s),inner (V),outer (V)\n", lines()[keep]))
    assert samples.gaps == (Gap(100, 17, GAP_REASON),)
    np.testing.assert_array_equal(samples.index, keep)
    assert samples.rate == pytest.approx(RATE, rel=1e-7)


def test_overload_counts_as_saturated(tmp_path: Path) -> None:
    rows = lines()
    rows[7, 1], rows[9, 2] = 9.9e37, np.inf
    samples = got(text(tmp_path / "a.csv", "time (s),inner (V),outer (V)\n", rows))
    assert np.argwhere(samples.saturated).tolist() == [[7, 0], [9, 1]]
    assert np.isfinite(samples.volts).all()


HEAD = "time (s),CH1 (mV),CH2 (mV)\n"
BOTH = ("inner=CH1", "outer=CH2")
REFUSED = {  # head, rows, options, rate, words
    "columns missing": (HEAD, lines(), (), None, ("column inner = missing", "1 time, 2 CH1, 3 CH2", "--column|inner=CH1 mV")),
    "one column missing": (HEAD, lines(), ("inner=CH1",), None, ("column outer = missing",)),
    "fewer names than numbers": ("inner,outer\n", np.tile(VOLTS[:, :2], 2), ("inner=inner V",), "1 kHz", ("1, 2, 3, 4",)),
    "names alike": ("time (s),CH (mV),CH (mV)\n", lines(), ("inner=CH", "outer=3"), None, ("names are alike", "2 CH, 3 CH")),
    "no such column": (HEAD, lines(), ("inner=CH7", "outer=CH2"), None, ("column inner = 'CH7'", "2 CH1")),
    "wrong unit": (HEAD, lines(), ("inner=CH1 V", "outer=CH2"), None, ("column inner = 'CH1 V'", "mV")),
    "no unit": ("time (s),CH1,CH2\n", lines(), BOTH, None, ("column inner = without a unit", "CH1 mV")),
    "unit of no voltage": ("time (s),CH1 (N),CH2 (N)\n", lines(), BOTH, None, ("the file has 'N'",)),
    "too many volts": ("time (s),CH1 (V),CH2 (V)\n", lines(scale=1e3), BOTH, None, ("column inner", "100 V", "unit")),
    "no rate": ("CH1 (V),CH2 (V)\n", VOLTS[:, :2], BOTH, None, ("rate = missing", "--rate")),
    "other rate": (HEAD, lines(), BOTH, "2 kHz", ("rate = 2000 Hz", "1000 Hz")),
    "rate without unit": (HEAD, lines(), BOTH, "1000", ("rate = '1000'", "10 kHz")),
    "time for a film": (HEAD, lines(), ("time=CH1 s", "inner=time V", "outer=CH2"), None, ("column",)),
    "swapped names": ("time (s),outer (V),inner (V)\n", lines(), ("inner=outer", "outer=inner"), None, ("not named outer",)),
    "twice the same": (HEAD, lines(), ("inner=CH1", "outer=CH1"), None, ("each its own column",)),
    "time backwards": (HEAD, lines()[::-1], BOTH, None, ("column time", "increase")),
    "uneven": (HEAD, lines() + [[0.0004, 0, 0] if k % 2 else [0, 0, 0] for k in range(ROWS)], BOTH, None, ("even intervals",)),
    "no numbers": ("nothing\n", np.zeros((0, 3)), BOTH, None, ("no rows of two numbers",)),
    "empty": ("", np.zeros((0, 3)), BOTH, None, ("no rows of two numbers",)),
    "only a head": (HEAD, np.zeros((0, 3)), BOTH, None, ("no rows of two numbers",)),
    "bad key": (HEAD, lines(), ("middle=CH1",), None, ("inner, outer, force, time",)),
    "no column's name": (HEAD, lines(), ("inner=",), None, ("column inner = ''",)),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_refusals_say_what_is_missing(what: str, tmp_path: Path) -> None:
    head, rows, options, rate, words = REFUSED[what]
    path = text(tmp_path / "a.csv", head, rows)
    with pytest.raises(InvalidSource) as refused:
        got(path, *options, rate=rate)
    assert "\n" not in str(refused.value)
    for word in words:
        assert any(part in str(refused.value) for part in word.split("|")), str(refused.value)


@pytest.mark.parametrize(("row", "words"), [("0.2,1.5", "2 cells"), ("0.2,abc,1", "'abc'"), ("0.2,1,2,3", "4 cells")])
def test_a_row_that_does_not_fit_is_refused_with_its_line(row: str, words: str, tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", HEAD, lines())
    path.write_text(path.read_text() + row + "\n" + path.read_text().splitlines()[-1])
    with pytest.raises(InvalidSource, match=rf"line {ROWS + 2} = .*{words}"):
        got(path, *BOTH)


def test_names_with_blanks_between_blanks_name_nothing(tmp_path: Path) -> None:
    """Each column was taken for the one on its right."""
    path = text(tmp_path / "a.csv", "sample no inner outer x y\n", np.column_stack([TIMES, VOLTS, VOLTS[:, 0]]), " ")
    with pytest.raises(InvalidSource, match=r"column inner = .*1, 2, 3, 4, 5"):
        got(path, "inner=inner V", "outer=outer V", rate="1 kHz")


def test_points_that_part_thousands_are_refused(tmp_path: Path) -> None:
    """1.000 mV beside decimal commas are a thousand; they were read as one."""
    path = text(tmp_path / "a.csv", "Zeit [s];CH1 [mV];CH2 [mV]\n", lines(), ";", comma=True)
    path.write_text(path.read_text() + "0,4;1.000;2,5\n")
    with pytest.raises(InvalidSource, match=r"line 402 = '1.000'"):
        got(path, "time=Zeit", *BOTH)


def test_bytes_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(HardwareError, match="no text"):
        got(tmp_path / "a.csv")


@pytest.mark.parametrize(("unit", "rate"), [("ms", 1000.0), ("s", 1.0), ("us", 1e6), ("", 1.0)])
def test_the_unit_of_an_interval_may_stand_in_the_next_cell(unit: str, rate: float, tmp_path: Path) -> None:
    """Milliseconds were read as seconds."""
    head = f"Sample Interval,1.0,{unit}\ninner (V),outer (V),x\n"
    path = text(tmp_path / "a.csv", head, np.column_stack([VOLTS[:, :2], TIMES]))
    assert got(path).rate == pytest.approx(rate)


def test_an_interval_of_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "Sample Interval,1.0,ticks\ninner (V),outer (V),x\n", np.column_stack([VOLTS[:, :2], TIMES]))
    with pytest.raises(InvalidSource, match="sample interval = 'ticks': allowed: a unit of time"):
        got(path)


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_a_map_that_is_a_pipe_a_folder_or_a_device_is_refused(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "map.toml")
    with pytest.raises(InvalidSource, match=r"map.toml: allowed: a TOML file of at most 10000 bytes that is there"):
        ColumnMap.from_texts([str(tmp_path / "map.toml")])


@pytest.mark.parametrize("text", ["a = " + "[" * 9000, "a" + ".a" * 4900 + " = 1"])
def test_a_map_that_is_nested_too_deeply_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(InvalidSource, match=r"map.toml: allowed: a TOML file without deep nesting"):
        ColumnMap.from_texts([str(tmp_path / "map.toml")])
