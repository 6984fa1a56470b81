"""What a result warns of: gains, drifts, noise, single readings, tumours at the edge of the population's places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probe_design.locating.figures import PLAN_POINTS, draw_plan
from probe_design.locating.other_causes import find_lone_tumours
from probe_design.locating.posterior import find_places
from probe_design.locating.prior import TumourPrior
from probe_design.locating.report import build_headline, list_lines, write_files
from probe_design.locating.result_warnings import MAX_LISTED
from probe_design.locating.run import list_assumed_places
from probe_design.locating.scan_data import ScanData
from tests.probe_design.locating.test_inference import (
    APART,
    CLEAR,
    GAINS,
    NONE,
    PLACES,
    WHITE,
    clear,
    design,
    likelihood,
    result,
    scan,
)
from tests.support.stand_in_model import StandInModel


def test_gains_beyond_their_noise_are_named() -> None:
    """Those of another probe or calibration: ln gain of 0.3 with a standard deviation of 0.07."""
    data = scan(CLEAR)
    notes = result(replace(data, values=data.values + np.array([0.3, 0.0])), tumours=1).warnings
    assert any("all readings are off alike" in line for line in notes)
    assert not clear().warnings


def test_a_tumour_beyond_the_population_s_places_is_said_to_lie_at_their_edge() -> None:
    """It lies 4 mm outside x = 16 mm: a margin of 6 mm holds it, and without one a warning names the edge."""
    outside = CLEAR.copy()
    outside[..., 0] = 20e-3
    narrow, wide = (result(scan(outside), tumours=1, **margin) for margin in ({}, {"margin": 6e-3}))
    assert any("within 1 mm of x = 16 mm" in line and "margin" in line for line in narrow.warnings)
    assert not any("margin" in line for line in wide.warnings)
    low, high = wide.tumours[0].quantities["x"].interval_90
    assert low < 20e-3 < high


def test_every_answer_says_which_probe_and_places_it_assumes() -> None:
    """Readings do not tell another probe, nor a weak tumour beyond the margin: with 6 mm of it places end at 22 mm."""
    (line,) = (text for text in list_lines(result(scan(CLEAR), tumours=1, margin=6e-3)) if "Conditional" in text)
    assert "the probe as drawn" in line
    assert "x = -22 to 22 mm, y = -22 to 22 mm only" in line


def change(data: ScanData, values: object) -> ScanData:
    return replace(data, values=data.values + np.stack([np.broadcast_to(values, len(data)), np.zeros(len(data))], axis=-1))


@pytest.mark.slow
def test_a_drift_that_looks_like_tumours_is_named() -> None:
    """A gain that grew by 8 % over 26 readings without tumours gave three tumours with a probability of 0.97, unwarned."""
    drifting = result(change(scan(NONE), np.linspace(0, 0.08, len(PLACES))), tumours=2)
    assert drifting.probability[0] < 0.05
    (note,) = (line for line in drifting.warnings if "drift" in line)
    change_percent = float(note.split("ratio by ")[1].split(" %")[0])
    assert change_percent == pytest.approx(8, abs=2)
    assert not any("drift" in line for line in result(scan(NONE), tumours=1).warnings)


def test_a_tumour_that_one_wild_reading_makes_is_said_to_rest_on_it() -> None:
    """A reading that is ten standard deviations off, over no tumour, gave one with certainty."""
    wild = change(scan(NONE), 10 * WHITE[0] * (np.arange(len(PLACES)) == 13))
    located = result(wild, tumours=1)
    assert located.probability[0] < 0.05
    (note,) = (line for line in located.warnings if "rests on" in line)
    assert "that there is a tumour rests on reading 13 at x = 0 mm, y = 0 mm alone" in note


def test_a_second_tumour_that_one_wild_reading_makes_is_said_to_rest_on_it() -> None:
    """Beside a clear tumour a reading that is 15 % off gave a second one with certainty, unwarned."""
    wild = change(scan(CLEAR), 0.15 * (np.arange(len(PLACES)) == 20))
    second = np.array([[[16e-3, 8e-3, 9.3e-3, 8.2e-3, 26e3]]])
    tumours = np.concatenate([CLEAR, second], axis=1)
    assert find_lone_tumours(likelihood(wild), tumours) == [(1, 20)]
    assert not find_lone_tumours(likelihood(scan(APART)), APART)


@pytest.mark.slow
def test_a_second_tumour_of_one_reading_is_named_in_the_result() -> None:
    located = result(change(scan(CLEAR), 0.15 * (np.arange(len(PLACES)) == 20)), tumours=2)
    assert located.probability[2] > 0.95
    (note,) = (line for line in located.warnings if "rests on" in line)
    assert "that one of 2 tumours lies at about x = 1" in note
    assert "rests on reading 20 at x = 16 mm, y = 8 mm alone" in note


def test_readings_that_are_listed_twice_are_named() -> None:
    """A scan appended to itself halved its intervals, unwarned; repeats with a scatter of their own are welcome."""
    data = scan(CLEAR)
    (note,) = (line for line in result(data.join(data), tumours=1).warnings if "last digit" in line)
    assert note.startswith("26 of 26 repeated readings equal an earlier one at their place to the last digit, as reading 26")
    assert not any("last digit" in line for line in result(data.join(scan(CLEAR, seed=2)), tumours=1).warnings)


def test_a_place_that_one_wild_reading_shifts_is_said_to_rest_on_it() -> None:
    """Its 90 % intervals, 1 mm wide, did not hold the true place, unwarned."""
    rows = [index for index, place in enumerate(PLACES.tolist()) if place == [0.0, -8e-3]]
    data = change(scan(CLEAR), 0.2 * (np.arange(len(PLACES)) == rows[0]))
    located = result(data, tumours=1)
    low, high = located.tumours[0].quantities["x"].interval_90
    assert not low < 3.1e-3 < high
    assert any(f"where the tumour lies rests on reading {rows[0]}" in line for line in located.warnings)


def test_noise_that_is_stated_too_large_is_named() -> None:
    """Readings that scatter by 1 % where 10 % are stated: a p-value of 1 was no word."""
    data = scan(NONE)
    notes = result(replace(data, variance=100 * data.variance), tumours=1).warnings
    (note,) = (line for line in notes if "of what [noise] states" in line)
    assert 5 < float(note.split("scatter by ")[1].split(" %")[0]) < 20


@pytest.mark.slow
def test_more_wild_readings_than_are_stated_are_counted() -> None:
    """Ratios of charges among ratios of stresses: half of the readings were silently counted as wild."""
    mixed = result(change(scan(CLEAR), 0.5 * (np.arange(len(PLACES)) % 2)), 0.05, tumours=1)
    assert any("13 of 26 readings count as wild" in line for line in mixed.warnings)


def test_of_many_readings_that_are_far_off_the_farthest_are_named() -> None:
    """Two loads whose gains differ had 25 lines of warnings, one for each reading."""
    notes = result(change(scan(NONE), 0.3 * (np.arange(len(PLACES)) % 2)), tumours=1).warnings
    listed = [line for line in notes if "off its prediction" in line]
    assert len(listed) == MAX_LISTED
    assert any(line.endswith("more are 4 standard deviations off their predictions or more") for line in notes)


def test_a_line_of_readings_says_where_tumours_are_assumed() -> None:
    """y was the line's own, with an interval of no width, unwarned."""
    line = np.array([(x, 0.0) for x in np.linspace(-16e-3, 16e-3, 9)])
    for population, count in (({}, 1), ({"y": [-16e-3, 16e-3]}, 0), ({"y": 0.0}, 0)):
        made = design(**population)
        assert len(list(list_assumed_places(made, TumourPrior.from_design(made, line)))) == count
    assert not list(list_assumed_places(design(), TumourPrior.from_design(design(), PLACES[1:])))


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_readings_far_beyond_the_population_compute_without_warnings_of_numpy() -> None:
    """All pairs touch that could explain one tumour ten times as strong: -inf less -inf was printed as a warning."""
    strong = scan(CLEAR)
    assert not result(change(strong, 3 * (strong.values[:, 0] - np.median(strong.values[:, 0])) * 5), tumours=2).explained


def test_a_tumour_beside_a_line_of_readings_has_two_places() -> None:
    """The headline had the median of both sides, where the tumour cannot be, and the map showed one side alone."""
    beside = CLEAR.copy()
    beside[..., 1] = 9e-3
    places = np.array([(30e-3, 0.0), *((x, 0.0) for x in np.linspace(-16e-3, 16e-3, 25))])
    values = np.zeros((len(places), 2))
    values[1:] = StandInModel().predict(beside, places[1:])[0]
    variance = np.tile([1e-6, np.inf], (len(places), 1))
    data = ScanData(places, values, variance, np.zeros((len(places), 2)), np.arange(len(places)) == 0, GAINS)
    located = result(data, tumours=1, y=[-16e-3, 16e-3], depth=[8.5e-3, 9.5e-3], diameter=10e-3, object=26e3)
    (_, first), (_, second) = find_places(*located.best.sets[:, 0, :2].T)
    assert sorted([first, second]) == pytest.approx([-9e-3, 9e-3], abs=1e-3)
    assert f"y = {1e3 * first:.1f} mm or at x = " in build_headline(located)
    (plan, *_) = draw_plan(located).axes
    shown = np.asarray(plan.collections[0].get_array()).reshape(PLAN_POINTS, PLAN_POINTS)
    half = PLAN_POINTS // 2  # of the rows, below y = 0
    assert shown[:half].max() == pytest.approx(shown[-half:].max(), abs=0.15)
    ((x, y),) = find_places(*clear().best.sets[:, 0, :2].T)
    assert (x, y) == pytest.approx(
        (clear().tumours[0].quantities["x"].median, clear().tumours[0].quantities["y"].median), abs=1e-4
    )


def test_a_page_has_warnings_above_its_tables_and_their_titles(tmp_path: Path) -> None:
    """They stood below all pictures; of which number of tumours a table was, and how probable that is, no page said."""
    data = change(scan(NONE), np.linspace(0, 0.08, len(PLACES)))
    write_files(result(data, tumours=1), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.index("seems to drift") < page.index("How many tumours</h2>") < page.index("If 1 tumour (probability 1.00):")


def test_a_place_that_is_not_learnt_is_not_stated() -> None:
    """It was the middle of the population's places, "within 900 mm²" of 1024."""
    data = scan(CLEAR)
    weak = result(data.select(slice(0, 4)), tumours=1, weights=[1, 9])
    assert weak.probability[0] < 0.5
    assert build_headline(weak).endswith("Where the clearest lies the readings do not tell.")
