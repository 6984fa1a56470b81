"""A posterior that is updated reading by reading, against the posterior of all readings at once."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from probe_design import Locator
from probe_design.estimation.measurements import Reading
from probe_design.locating.inference import Posterior
from probe_design.locating.locator import NoRecommendation
from probe_design.locating.scan_loads import TumourFree
from probe_design.locating.stopping import find_stop
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.surveys.figures import Step, draw_step
from tests.support.paths import ROOT
from tests.support.stand_in_model import StandInModel

POPULATION = {"depth": [8e-3, 20e-3], "diameter": [5e-3, 12e-3], "object": [16e3, 32e3], "least_cover": 2e-3}
TRUTH = np.array([[[3.1e-3, -5.4e-3, 9.0e-3, 10e-3, 26e3]]])
PLACES = [(30e-3, 0.0), *((x, y) for y in np.linspace(-16e-3, 16e-3, 5) for x in np.linspace(-16e-3, 16e-3, 5))]


def design(tumours: int, loads: tuple[float, ...] = (), white: float = 0.01, charge: float = 0.0) -> Design:
    tables = {"scene": str(ROOT / "examples" / "scene.toml"), "population": POPULATION | {"tumours": tumours}}
    return design_from_dict(tables | {"noise": {"white": white, "charge": charge}, "protocol": {"loads": loads}})


@cache
def logarithms() -> Floats:
    return TumourFree.from_scene(design(1).scene).logarithms


def press(x: float, y: float, noise: float, blank: bool = False) -> Reading:
    change = 0.0 if blank else float(StandInModel().predict(TRUTH, np.array([[x, y]]))[0, 0, 0])
    return Reading(x=x, y=y, ratio=float(np.exp(logarithms()[0] + 0.05 + change + 0.01 * noise)), noise=0.01, blank=blank)


def locator(tumours: int, readings: int, **options: float) -> Locator:
    result = Locator(design(tumours), model=StandInModel(), **options)  # type: ignore[arg-type]
    noises = np.random.default_rng(4).standard_normal(len(PLACES))
    for index in range(readings):
        result.update(press(*PLACES[index], float(noises[index]), blank=index == 0))
    return result


@pytest.mark.parametrize("tumours", [1, 2])
def test_updates_agree_with_all_readings_at_once(tumours: int) -> None:
    streamed = locator(tumours, len(PLACES))
    full = Posterior.from_likelihood(streamed._likelihood, 5)
    factors = [part.log_evidence - part.log_evidence[0] for part in (streamed._posterior, full)]
    for number, stream in enumerate(streamed._streams, start=1):
        error = np.hypot(stream.evidence_error, full.samples[number - 1].evidence_error)
        assert abs(factors[0][number] - factors[1][number]) < 3 * error + 0.03, number
        points = [part.prior.transform(sample.points)[:, :, :2] for part, sample in (
            (streamed, stream.sample), (streamed, full.samples[number - 1]))]  # fmt: skip
        means = [
            np.einsum("n,nmq->q", s.weights, p) / number
            for s, p in zip((stream.sample, full.samples[number - 1]), points, strict=True)
        ]
        spread = np.sqrt(np.einsum("n,nmq->q", full.samples[number - 1].weights, (points[1] - means[1]) ** 2) / number)
        size = min(stream.sample.size, full.samples[number - 1].size)
        assert np.all(np.abs(means[0] - means[1]) < 5 * spread / np.sqrt(size)), number
    assert streamed.probability[0] < 1e-3


def test_evidence_of_a_faint_scan_is_the_mean_likelihood_of_the_prior() -> None:
    """Against plain Monte Carlo over the prior by other random numbers, for one tumour and two."""
    streamed = locator(2, 6)
    for number, stream in enumerate(streamed._streams, start=1):
        tumours = streamed.prior.transform(np.random.default_rng(8).random((40_000, number, 5)))
        tumours = tumours[streamed.prior.find_allowed(tumours)]
        values = np.concatenate([streamed._likelihood.evaluate_tumours(part) for part in np.array_split(tumours, 20)])
        plain = values.max() + np.log(np.mean(np.exp(values - values.max())))
        assert stream.sample.log_evidence == pytest.approx(plain, abs=0.1)


@pytest.mark.slow
def test_wild_readings_stream_as_well() -> None:
    streamed = locator(1, 10, outliers=0.05)
    full = Posterior.from_likelihood(streamed._likelihood, 5)
    assert streamed.probability[1] == pytest.approx(full.probability[1], abs=0.05)


def test_same_seed_and_readings_give_the_same_numbers() -> None:
    first, second = locator(1, 12), locator(1, 12)
    assert first.probability == second.probability
    assert first.next_position() == second.next_position()
    assert first.map().tumours == second.map().tumours


def test_next_place_is_where_the_tumour_may_be() -> None:
    """After a clear reading the next one is near it; of given candidates one is returned; far from tissue none is."""
    subject = locator(1, 10)
    following = subject.next_position()
    assert np.hypot(following.x - 3.1e-3, following.y + 5.4e-3) < 12e-3
    far, near = subject.next_position([[25e-3, 25e-3]]), subject.next_position([[25e-3, 25e-3], [4e-3, -4e-3]])
    assert (near.x, near.y) == (4e-3, -4e-3)
    assert near.information > far.information
    with pytest.raises(InputError, match="candidates"):
        subject.next_position([[1.0, 0.0]])


def test_ask_and_tell_until_a_tumour_is_certain() -> None:
    """The recommenders of bluesky-adaptive: tell(x, y), ask(n), and an exception at the end."""
    subject = locator(1, 1)
    for noise in np.random.default_rng(6).standard_normal(15):
        try:
            x, y = subject.ask(1)
        except NoRecommendation as stop:
            assert "a tumour lies there" in str(stop)  # noqa: PT017
            break
        subject.tell((x, y), press(x, y, float(noise)).ratio)
    else:
        pytest.fail("no stop within 15 readings")
    assert len(subject.readings) > 2
    with pytest.raises(InputError, match="ratio"):
        subject.tell((0.0, 0.0), -1.0)


def test_next_load_is_the_one_that_says_more() -> None:
    """Two loads say the same in linear elasticity, but for the noise of charges, which counts the less under the heavier."""
    chosen = {}
    for charge in (0.0, 2e-15):
        subject = Locator(design(1, (8e-3, 4e-3), charge=charge), model=StandInModel())
        subject.update({"x": 0.03, "y": 0.0, "ratio": float(np.exp(logarithms()[0])), "blank": True, "force": 4e-3})
        chosen[charge] = subject.next_position()
        light, heavy = (subject.next_position([[4e-3, -4e-3, force]]) for force in (4e-3, 8e-3))
        assert (light.force, heavy.force) == (4e-3, 8e-3)
        assert (heavy.information > light.information) == (charge > 0)
        assert subject.ask()[2] == chosen[charge].force
    assert (chosen[0.0].force, chosen[2e-15].force) == (4e-3, 8e-3)
    with pytest.raises(InputError, match="force"):
        subject.next_position([[4e-3, -4e-3, 50.0]])
    with pytest.raises(InputError, match="shape"):
        subject.next_position([[4e-3, -4e-3, 4e-3, 0.0]])


@pytest.mark.slow
def test_a_scan_under_two_equal_loads_detects_like_readings_with_half_the_variance() -> None:
    twice, exact = (
        Locator(known, model=StandInModel()) for known in (design(1, (4e-3, 8e-3)), design(1, white=0.01 / np.sqrt(2)))
    )
    fractions = [part.compute_detectable_probability() for part in (twice, exact, locator(1, 0))]
    assert fractions[0] == pytest.approx(fractions[1], abs=0.03)
    assert fractions[2] < fractions[0] - 0.03


def test_reasons_to_stop() -> None:
    assert find_stop(0.5, 0.5, 0.1) is None
    assert find_stop(0.5, 0.02, 0.1) is None  # one such stop in fifty would be wrong
    reasons = [find_stop(*numbers) for numbers in ((0.009, 0.9, 0.1), (0.7, 0.009, 0.1), (0.5, 0.5, 1e-4))]
    assert [stop.reason for stop in reasons if stop is not None] == ["tumour", "none", "nothing to learn"]


def test_maps_number_presses_as_the_survey_s_table_does() -> None:
    """The first press is the baseline reading: maps counted from the second."""
    subject = Locator(design(1), model=StandInModel())
    for x, blank in ((30e-3, True), (4e-3, False), (-4e-3, False)):
        subject.update({"x": x, "y": 0.0, "ratio": 0.39, "blank": blank})
    (axes, *_) = draw_step(Step.from_locator(subject, None)).axes
    assert [text.get_text() for text in axes.texts] == ["2", "3"]
    assert axes.get_title().startswith("press 3: no tumour 0.")


@pytest.mark.parametrize("arguments", [((1e-3,), 0.4), ((1e-3, 0.0), (0.4, 80.0, 3.0))])
def test_tell_refuses_numbers_that_it_does_not_know(arguments: tuple[Any, Any]) -> None:
    """A third number was left out silently."""
    with pytest.raises(InputError, match=r"a place \(x, y\)"):
        Locator(design(1), model=StandInModel()).tell(*arguments)
