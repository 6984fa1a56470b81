"""Evaluate one reading of the probe: from samples to film forces in newtons of nominal gain, and the films' warming."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from hw.common.samples import FILM_NAMES, Samples
from hw.signal.measurement import Measurement, check_measurement, measure
from hw.signal.reading_fit import ReadingFit
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.gains import Observation
from probe_design.built_probe.load_plausibility import check_pressed
from probe_design.built_probe.reference_charges import compute_charge_units
from probe_design.built_probe.timing_errors import count_force_lag, count_rate_error

PYROELECTRIC_COEFFICIENT = 30e-6  # C / (m^2 K), PHYSICS.md section 6: of PVDF


def measure_samples(samples: Samples, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Measure a reading; gaps and saturated samples are counted and left out.

    Parameters
    ----------
    samples
        Of the channels.
    bench
        Of the reading.
    calibrated_at
        Frequency at which gains were calibrated, Hz, or None.

    Raises
    ------
    HardwareError
        As ``measure_reading``.
    """
    reading = ReadingFit.from_samples(samples, bench.load.frequency, bench.force is not None)
    return measure_reading(reading, bench, calibrated_at)


def measure_reading(reading: ReadingFit, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Measure a reading from its finished fit, and add the errors of the force channel's lag and of the sampling rate.

    Parameters
    ----------
    reading
        The fit, to which all samples have been added.
    bench
        Of the reading.
    calibrated_at
        Frequency at which gains were calibrated, Hz.

    Raises
    ------
    HardwareError
        No sinusoid can be fitted, the load is not steady or too slow for the amplifiers, or the force channel lags too much.
    """
    sensitivity = None if bench.force is None else bench.force.sensitivity
    measurement = measure(reading, bench.amplifier.build_films(), sensitivity, calibrated_at)
    return count_rate_error(count_force_lag(measurement, bench), bench, calibrated_at)


def measure_strict_reading(samples: Samples, bench: Bench, scene: Scene) -> Measurement:
    """Measure a reading for a calibration or a check, which allow no losses.

    Raises
    ------
    HardwareError
        The reading has gaps, saturation, too few cycles, no load, or a drift of temperature.
    InputError
        The load is ``IMPLAUSIBLE_FACTOR`` times the expected one.
    """
    measurement = check_measurement(measure_samples(samples.require_complete(), bench), bench.load.least_cycles)
    check_pressed(float(compute_film_forces(measurement, scene)[0].sum()), scene, bench)
    temperature_changes = bound_warming(measurement, bench, scene.probe)
    worst = int(np.argmax(temperature_changes))
    if temperature_changes[worst] > bench.load.most_warming:
        equivalent_force = temperature_changes[worst] * compute_newtons_per_kelvin(scene)[worst]
        raise Flawed(
            f"film {FILM_NAMES[worst]} warmed by up to {temperature_changes[worst]:.2g} K during the reading, worth "
            f"{equivalent_force:.2g} N; at most {bench.load.most_warming:g} K is allowed: "
            "wait until the temperature is steady, or null the amplifier's offset"
        )
    return measurement


def build_observation(measurement: Measurement, reference: Reference, scene: Scene) -> Observation:
    """Build the observation of a reference from its measurement, in newtons of nominal gain."""
    films, covariance = compute_film_forces(measurement, scene)
    return Observation(reference, films, covariance, measurement.force, measurement.force_sd, measurement.force_loss)


def compute_film_forces(measurement: Measurement, scene: Scene, tolerance: bool = False) -> tuple[Floats, Floats]:
    """Return both films' forces in newtons of nominal gain, shape (2,), and their covariance, N^2, shape (2, 2).

    These are the charges in phase with the load, divided by the nominal charge per force.

    Parameters
    ----------
    measurement
        Of both films.
    scene
        For its film.
    tolerance
        Whether the covariance includes the tolerances of the amplifiers' parts.
    """
    units = compute_charge_units(scene)
    if not units.all():
        raise InputError("probe.film.d33", Words("no charge per force"), "psi1 d31 + psi2 d32 + d33 other than 0")
    covariance = measurement.in_phase_covariance + (measurement.in_phase_tolerance if tolerance else 0.0)
    # charges in phase with their sum have its sign, whatever that of the films' units: the sum of the forces is positive
    per_newton = units * np.sign((measurement.in_phase / units).sum())
    return measurement.in_phase / per_newton, covariance / np.outer(units, units)


def bound_warming(measurement: Measurement, bench: Bench, probe: Probe) -> Floats:
    """Return an upper bound of each film's change of temperature during a reading, K, shape (2,).

    p is the pyroelectric coefficient, A the film's area, T its temperature, Rf, Cf and tau those of the amplifier.
    A steady rate leaves p A dT/dt through the feedback resistor, an offset V = Rf p A dT/dt; a change within tau the charge
    p A dT, a drift V = p A dT / Cf (BP.3). The electronics' own offset adds to them, so that this is a bound.
    """
    areas = PYROELECTRIC_COEFFICIENT * np.array([probe.inner_area, probe.outer_area])
    amplifiers = bench.amplifier.build_films()
    resistance, capacitance = np.array([(amplifier.resistance, amplifier.capacitance) for amplifier in amplifiers]).T
    # eq. BP.3: a steady rate, and a change within tau
    steady = np.abs(measurement.fit.offsets[:2]) * measurement.fit.seconds / (resistance * areas)
    return np.asarray(steady + measurement.fit.drift[:2] * capacitance / areas)


def compute_newtons_per_kelvin(scene: Scene) -> Floats:
    """Return for each film the force that gives the same charge as warming by 1 K, N/K, shape (2,)."""
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    return np.asarray(PYROELECTRIC_COEFFICIENT * areas / abs(compute_charge_units(scene)))
