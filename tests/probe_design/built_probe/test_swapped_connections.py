"""Calibrations with mistakes: what is exchanged, dead or half plugged is named, and no record is written of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from geometry import InputError
from geometry.scenes.variables import list_values
from hw.common.samples import Samples
from probe_design.built_probe.block_predictions import predict_blocks
from probe_design.built_probe.calibration import Calibration
from probe_design.built_probe.swapped_connections import check_films, find_dead_film
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, calibrate, films, sampled, scene, shares
from tests.support.slow import slow_unless

NAMES = [reference.name for reference in BENCH.reference]
Careless = Callable[[list[Samples]], list[Samples]]


@cache
def readings(blocks: tuple[float, ...] | None = None) -> list[Samples]:
    """One on each reference, 450 samples each; ``blocks``: ln(F_inner / F_outer) on them."""
    forces = films(np.array(shares().log_ratios if blocks is None else blocks))
    return [
        sampled(build_signals(BuiltProperties(), BENCH, scene(), force, [21, k]), rows=850, rate=200.0)
        for k, force in enumerate(forces)
    ]


def in_order(*order: int) -> Careless:
    return lambda samples: [samples[k] for k in order]


def scaled(*factors: float, index: int | None = None) -> Careless:
    """Channels' volts times factors, in one reading or all."""
    return lambda samples: [
        replace(reading, volts=reading.volts * factors) if index in (None, k) else reading for k, reading in enumerate(samples)
    ]


def cables(samples: list[Samples]) -> list[Samples]:
    return [replace(reading, volts=reading.volts[:, [1, 0, 2]]) for reading in samples]


def calibrated(samples: list[Samples], force: bool = True) -> Calibration:
    if not force:
        samples = [
            replace(reading, channels=reading.channels[:2], volts=reading.volts[:, :2], saturated=reading.saturated[:, :2])
            for reading in samples
        ]
    return calibrate(scene(), BENCH, samples, shares())


def refused(careless: Careless, force: bool = True) -> str:
    with pytest.raises(InputError) as fault:
        calibrated(careless(readings()), force)
    assert "\n" not in str(fault.value)
    return str(fault.value)


@pytest.mark.parametrize("force", slow_unless(lambda force: force, [True, False]))
def test_pin_and_ring_in_the_wrong_order(force: bool) -> None:
    words = refused(in_order(1, 0, 2, 3, 4, 5, 6), force)
    assert f"exchanged are: the {NAMES[0]} and the {NAMES[1]}; put it right" in words


@pytest.mark.parametrize("force", slow_unless(lambda force: force, [True, False]))
def test_films_on_exchanged_cables(force: bool) -> None:
    assert "exchanged are: the films' channels (cables); put it right" in refused(cables, force)


@pytest.mark.parametrize(
    ("first", "second"), slow_unless(lambda pair: pair == (3, 5), [*combinations(range(2, 7), 2), (0, 4), (1, 6)])
)
def test_exchanged_references(first: int, second: int) -> None:
    order = list(range(7))
    order[first], order[second] = second, first
    assert f"exchanged are: the {NAMES[first]} and the {NAMES[second]}; put it right" in refused(in_order(*order))


@pytest.mark.slow
def test_two_exchanges_at_once() -> None:
    words = refused(lambda samples: cables(in_order(1, 0, 2, 3, 4, 5, 6)(samples)))
    assert f"the films' channels (cables); besides, the {NAMES[0]} and the {NAMES[1]}" in words


@pytest.mark.slow
@pytest.mark.parametrize("order", [(0, 1, 6, 5, 4, 3, 2), (2, 3, 4, 5, 6, 0, 1)])
def test_another_order_is_told(order: tuple[int, ...]) -> None:
    """Blocks from the hardest, or pin and ring last."""
    assert f"the order, which was: {', '.join(NAMES[k] for k in order)};" in refused(in_order(*order))


@pytest.mark.parametrize(
    ("careless", "words"),
    [
        (scaled(1e-4, 1.0, 1.0), "nothing on the inner film"),
        (scaled(1.0, 1e-4, 1.0), "nothing on the outer film"),
        (scaled(-1.0, 1.0, 1.0), "opposite sign"),
        (scaled(0.5, 1.0, 1.0), "inner 0.51"),
        (scaled(1.0, 1.0, 0.5), "is the force channel plugged in"),
        (scaled(1.0, 1.0, 1e-3), "is the force channel plugged in"),
    ],
)
def test_what_is_dead_reversed_or_half_plugged_is_named(careless: Careless, words: str) -> None:
    assert words in refused(careless)


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1])
def test_one_reading_that_is_half_plugged_is_named(index: int) -> None:
    assert f"without the reading on the {NAMES[index]} the others agree" in refused(scaled(0.5, 1.0, 1.0, index=index))


@pytest.mark.slow
def test_a_reference_pressed_twice_is_named() -> None:
    """The 3 kPa block in place of the 6 kPa one: without a force channel nothing else determines the gains."""
    words = refused(in_order(0, 1, 2, 2, 4, 5, 6), force=False)
    assert f"without the reading on the {NAMES[3]} the others agree" in words


@pytest.mark.slow
def test_a_probe_off_its_drawing_is_calibrated_by_pin_and_ring() -> None:
    """Blocks of an outer modulus 30 % too high contradict their predictions; M does not depend on them."""
    name = "probe.outer.youngs_modulus"
    log_ratios = predict_blocks(scene().replace({name: 1.3 * list_values(scene())[name]}), BENCH.reference).log_ratios
    fitted = calibrated(readings(tuple(log_ratios)))
    assert "blocks contradict" in fitted.warnings[0]
    spread = np.sqrt(np.diag(fitted.gains.covariance))
    truth = np.array([1.04 / 1.01, 0.012 / 1.01, 0.008 / 0.985, 0.96 / 0.985])  # gains of films over those of capacitors
    assert np.all(np.abs(fitted.gains.matrix.ravel() - truth) < 3.5 * spread)
    # 4 films and 2 forces, the force channel's error and two cross-talks, of 7 unknowns
    assert fitted.gains.degrees_of_freedom == 2
    assert np.all(fitted.gains.slopes == 0)


def scale_each(factors: Callable[[float], list[float]]) -> Careless:
    """Channels' volts times factors that depend on how far the calibration is, from 0 to 1."""
    return lambda samples: [replace(reading, volts=reading.volts * factors(k / 6)) for k, reading in enumerate(samples)]


@pytest.mark.parametrize(
    "careless",
    [
        pytest.param(scale_each(lambda t: [1, 1, 1.05 if t < 0.3 else 1]), id="force sensor pushed after the ring"),
        pytest.param(scale_each(lambda t: [1, 1, 1 - 0.1 * t]), id="force sensor drifts", marks=pytest.mark.slow),
        pytest.param(scale_each(lambda t: [1.025 if t else 1, 1, 1]), id="film 5 K warmer after the pin", marks=pytest.mark.slow),
        pytest.param(scale_each(lambda t: [1 - 0.03 * t, 1, 1]), id="film depolarises"),
    ],
)
def test_what_no_prediction_explains_is_not_blamed_on_the_blocks(careless: Careless) -> None:
    """The sum of both films' forces contradicts the force channel, whatever the probe is: gains came out up to 9 sd off."""
    assert "readings that agree with each other" in refused(careless)


def test_a_force_sensor_of_a_wrong_sensitivity_is_told_from_the_films() -> None:
    """20 % on both alike, each alone within four standard deviations of what the bench states of a film."""
    assert "look at the force channel's sensitivity" in refused(scaled(1.0, 1.0, 1.19))


def test_films_that_feel_each_other_s_load_are_not_dead() -> None:
    swapped, right = np.array([[0.01, 1.0], [1.0, 0.01]]), np.array([[1.0, 0.01], [0.01, 1.0]])
    assert find_dead_film(swapped, np.array([1.0, 0.0])) is None
    assert find_dead_film(right, np.array([1.0, 0.0])) is None
    assert find_dead_film(right * [0.0, 1.0], np.array([1.0, 0.0])) == "inner"
    assert find_dead_film(np.array([[0.5, 1e-3]]), np.array([0.4])) == "outer"


@pytest.mark.parametrize(("noise", "words"), [(0.001, "opposite sign"), (0.05, "a charge of the outer film below its noise")])
def test_a_film_below_its_noise_is_not_taken_for_reversed(noise: float, words: str) -> None:
    """The sign of a charge that does not stand out is chance."""
    pressed, expected = np.array([[1.0, 0.2], [1.0, -0.01]]), np.array([0.8, 0.99])
    with pytest.raises(InputError, match=words):
        check_films(pressed, expected, np.full((2, 2), noise))
