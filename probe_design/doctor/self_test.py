"""Test a probe's channels: noise, polarity, load, clipping, mains and lost samples, each as a finding."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry.common.errors import ProbeError
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from hw.common.samples import Floats, Samples
from hw.signal.amplifier import TooSlow
from hw.signal.sine_fit import NoSine, SineFit, check_rate, fit_stretch
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.reading import predict_scene
from probe_design.built_probe.reference_charges import compute_charge_units
from probe_design.doctor.finding import Finding

BOLTZMANN_CONSTANT, ROOM_TEMPERATURE_K = 1.380649e-23, 295.0  # J/K, K
MIN_NOISE_RATIO, MAX_NOISE_RATIO = 0.5, 20.0  # times the expected noise
NOISE_STRENGTH, CLEAR_STRENGTH = (
    6.0,
    20.0,
)  # amplitude of the load over its standard deviation: limit of noise; enough for a calibration
MAX_HUM_RATIO = 10.0  # times the load's amplitude from which the mains are reported
PHASE_TOLERANCE_RAD = 0.8  # rad: largest phase between films and force, except for the sign
PREDICTION_ACCURACY = 0.1  # relative accuracy: enough to decide whether a film must show the load
MIN_ROWS = 200
FLAT_FACTOR = 3.0  # times the fraction of samples that a sine has at its extremes


def run_self_test(samples: Samples, scene: Scene, bench: Bench) -> list[Finding]:
    """Test each channel on samples under the bench's load."""
    findings = [_check_losses(samples)]
    dead = [name for name, swing in zip(samples.channels, np.ptp(samples.volts, axis=0), strict=True) if not swing > 0]
    findings += [Finding(f"{name} channel", "fault", "shows no change", "connect it; is its amplifier on?") for name in dead]
    clipped = _check_clipping(samples)
    findings += clipped
    # the sinusoid is fitted only to enough samples and at least 3 periods of the load
    usable = int(np.count_nonzero(~samples.saturated.any(axis=1)))
    span = float(samples.times[-1] - samples.times[0]) * bench.load.frequency
    if dead or usable < MIN_ROWS or span < 3:
        text = f"{usable} samples that are not saturated, {span:.3g} cycles of {bench.load.frequency:g} Hz"
        remedy = f"at least {MIN_ROWS} samples and 3 cycles, of channels that all change"
        return findings if dead else [*findings, Finding("load", "fault", text, remedy)]
    try:
        check_rate(bench.load.frequency, samples.rate)
    except NoSine as fault:
        return [*findings, Finding("mains", "fault", str(fault), "another rate, or another frequency of the load")]
    try:
        fit = fit_stretch(samples, bench.load.frequency)
    except NoSine as fault:
        remedy = "is the load on, is the bench's frequency right?"
        return [*findings, *(Finding(f"load, {name}", "fault", str(fault), remedy) for name in samples.channels)]
    findings += [*_check_noise(samples, fit, bench), *_check_load(samples, fit, scene, bench)]
    return [*findings, *_check_polarity(samples, fit, scene, bench), _check_mains(samples, fit)]


def _check_losses(samples: Samples) -> Finding:
    """Check that no samples were lost."""
    if samples.overruns or samples.gaps:
        text = f"{len(samples.gaps)} gaps, {samples.overruns} overruns of the device"
        return Finding("samples", "doubtful", text, "a lower rate, another port or cable, no hub")
    if samples.notes:
        return Finding("samples", "doubtful", "; ".join(samples.notes), "read again")
    return Finding("samples", "good", f"{len(samples)} of {samples.rate:g} a second, none lost")


def _check_clipping(samples: Samples) -> list[Finding]:
    """Check that no channel is at the end of its range, nor cut off before it."""
    remedy = "press less, take a larger feedback capacitance or a larger range"
    findings = []
    for name, volts, saturated in zip(samples.channels, samples.volts.T, samples.saturated.T, strict=True):
        count = int(saturated.sum())
        if count:
            findings.append(Finding(f"clipping, {name}", "fault", f"{count} samples at the end of the range", remedy))
        elif (fraction := _measure_flat_fraction(volts)) > 0:
            text = f"{format_percent(fraction)} of the samples at its highest or lowest value: the wave is cut"
            findings.append(Finding(f"clipping, {name}", "fault", text, remedy))
    return findings or [Finding("clipping", "good", f"none; the largest voltage is {np.abs(samples.volts).max():.3g} V")]


def _measure_flat_fraction(volts: Floats) -> float:
    """Return the fraction of samples at the highest or lowest value if the wave seems to be cut off, otherwise 0.

    An uncut sine of amplitude A, in steps s of the converter, has the fraction arccos(1 - s / A) / pi within one step of an
    extreme. The wave counts as cut off if the fraction is above ``FLAT_FACTOR`` times this one plus 0.01, an allowance for noise.
    """
    swing = float(np.ptp(volts))
    if swing == 0:
        return 0.0
    expected = np.arccos(max(-1.0, 1 - 2 * max(_estimate_step(volts), 1e-12 * swing) / swing)) / np.pi
    fraction = max(np.mean(volts >= volts.max() - 1e-9 * swing), np.mean(volts <= volts.min() + 1e-9 * swing))
    return float(fraction) if fraction > FLAT_FACTOR * expected + 0.01 else 0.0


def _estimate_step(volts: Floats) -> float:
    """Return the converter's step, V: the smallest difference of two values; 0 if all are equal."""
    values = np.unique(volts[:20_000])  # so many samples contain neighbouring codes, and are sorted quickly
    return float(np.diff(values).min()) if len(values) > 1 else 0.0


def _check_noise(samples: Samples, fit: SineFit, bench: Bench) -> list[Finding]:
    """Compare each film's noise with its minimum.

    The minimum is the thermal (kT/C) noise of the amplifier's feedback together with the rounding of the converter, whose
    standard deviation is its step over the root of 12.
    """
    findings = []
    for k, name in enumerate(samples.channels[:2]):
        expected = float(
            np.hypot(
                # sqrt(kT / C): thermal noise of the feedback resistor, over all frequencies
                np.sqrt(BOLTZMANN_CONSTANT * ROOM_TEMPERATURE_K / bench.amplifier.build_films()[k].capacitance),
                _estimate_step(samples.volts[:, k]) / 12**0.5,
            )
        )
        noise_ratio = fit.noise[k] / expected
        text = f"{fit.noise[k]:.2g} V rms, {noise_ratio:.2g} times the minimum of resistor and converter, {expected:.2g} V"
        if noise_ratio < MIN_NOISE_RATIO:
            findings.append(Finding(f"noise, {name}", "fault", text, "too quiet: is the film connected, is anything averaged?"))
        elif noise_ratio > MAX_NOISE_RATIO:
            findings.append(Finding(f"noise, {name}", "doubtful", text, "shield film and cable, look for loose plugs"))
        else:
            findings.append(Finding(f"noise, {name}", "good", text))
    return findings


def _check_load(samples: Samples, fit: SineFit, scene: Scene, bench: Bench) -> list[Finding]:
    """Check that each channel shows the load clearly; a film that is hardly pressed by prediction is not a fault.

    Parameters
    ----------
    samples
        For the names of the channels.
    fit
        Of the load in all channels.
    scene
        For the predicted stresses.
    bench
        For the force channel's sensitivity.
    """
    findings = []
    strengths = _compute_strengths(fit)
    load_on = bool((strengths > CLEAR_STRENGTH).any())
    for name, strength, amplitude in zip(samples.channels, strengths, np.abs(fit.amplitudes), strict=True):
        text = f"{amplitude:.3g} V at {fit.frequency:.4g} Hz, {strength:.3g} times its standard deviation"
        if name == "force" and bench.force is not None:
            text += f": {amplitude / bench.force.sensitivity:.3g} N"
        if (
            strength < NOISE_STRENGTH
            and load_on
            and name in samples.channels[:2]
            and not _is_load_expected(samples.channels.index(name), fit, scene)
        ):
            findings.append(Finding(f"load, {name}", "doubtful", f"{text}: none, and hardly any is predicted", "press harder"))
        elif strength < NOISE_STRENGTH:
            remedy = "is the film connected?" if load_on else "is the load on, is the bench's frequency right?"
            findings.append(Finding(f"load, {name}", "fault", text, remedy))
        else:
            state: Any = "good" if strength > CLEAR_STRENGTH else "doubtful"
            findings.append(Finding(f"load, {name}", state, text, "" if state == "good" else "press harder, or read longer"))
    return findings


def _is_load_expected(film: int, fit: SineFit, scene: Scene) -> bool:
    """Whether one film, 0 inner or 1 outer, must show the load clearly, by prediction and the other film's amplitude.

    Without a prediction it must.
    """
    try:
        result = predict_scene(scene, PREDICTION_ACCURACY, linear=True)
    except ProbeError:
        return True
    if result.stress_inner is None or result.stress_outer is None:
        return True
    forces = np.abs([result.stress_inner * scene.probe.inner_area, result.stress_outer * scene.probe.outer_area])
    amplitude = np.abs(fit.amplitudes[1 - film]) * forces[film] / max(forces[1 - film], np.finfo(float).tiny)
    return bool(amplitude > CLEAR_STRENGTH * _compute_deviations(fit)[film])


def _compute_deviations(fit: SineFit) -> Floats:
    """Return the standard deviations of the load's amplitudes, V, shape (channels,)."""
    return np.sqrt(np.diag(fit.covariance)[::2])


def _compute_strengths(fit: SineFit) -> Floats:
    """Return the load's amplitudes over their standard deviations, shape (channels,)."""
    return np.asarray(np.abs(fit.amplitudes) / np.maximum(_compute_deviations(fit), np.finfo(float).tiny))


def _check_polarity(samples: Samples, fit: SineFit, scene: Scene, bench: Bench) -> list[Finding]:
    """Compare sign and phase of each film with the force channel or, without one, of the inner film with the outer.

    With a force channel the sign of the film's charge per force counts, too: a load must give a charge of this sign.
    """
    strengths = _compute_strengths(fit)
    if (strengths[:2] < NOISE_STRENGTH).any():
        return [Finding("polarity", "doubtful", "cannot be determined without a load on both films")]
    # whether the sign of the load is known, from a force channel that shows it clearly
    known = "force" in samples.channels and bench.force is not None and strengths[2] > CLEAR_STRENGTH
    try:
        charges = fit.amplitudes[:2] / [amplifier.response(fit.frequency) for amplifier in bench.amplifier.build_films()]
    except TooSlow as fault:
        return [Finding("polarity", "fault", str(fault))]
    signs = np.sign(compute_charge_units(scene))
    films = signs * charges / (fit.amplitudes[2] if known else signs[1] * charges[1])
    reference = "the force" if known else "the outer film"
    findings = []
    for name, film in zip(samples.channels[: 2 if known else 1], films, strict=False):
        angle = float(np.angle(film))
        if abs(angle) < PHASE_TOLERANCE_RAD:
            findings.append(Finding(f"polarity, {name}", "good", f"{angle:.2g} rad from {reference}"))
        elif np.pi - abs(angle) < PHASE_TOLERANCE_RAD:
            remedy = f"exchange the leads of the {name} film" if known else "exchange the leads of one film"
            findings.append(Finding(f"polarity, {name}", "fault", f"opposite to {reference}", remedy))
        else:
            text = f"{angle:.2g} rad from {reference}: neither with nor against it"
            findings.append(Finding(f"polarity, {name}", "doubtful", text, "are channels delayed, is the tissue viscous?"))
    return findings


def _check_mains(samples: Samples, fit: SineFit) -> Finding:
    """Check that the mains are not much stronger than the load."""
    if samples.rate < 110:  # too slow for 50 Hz: twice that, and a tenth more
        return Finding("mains", "doubtful", f"not detectable at {samples.rate:g} samples a second", "more than 120 Hz")
    if fit.mains is None:
        return Finding("mains", "good", "none detected")
    worst = int(np.argmax(fit.hum[:2]))
    text = f"{fit.hum[worst]:.2g} V at {fit.mains:.4g} Hz on the {samples.channels[worst]} film"
    if fit.hum[worst] > MAX_HUM_RATIO * np.abs(fit.amplitudes[:2]).max():
        return Finding("mains", "doubtful", text, "shield film and cable, keep them off mains leads")
    return Finding("mains", "good", text)
