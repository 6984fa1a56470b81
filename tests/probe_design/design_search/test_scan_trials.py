"""What a scan says of a tumour: simulated scans of the verification, and the scans that a search tries."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.locating.forward_model import SCENE_TABLES, compute_truth
from benchmarks.locating.scans import COMMON, NARROW
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from probe_design.design_search.choices import search_combination, try_other_scans
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.scan_choices import list_scan_choices
from probe_design.design_search.scan_trials import ScanTrials
from probe_design.design_search.search_space import build_search_space
from probe_design.estimation.measurements import Reading
from probe_design.locating.run import run_locate
from probe_design.locating.scan_data import ScanConditions
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.population import ScenePopulation

RASTER: dict[str, Any] = {"positions": ["-16 mm", "16 mm", 5], "raster": True}


def make_design(**tables: Any) -> Design:
    given = {"population": NARROW | COMMON, "protocol": RASTER, "noise": {"charge": "0 pC"}, **tables}
    return design_from_dict({"scene": SCENE_TABLES, **given}, units_required=True)


@pytest.mark.slow
def test_the_place_error_of_trials_is_that_of_scans_that_locate_explains() -> None:
    """The same tumours, but read with reflections, with a gain, a baseline reading and noise of their own."""
    count, rng = 24, np.random.default_rng(3)
    design = make_design()
    draw = ScenePopulation.from_scene(design.scene, design.population).draw_tumours(count)
    trials = ScanTrials.from_design(design, design.scene, draw)
    blank, places = ScanConditions.from_design(design).loads.main.logarithms[0], design.protocol.list_places(0.0)
    sds, distances = list[float](), list[float]()
    for number in range(count):
        tumour = np.array([getattr(draw, key)[number] for key in ("x", "y", "depth", "diameter", "youngs_modulus")])
        signals = np.append(compute_truth(tumour[None, None], places)[0, :, 0], 0.0)
        ratios = np.exp(blank + signals + 0.07 * rng.standard_normal() + 0.01 * rng.standard_normal(len(signals)))
        scan = tuple(
            Reading(x, y, ratio, 0.01, blank=is_blank)
            for (x, y), ratio, is_blank in zip(
                [*places.tolist(), (30e-3, 0.0)], ratios.tolist(), [False] * len(places) + [True], strict=True
            )
        )
        posterior = run_locate(design, scan, 0.0, number, advise=False).by_number[0].sets[:, 0, :2]
        sds.append(float(np.sqrt(posterior.var(axis=0).sum())))
        distances.append(float(np.linalg.norm(posterior.mean(axis=0) - tumour[:2])))
    check_mean(np.array(sds) - trials.values["place_error"], 0.0)
    # of tumours drawn from the prior, the squared distance from the posterior's mean is its variance on average
    check_mean((np.array(distances) / sds) ** 2, 1.0)
    check_mean((trials.distances / trials.values["place_error"]) ** 2, 1.0)


def check_mean(values: Floats, expected: float) -> None:
    """Check the mean of independent values by their own scatter."""
    assert values.mean() == pytest.approx(expected, abs=2.5 * values.std(ddof=1) / np.sqrt(len(values)))


@pytest.mark.slow
def test_no_scan_is_searched_to_less_than_the_best_probe_gives_under_it() -> None:
    design = make_design(
        variables={"presses": [9, 25], "pitch": {"choices": ["4 mm", "8 mm"]}}, limits={"presses": 26, "outer_radius": "9 mm"}
    )
    search_space, objective = build_search_space(design), PopulationObjective.from_design(design, 9e-3)
    first = next(search_space.iterate_combinations())
    best = search_combination(objective, search_space, first, thorough=False)[0]
    tried = try_other_scans(objective, search_space, [best])
    values = {
        scan: max(choice.value for choice in tried if choice.combination.scan == scan) for scan in search_space.scan_choices[1:]
    }
    assert first.scan == search_space.scan_choices[0]
    assert len(values) == 5
    for scan, value in values.items():
        changed = objective.set_choices(replace(first, scan=scan))
        assert value >= changed.evaluate_designs(best.design[:, None], first.poisson)[0]
        assert search_space.admits(max(tried, key=lambda choice: choice.value).design, 1e-6)


def test_scans_are_squares_at_every_pitch_within_the_limit_and_on_the_tissue() -> None:
    design = make_design(variables={"presses": [9, 36], "pitch": {"choices": ["4 mm", "8 mm", "30 mm"]}}, limits={"presses": 26})
    with pytest.raises(InputError, match=r"limits\.presses.*26"):
        list_scan_choices(make_design(limits={"presses": 25}), 9e-3)  # 25 places and a baseline reading
    choices = list_scan_choices(design, 9e-3)
    assert [(choice.presses, round(choice.pitch, 6)) for choice in choices] == [
        (presses, pitch)
        for presses in (9, 16, 25)
        for pitch in (4e-3, 8e-3)  # at 30 mm the probe leaves the tissue
    ]
    assert choices[-1].protocol.places == pytest.approx([-16e-3, -8e-3, 0.0, 8e-3, 16e-3])
    along = make_design(variables={"presses": [5, 9]}, protocol={"positions": ["-16 mm", "16 mm", 5]})
    assert [choice.pitch for choice in list_scan_choices(along, 9e-3)] == pytest.approx([8e-3, 6.4e-3, 5.33e-3, 4.57e-3, 4e-3])


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"variables": {"presses": {"choices": [10]}}}, "squares"),
        ({"variables": {"presses": [2.5, 9]}}, "whole numbers"),
        ({"variables": {"presses": [10, 15]}}, "bounds with a number"),
        ({"variables": {"pitch": ["40 mm", "60 mm"]}}, "no scan left"),
        ({"variables": {"pitch": {"step": "1 mm"}}}, "bounds beside step"),
    ],
)
def test_careless_scans_are_refused_in_words(tables: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        list_scan_choices(make_design(**tables), 9e-3)


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"population": NARROW, "objective": {"maximise": "place_error"}}, r"population\.x"),
        ({"protocol": {"positions": ["-16 mm", "16 mm", 16], "raster": True}}, r"protocol\.positions"),
    ],
)
def test_careless_designs_for_the_place_are_refused(tables: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make_design(**tables)
