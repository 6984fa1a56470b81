"""Evaluate one reading of the probe: from samples to film forces in newtons of nominal gain, and the films' warming."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from hw.common.samples import Samples
from hw.signal.measure import FILMS, Measurement, checked, measure, measured
from hw.signal.running import RunningFit
from hw.signal.waveform import Flawed
from probe_design.built_probe.amplifier_responses import with_own_amplifiers, with_rate_doubt
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.gain_matrix import Observed
from probe_design.built_probe.load_checks import check_pressed
from probe_design.built_probe.phase_lags import with_force_lag
from probe_design.built_probe.virtual_probe import charge_per_force

PYROELECTRIC = 30e-6  # C / (m^2 K), PHYSICS.md section 6: of PVDF


def reading(samples: Samples, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Measure a reading; gaps and saturated samples are counted and left out. Raises ``HardwareError``."""
    sensitivity = None if bench.force is None else bench.force.sensitivity
    measurement = measure(samples, bench.amplifier.built(), bench.load.frequency, sensitivity, calibrated_at)
    return _corrected(measurement, bench, calibrated_at)


def running_reading(running: RunningFit, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Measure a reading that was fitted while it came; see ``measure_reading``. Raises ``HardwareError``."""
    sensitivity = None if bench.force is None else bench.force.sensitivity
    measurement = measured(running.fit(), running.losses, bench.amplifier.built(), sensitivity, calibrated_at)
    return _corrected(measurement, bench, calibrated_at)


def _corrected(measurement: Measurement, bench: Bench, calibrated_at: float | None) -> Measurement:
    """Divide by each film's own amplifier response, and add the errors of the force channel's lag and the sampling rate."""
    behind_own = with_own_amplifiers(measurement, bench.amplifier, calibrated_at)
    return with_rate_doubt(with_force_lag(behind_own, bench), bench, calibrated_at)


def strict_reading(samples: Samples, bench: Bench, scene: Scene) -> Measurement:
    """Measure a reading for a calibration or a check, which allow no losses.

    Raises:
        HardwareError: the reading has gaps, saturation, too few cycles, no load, or a drift of temperature.
        InputError: the load is 30 times the expected one.
    """
    measurement = checked(reading(samples.whole(), bench), bench.load.least_cycles)
    check_pressed(float(newtons(measurement, scene)[0].sum()), scene, bench)
    warmed = warming(measurement, bench, scene.probe)
    worst = int(np.argmax(warmed))
    if warmed[worst] > bench.load.most_warming:
        worth = warmed[worst] * newtons_per_kelvin(scene)[worst]
        raise Flawed(
            f"film {FILMS[worst]} warmed by up to {warmed[worst]:.2g} K during the reading, worth {worth:.2g} N; at most "
            f"{bench.load.most_warming:g} K is allowed: wait until the temperature is steady, or null the amplifier's offset"
        )
    return measurement


def observed(measurement: Measurement, reference: Reference, scene: Scene) -> Observed:
    """Build the observation of a reference from its measurement, in newtons of nominal gain."""
    films, covariance = newtons(measurement, scene)
    return Observed(reference, films, covariance, measurement.force, measurement.force_sd, measurement.force_doubt)


def newtons(measurement: Measurement, scene: Scene, tolerance: bool = False) -> tuple[Floats, Floats]:
    """Return both films' charges over the nominal charge per force, N, (2,), and their covariance, N^2, (2, 2).

    Args:
        measurement: of both films.
        scene: for its film.
        tolerance: whether the covariance includes the tolerances of the amplifiers' parts.
    """
    per_newton = abs(charge_per_force(scene))
    if per_newton == 0:
        raise InputError("probe.film.d33", Words("no charge per force"), "psi1 d31 + psi2 d32 + d33 other than 0")
    spread = measurement.in_phase_covariance + (measurement.in_phase_tolerance if tolerance else 0.0)
    return measurement.in_phase / per_newton, spread / per_newton**2


def warming(measurement: Measurement, bench: Bench, probe: Probe) -> Floats:
    """Return an upper bound of each film's change of temperature during a reading, K, shape (2,).

    p is the pyroelectric coefficient, A the film's area, T its temperature, Rf, Cf and tau those of the amplifier.
    A steady rate leaves p A dT/dt through the feedback resistor, an offset V = Rf p A dT/dt; a change within tau the charge
    p A dT, a drift V = p A dT / Cf (BP.3). The electronics' own offset adds to them, so that this is a bound.
    """
    areas = PYROELECTRIC * np.array([probe.inner_area, probe.outer_area])
    resistance, capacitance = np.array([[one.resistance, one.capacitance] for one in bench.amplifier.of_films()]).T
    steady = np.abs(measurement.fit.offsets[:2]) * measurement.fit.seconds / (resistance * areas)
    return np.asarray(steady + measurement.fit.drift[:2] * capacitance / areas)


def newtons_per_kelvin(scene: Scene) -> Floats:
    """Return the force on each film whose charge equals that of warming it by 1 K, N/K, shape (2,)."""
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    return np.asarray(PYROELECTRIC * areas / abs(charge_per_force(scene)))
