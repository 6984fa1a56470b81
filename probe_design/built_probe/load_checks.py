"""Check the load of a reading: compare the films' sum with the force channel and with the scene's load.

A wrong unit (millivolts for volts, a feedback capacitance in nF for pF, d33 of another film) scales both films by one factor:
their ratio looks right, and only the size of the load reveals it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.scene import Scene
from hw.signal.measure import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import CONTRADICTION_SD, SIGNIFICANT_SD, Bench
from probe_design.built_probe.block_predictions import LINEARITY_ACCURACY, BlockPredictions
from probe_design.built_probe.force_scale import ForceScale
from probe_design.built_probe.gain_matrix import Observation
from solver.planning.load_limits import find_largest_load
from solver.results.result import Result

IMPLAUSIBLE_FACTOR = 30.0  # between read and expected load, either way: a hand is never off by so much, most wrong units are
DOUBTFUL_FACTOR = 2.0  # likewise, beyond the reading's own uncertainty: from here on a warning reports it
SAFE_SHARE = 0.8  # of the largest load that linear elasticity allows on the softest block, which the printed protocol asks for
NEAR_DECADE = 0.25  # decades: largest distance at which a factor is taken for a power of ten
UNIT_SLIPS = {
    3: "Are millivolts taken as volts? Give the columns' unit, --column 'inner=NAME mV'.",
    -3: "Are volts taken as millivolts? Give the columns' unit, --column 'inner=NAME V'.",
    1: "Is there a 10:1 probe factor of the oscilloscope, or a feedback capacitor of a tenth of what the bench says?",
    -1: "Is there a 1:10 probe factor of the oscilloscope, or a feedback capacitor ten times what the bench says?",
}


def check_expected(load: float, spread: float, low: float, high: float, source: str) -> list[str]:
    """Compare a load with the expected one; return a warning if it is doubtful.

    Parameters
    ----------
    load
        As read, N.
    spread
        Its relative standard deviation.
    low
        Minimum of the expected load, N, above 0.
    high
        Maximum of the expected load, N.
    source
        For messages: "both films show", with the reading's name if there are several.

    Raises
    ------
    InputError
        The load is 30 times too large or too small.
    """
    nearest = min(max(load, low), high)
    factor = load / nearest
    if not 1 / IMPLAUSIBLE_FACTOR < factor < IMPLAUSIBLE_FACTOR:
        raise InputError(
            "load read", Words(_describe_load(load, nearest, source)), f"1/30 to 30 times that. {describe_remedy(factor)}"
        )
    if DOUBTFUL_FACTOR * math.exp(SIGNIFICANT_SD * min(spread, 1.0)) < max(factor, 1 / factor):
        return [f"{_describe_load(load, nearest, source)}. {describe_remedy(factor)}"]
    return []


def describe_remedy(factor: float) -> str:
    """Describe the likely cause, and the remedy, of films that show ``factor`` times the expected load."""
    decade = math.log10(factor) if 0 < factor < math.inf else math.inf
    power_of_ten = round(decade) if abs(decade) < 20 else 0
    likely = UNIT_SLIPS.get(power_of_ten, "") if abs(decade - power_of_ten) < NEAR_DECADE else ""
    places = "units of the columns, the bench's [force] sensitivity and [amplifier] capacitance, d31 to d33 of [probe.film]"
    return f"{likely}{' ' if likely else ''}Check the {places}, or write the load that was pressed into [load] of the scene"


def check_scene_load(
    total: tuple[float, float], measurement: Measurement, scene: Scene, predicted: Result, scale: ForceScale
) -> list[str]:
    """Compare the load of a reading with the scene's, by the force channel or else by the films' sum.

    Parameters
    ----------
    total
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
        The load is 30 times too large or too small, or would press the probe through the tissue of a scene without load.
    """
    load, spread = (total[0], total[1] / max(abs(total[0]), 1e-300))
    source = "both films show"
    if measurement.force is not None:
        load, spread, source = measurement.force / scale.factor, 0.0, "the force channel shows"
    expected = compute_expected_load(scene, predicted)
    if expected is None:
        _check_depth(load, scene, predicted, source)
        return []
    return check_expected(load, spread, expected, expected, source)


def check_reference_loads(observed: Sequence[Observation], shares: BlockPredictions, scene: Scene) -> list[str]:
    """Compare the loads on references with the expected ones: the scene's load, or less where a block allows less.

    Parameters
    ----------
    observed
        Readings on references.
    shares
        Predictions for the blocks of tissue, for their load limits.
    scene
        For its load.

    Raises
    ------
    InputError
        A load is 30 times too large or too small.
    """
    limits = [
        find_largest_load(item.rule, LINEARITY_ACCURACY, promise=False).force for item in shares.blocks if item.rule is not None
    ]
    high = compute_expected_load(scene) or max(limits, default=None)
    if high is None:
        return []
    low = min([high, *(SAFE_SHARE * item for item in limits)])
    doubtful = {item.reference.name: warning for item in observed if (warning := _check_reference(item, low, high))}
    return [f"{', '.join(doubtful)}: {next(iter(doubtful.values()))}"] if doubtful else []


def _check_reference(observation: Observation, low: float, high: float) -> str:
    """Return a warning or ""; an error names the reference. A contradiction with the force channel is left to the fit."""
    if (
        observation.force is not None
        and not 1 / DOUBTFUL_FACTOR < observation.films.sum() / max(observation.force, 1e-300) < DOUBTFUL_FACTOR
    ):
        return ""
    known = observation.reference.known_force
    bounds = (low, high) if known is None else (known, known)
    source = "both films show" if observation.force is None else "the force channel shows"
    try:
        return "".join(check_expected(observation.load, 0.0, *bounds, source))
    except InputError as fault:
        raise InputError(f"{observation.reference.name}: {fault.key}", fault.value, fault.allowed) from None


def check_pressed(load: float, scene: Scene, bench: Bench) -> None:
    """Refuse a load, N, that is 30 times the largest expected one, so that a wrong unit is reported before its consequences.

    Raises
    ------
    InputError
        The load is too large.
    """
    expected = compute_expected_load(scene)
    if expected is not None:
        max_load = max([expected, *(reference.known_force or 0.0 for reference in bench.reference)])
        check_expected(load, 0.0, min(load, max_load), max_load, "both films show")


def apply_loads(
    shares: BlockPredictions, observed: Sequence[Observation], doubts: Sequence[str], linear: bool
) -> BlockPredictions:
    """Return the predictions under the loads that were read; an error for too large a load includes the doubts on it.

    Parameters
    ----------
    shares
        Predictions for the blocks of tissue.
    observed
        Readings on references.
    doubts
        The warnings of ``check_reference_loads``.
    linear
        See ``BlockPrediction.apply_force``.

    Raises
    ------
    Refusal
        A load is above the limit of linear elasticity.
    """
    try:
        return shares.apply_forces(
            [observation.load for observation in observed], [observation.reference for observation in observed], linear
        )
    except Refusal as fault:
        raise Refusal(fault.key, fault.value, "; ".join([fault.allowed, *doubts])) from None


def compute_expected_load(scene: Scene, predicted: Result | None = None) -> float | None:
    """Return the amplitude of the scene's load, N; None if it is 0, or an indentation of unknown stiffness."""
    force, indentation = scene.load.force, scene.load.indentation
    if force is None and predicted is not None and predicted.stiffness is not None and indentation is not None:
        force = predicted.stiffness * indentation
    return force or None


def check_film_sum(total: tuple[float, float], measurement: Measurement, bench: Bench, scale: ForceScale) -> list[str]:
    """Compare both films' sum with the force channel, since the films carry the whole load; return warnings.

    ``total`` is the sum and its standard deviation, N, without the error shared with the force channel by a calibration.

    Raises
    ------
    Flawed
        They differ by more than five standard deviations.
    InputError
        One is 30 times the other.
    """
    if measurement.force is None or measurement.force_sd is None or bench.force is None:
        return []
    force = measurement.force / scale.factor
    tolerance = math.hypot(bench.force.tolerance, measurement.force_doubt)
    difference_sd = abs(total[0] - force) / math.hypot(total[1], measurement.force_sd, tolerance * force)
    text = f"both films show {total[0]:.4g} N, the force channel {force:.4g} N, {difference_sd:.2g} standard deviations apart"
    factor = total[0] / force if force > 0 else math.inf
    if factor > IMPLAUSIBLE_FACTOR or 0 < factor < 1 / IMPLAUSIBLE_FACTOR:
        raise InputError("load read", Words(text), f"films and force channel that agree. {describe_remedy(factor)}")
    text = f"{text}: a film, amplifier or force sensor is not what bench and calibration say"
    if difference_sd > CONTRADICTION_SD:
        raise Flawed(text)
    return [text] if difference_sd > SIGNIFICANT_SD else []


def _check_depth(load: float, scene: Scene, predicted: Result, source: str) -> None:
    """Refuse a load that would press the probe through the tissue."""
    depth, stiffness = getattr(scene.tissue, "depth", None), predicted.stiffness  # a half-space has no depth
    if depth is None or not stiffness or load < stiffness * depth:
        return
    max_load = stiffness * depth
    allowed = f"up to {max_load:.3g} N, which would press the probe through the tissue. {describe_remedy(load / max_load)}"
    raise InputError("load read", Words(f"{source} {load:.3g} N"), allowed)


def _describe_load(load: float, expected: float, source: str) -> str:
    times = load / expected
    size = f"{times:.3g} times" if times > 1 else f"1/{1 / times:.3g} of" if times > 0 else "not"
    return f"{source} {load:.3g} N, {size} the load of {expected:.3g} N that was to be pressed"
