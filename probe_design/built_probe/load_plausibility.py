"""Check that the load of a reading is plausible: compare the films' sum with the force channel and with the scene's load.

A wrong unit (millivolts for volts, a feedback capacitance in nF for pF, d33 of another film) scales both films by one factor:
their ratio looks right, and only the size of the load reveals it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import CONTRADICTION_SD, SIGNIFICANT_SD, Bench
from probe_design.built_probe.block_predictions import BlockPredictions
from probe_design.built_probe.gains import ForceScale, Observation
from solver.results.result import Result

IMPLAUSIBLE_FACTOR = 30.0  # between read and expected load, either way: a hand is never off by so much, most wrong units are
SUSPECT_FACTOR = 2.0  # likewise, beyond the reading's own uncertainty: from here on a warning reports it
MAX_DISTANCE_DECADES = 0.25  # at which a factor is taken for a power of ten
UNIT_SLIPS = {  # by the power of ten
    3: "Are millivolts taken as volts? Give the columns' unit, --column 'inner=NAME mV' (column={'inner': 'NAME mV'}).",
    -3: "Are volts taken as millivolts? Give the columns' unit, --column 'inner=NAME V' (column={'inner': 'NAME V'}).",
    1: "Is there a 10:1 probe factor of the oscilloscope, or a feedback capacitor of a tenth of what the bench says?",
    -1: "Is there a 1:10 probe factor of the oscilloscope, or a feedback capacitor ten times what the bench says?",
}
FILMS_SHOW, FORCE_CHANNEL_SHOWS = "both films show", "the force channel shows"


def check_expected(load: float, relative_sd: float, low: float, high: float, source: str) -> list[str]:
    """Compare a load with the expected one; return a warning if it is doubtful.

    Parameters
    ----------
    load
        As read, N.
    relative_sd
        Its relative standard deviation.
    low, high
        Limits of the expected load, N, above 0.
    source
        For messages: "both films show", with the reading's name if there are several.

    Raises
    ------
    InputError
        The load is too large or too small by ``IMPLAUSIBLE_FACTOR``.
    """
    nearest = min(max(load, low), high)  # expected load nearest to the one that was read
    factor = load / nearest
    size = f"{factor:.3g} times" if factor > 1 else f"1/{1 / factor:.3g} of" if factor > 0 else "not"
    text = f"{source} {load:.3g} N, {size} the load of {nearest:.3g} N that was to be pressed"
    if not 1 / IMPLAUSIBLE_FACTOR < factor < IMPLAUSIBLE_FACTOR:
        raise InputError("load read", Words(text), f"1/30 to 30 times that. {describe_remedy(factor)}")
    is_suspect = max(factor, 1 / factor) > SUSPECT_FACTOR * math.exp(SIGNIFICANT_SD * min(relative_sd, 1.0))
    return [f"{text}. {describe_remedy(factor)}"] if is_suspect else []


def describe_remedy(factor: float) -> str:
    """Describe the likely cause, and the remedy, of films that show ``factor`` times the expected load."""
    decades = math.log10(factor) if 0 < factor < math.inf else math.inf
    power = round(decades) if abs(decades) < 20 else 0  # no unit is wrong by so much, and infinity cannot be rounded
    likely = f"{UNIT_SLIPS[power]} " if power in UNIT_SLIPS and abs(decades - power) < MAX_DISTANCE_DECADES else ""
    places = "units of the columns, the bench's [force] sensitivity and [amplifier] capacitance, d31 to d33 of [probe.film]"
    return f"{likely}Check the {places}, or write the load that was pressed into [load] of the scene"


def check_scene_load(
    films_sum: float, films_sum_sd: float, measurement: Measurement, scene: Scene, predicted: Result, *, scale: ForceScale
) -> list[str]:
    """Compare the load of a reading with the scene's, by the force channel or else by the films' sum.

    Parameters
    ----------
    films_sum, films_sum_sd
        Sum of both films' forces and its standard deviation, N.
    measurement
        For the force channel.
    scene
        For its load.
    predicted
        For the stiffness, where the scene has an indentation.
    scale
        The force channel's scale of a calibration.

    Raises
    ------
    InputError
        The load is too large or too small by ``IMPLAUSIBLE_FACTOR``, or, if the scene has no load, would press the probe through
        the tissue.
    """
    if measurement.force is None:
        # 1e-300: a sum of 0 gives a large number, not a division by zero
        load, relative_sd, source = films_sum, films_sum_sd / max(abs(films_sum), 1e-300), FILMS_SHOW
    else:
        load, relative_sd, source = measurement.force / scale.factor, 0.0, FORCE_CHANNEL_SHOWS
    expected = compute_expected_load(scene, predicted)
    if expected is not None:
        return check_expected(load, relative_sd, expected, expected, source)
    depth = getattr(scene.tissue, "depth", None)  # a half-space has no depth
    max_load = math.inf if depth is None or not predicted.stiffness else predicted.stiffness * depth
    if load >= max_load:
        through = f"up to {max_load:.3g} N, which would press the probe through the tissue"
        raise InputError("load read", Words(f"{source} {load:.3g} N"), f"{through}. {describe_remedy(load / max_load)}")
    return []


def check_reference_loads(observations: Sequence[Observation], predictions: BlockPredictions, scene: Scene) -> list[str]:
    """Compare the loads on references with the expected ones: the scene's load, or less where a block allows less.

    Parameters
    ----------
    observations
        Readings on references.
    predictions
        For the blocks of tissue, for their load limits.
    scene
        For its load.

    Raises
    ------
    InputError
        A load is too large or too small by ``IMPLAUSIBLE_FACTOR``.
    """
    limits = predictions.list_reference_loads()
    high = compute_expected_load(scene) or max(limits, default=None)
    if high is None:
        return []
    low = min([high, *limits])
    warnings = {item.reference.name: text for item in observations for text in _check_reference_load(item, low, high)}
    return [f"{', '.join(warnings)}: {next(iter(warnings.values()))}"] if warnings else []


def _check_reference_load(observation: Observation, low: float, high: float) -> list[str]:
    """Compare the load on one reference with the expected one, ``low`` to ``high``, N; return a warning if it is doubtful.

    An error names the reference. Where the films contradict the force channel, the fit of the gains reports it.
    """
    source = FILMS_SHOW
    if observation.force is not None:
        factor, source = observation.films.sum() / max(observation.force, 1e-300), FORCE_CHANNEL_SHOWS  # a force may be 0
        if not 1 / SUSPECT_FACTOR < factor < SUSPECT_FACTOR:
            return []
    known = observation.reference.known_force
    try:
        return check_expected(observation.load, 0.0, known or low, known or high, source)
    except InputError as error:
        raise InputError(f"{observation.reference.name}: {error.key}", error.value, error.allowed) from None


def check_pressed(load: float, scene: Scene, bench: Bench) -> None:
    """Refuse a load, N, far above the largest expected one, so that a wrong unit is reported before its consequences.

    Raises
    ------
    InputError
        The load is too large.
    """
    expected = compute_expected_load(scene)
    if expected is not None:
        max_load = max([expected, *(reference.known_force or 0.0 for reference in bench.reference)])
        check_expected(load, 0.0, min(load, max_load), max_load, FILMS_SHOW)  # no lower limit: only too large a load is refused


def compute_expected_load(scene: Scene, predicted: Result | None = None) -> float | None:
    """Return the amplitude of the scene's load, N; None if it is 0, or an indentation of unknown stiffness."""
    force, indentation = scene.load.amplitude, scene.load.indentation
    if force is None and predicted is not None and predicted.stiffness is not None and indentation is not None:
        force = predicted.stiffness * indentation
    return force or None


def check_film_sum(films_sum: float, films_sum_sd: float, measurement: Measurement, bench: Bench, scale: ForceScale) -> list[str]:
    """Compare both films' sum with the force channel, since the films carry the whole load; return warnings.

    Parameters
    ----------
    films_sum, films_sum_sd
        Sum of both films' forces, N, and its standard deviation. The latter leaves out the error that a calibration shares with
        the force channel.
    measurement
        For the force channel.
    bench
        For its tolerance.
    scale
        The force channel's scale of a calibration.

    Raises
    ------
    Flawed
        They differ by more than ``CONTRADICTION_SD`` standard deviations.
    InputError
        One is ``IMPLAUSIBLE_FACTOR`` times the other.
    """
    if measurement.force is None or measurement.force_sd is None or bench.force is None:
        return []
    force = measurement.force / scale.factor
    relative_tolerance = math.hypot(bench.force.tolerance, measurement.force_loss)
    difference_sd = abs(films_sum - force) / math.hypot(films_sum_sd, measurement.force_sd, relative_tolerance * force)
    text = f"both films show {films_sum:.4g} N, the force channel {force:.4g} N, {difference_sd:.2g} standard deviations apart"
    factor = films_sum / force if force > 0 else math.inf
    if factor > IMPLAUSIBLE_FACTOR or 0 < factor < 1 / IMPLAUSIBLE_FACTOR:
        raise InputError("load read", Words(text), f"films and force channel that agree. {describe_remedy(factor)}")
    text = f"{text}: a film, amplifier or force sensor is not what bench and calibration say"
    if difference_sd > CONTRADICTION_SD:
        raise Flawed(text)
    return [text] if difference_sd > SIGNIFICANT_SD else []
