"""Compare stated and true errors of the ratio, reading by reading.

    nice python -m benchmarks.readings.coverage [--draws N]

A row counts what came of a fault: how many readings were refused; of the others, how many had a warning, the root
mean square of error over stated standard deviation, the largest, and the stated standard deviation.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmarks.readings.faults import AMPLIFIER, FAULTS, FREQUENCY, SENSITIVITY, TRUTH, good
from hw.common.errors import HardwareError
from hw.common.samples import Samples
from hw.signal.covariance import propagate_covariance
from hw.signal.measurement import measure
from hw.signal.reading_fit import ReadingFit


@dataclass(frozen=True)
class FaultOutcome:
    """What came of one fault.

    Attributes
    ----------
    refused
        How many readings.
    z
        Errors of the others over their stated standard deviations.
    stated
        Their stated standard deviations, relative.
    reason
        Of the last refusal.
    """

    refused: int
    z: list[float]
    stated: list[float]
    reason: str


def measure_charge_ratio(samples: Samples) -> tuple[float, float]:
    """Return the ratio of the charges' parts in phase and its standard deviation. Raises ``HardwareError``."""
    measured = measure(ReadingFit.from_samples(samples, round(FREQUENCY), force=True), (AMPLIFIER, AMPLIFIER), SENSITIVITY)
    spread = propagate_covariance(lambda x: x[:1] / x[1:], measured.in_phase, measured.in_phase_covariance)
    return float(measured.in_phase[0] / measured.in_phase[1]), float(np.sqrt(spread[0, 0]))


def outcome(name: str, draws: int) -> FaultOutcome:
    """Return what comes of a fault in so many readings."""
    z, stated, refused, reason = [], [], 0, ""
    for seed in range(draws):
        random = np.random.default_rng([seed, 5])
        try:
            ratio, spread = measure_charge_ratio(FAULTS[name](good(random), random))
        except HardwareError as fault:
            refused, reason = refused + 1, str(fault)
            continue
        z.append((ratio - TRUTH) / spread)
        stated.append(spread / abs(ratio))
    return FaultOutcome(refused, z, stated, reason)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--only", default="", help="faults whose names hold this")
    given = parser.parse_args()
    print(f"{'':34} refused   rms z   max z   stated sd")
    for name in (fault_name for fault_name in FAULTS if given.only in fault_name):
        result = outcome(name, given.draws)
        left = f"{'-':>7} {'-':>7} {'-':>9}  {result.reason[:90]}"
        if result.z:
            rms, largest = np.sqrt(np.mean(np.square(result.z))), np.abs(result.z).max()
            left = f"{rms:7.2f} {largest:7.2f} {100 * median(result.stated):9.3f} %"
        print(f"{name:34} {result.refused:7d} {left}", flush=True)


if __name__ == "__main__":
    main()
