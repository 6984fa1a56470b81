"""Sine fits and measurements of samples that are all there."""

from __future__ import annotations

from hw.common.samples import Samples
from hw.signal.amplifier import ChargeAmplifier
from hw.signal.measurement import Measurement, measure
from hw.signal.reading_fit import ReadingFit
from hw.signal.sine_fit import SineFit

AMPLIFIERS = (ChargeAmplifier(), ChargeAmplifier())


def fit_sine(samples: Samples, frequency: float) -> SineFit:
    return ReadingFit.from_samples(samples, frequency, force=True).fit()


def measure_samples(samples: Samples, frequency: float, sensitivity: float | None = None) -> Measurement:
    """Measure a reading behind the built-in amplifiers."""
    return measure(ReadingFit.from_samples(samples, frequency, sensitivity is not None), AMPLIFIERS, sensitivity)
