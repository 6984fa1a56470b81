"""A pin or ring that touches the other block, too: what it does to gains and ratio lies within what is stated of them."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import InputError
from geometry.common.arrays import Floats
from probe_design.built_probe.bench import Bench, bench_from_dict
from probe_design.built_probe.block_predictions import compute_inner_fractions
from probe_design.built_probe.gain_checks import estimate_consistent_gains
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from tests.support.hw.benches import BENCH, shares

LOAD, NOISE = 10e-3, 1.5e-5  # N
TRUTH = np.array([[1.03, 0.012], [0.008, 0.97]])
FILMS = TRUTH @ (LOAD * np.array([0.4, 0.6]))  # what is read on soft tissue


def leaking(pin: float, ring: float, leak: float | None = None) -> tuple[Gains, tuple[str, ...]]:
    """Gains from readings that are exact but for what pin and ring leak; ``leak``: believed in, in place of the bench's."""
    bench = BENCH if leak is None else stated(leak)
    parts = compute_inner_fractions(shares().log_ratios, bench.reference)
    parts = parts + [{"inner": -pin, "outer": ring}.get(reference.on, 0.0) for reference in bench.reference]
    read = [TRUTH @ (LOAD * np.array([part, 1 - part])) for part in parts]
    pairs = zip(bench.reference, read, strict=True)
    seen = [Observation(reference, y, NOISE**2 * np.eye(2), LOAD, 1e-3 * LOAD) for reference, y in pairs]
    return estimate_consistent_gains(seen, shares(), bench) if leak is None else (estimate_gains(seen, shares(), bench), ())


def stated(leak: float) -> Bench:
    kept = [
        reference if reference.on == "tissue" else reference.model_copy(update={"leak": leak}) for reference in BENCH.reference
    ]
    return BENCH.model_copy(update={"reference": tuple(kept)})


def find_error(gains: Gains) -> Floats:
    """Errors of the ratio on tissue, of both cross-talks, over their standard deviations."""
    forces = gains.compute_forces(FILMS)
    slopes = np.array([1.0, -1.0]) / forces
    spread = np.sqrt(slopes @ gains.compute_forces_covariance(FILMS, np.zeros((2, 2))) @ slopes)
    cross = (gains.matrix - TRUTH).ravel()[[1, 2]] / np.sqrt(np.diag(gains.covariance))[[1, 2]]
    return np.array([np.log(forces[0] / forces[1] / (0.4 / 0.6)) / spread, *cross])


@pytest.mark.parametrize(("pin", "ring"), [(0.01, 0.0), (0.0, 0.01), (0.03, 0.0), (0.0, 0.03), (0.03, 0.03), (0.0, 0.0)])
def test_a_leak_lies_within_what_is_stated(pin: float, ring: float) -> None:
    gains, notes = leaking(pin, ring)
    assert np.abs(find_error(gains)).max() < 1.96
    assert sum("does it touch both blocks?" in note for note in notes) == (pin > 0.02) + (ring > 0.02)
    assert "does not state what fraction of their load pin" in notes[-1]


@pytest.mark.parametrize(("pin", "ring", "ratio", "cross"), [(0.0, 0.01, 2.0, 6.0), (0.01, 0.0, 1.5, 5.0)])
def test_taken_as_perfect_they_were_off_by_many_standard_deviations(pin: float, ring: float, ratio: float, cross: float) -> None:
    gains, _ = leaking(pin, ring, leak=0.0)
    assert abs(find_error(gains)[0]) > ratio
    assert np.abs(find_error(gains)).max() > cross


def test_a_pin_half_on_the_other_block_is_refused() -> None:
    with pytest.raises(InputError, match="pin on the inner block the others agree"):
        leaking(0.2, 0.0)


def test_leaks_belong_to_pins_and_rings() -> None:
    bench_table = {"reference": [{"youngs_modulus": "3 kPa", "leak": 0.01}]}
    with pytest.raises(InputError, match="given for a pin or a ring"):
        bench_from_dict(bench_table)
    assert [reference.leak_sd for reference in BENCH.reference] == [0.007, 0.007, 0, 0, 0, 0, 0]
