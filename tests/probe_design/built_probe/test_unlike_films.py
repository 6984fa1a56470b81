"""Films that differ in their charge per force, read as forces: each by its own number, against charges by hand."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import Scene
from geometry.common.errors import InputError
from geometry.scenes.film import Film
from hw.signal.measurement import Measurement
from probe_design.built_probe.field_readings import parse_field_reading
from probe_design.built_probe.film_forces import compute_film_forces, measure_samples
from probe_design.built_probe.reading import compute_reading
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from solver.results.result import Result
from tests.probe_design.built_probe.test_field_readings import TOLD
from tests.support.hw.benches import BENCH, sampled, scene

FORCES = np.array([0.04, 0.06])  # N
PER_FORCE = -20e-12, -33e-12  # C/N, of inner and outer film: the paper's d33 and the maker's


def build_unlike(outer: float = PER_FORCE[1]) -> Scene:
    """The bench's scene with films of which each gives d33 per force."""
    film = Film.model_validate({"psi1": 0.0, "outer": {"d33": outer}})
    return scene().model_copy(update={"probe": scene().probe.model_copy(update={"film": film})})


def measure(unlike: Scene) -> Measurement:
    exact = BuiltProperties(gains=((1.0, 0.0), (0.0, 1.0)))
    return measure_samples(sampled(build_signals(exact, BENCH, unlike, FORCES, 1)), BENCH)


def test_each_film_has_its_own_charge_per_force() -> None:
    """Charges of the virtual probe, behind amplifiers within 5 %, against d33 F; forces against those that press."""
    unlike = build_unlike()
    measurement = measure(unlike)
    np.testing.assert_allclose(abs(measurement.charges), abs(np.array(PER_FORCE)) * FORCES, rtol=0.06)
    np.testing.assert_allclose(compute_film_forces(measurement, unlike)[0], FORCES, rtol=0.06)


def test_films_of_opposite_sign_are_both_pressed() -> None:
    """An outer film that lies upside down: its charge has the other sign, and more of it than the inner one's."""
    turned = build_unlike(33e-12)
    np.testing.assert_allclose(compute_film_forces(measure(turned), turned)[0], FORCES, rtol=0.06)


@pytest.mark.parametrize("observable", ["stress", "charge"])
def test_a_reading_is_the_ratio_that_the_scene_reads(observable: str) -> None:
    """The ratio of forces, or of charges, each over the block's area."""
    unlike = build_unlike().replace({"reading.observable": observable})
    reading = compute_reading(measure(unlike), unlike, BENCH, Result("none", 0.0))
    factors = np.array(PER_FORCE) if observable == "charge" else np.ones(2)
    inner, outer = factors * FORCES / [unlike.probe.inner_area, unlike.probe.outer_area]
    assert reading.ratio == pytest.approx(inner / outer, rel=0.08)
    assert reading.observable == observable


def test_a_reading_by_gains_of_films_with_bonds_says_what_it_leaves_out() -> None:
    """Beside psi or a stress that is asked for; not where the scene says nothing of bonds."""

    def list_warnings(film: dict[str, object], observable: str | None = None) -> list[str]:
        probe = scene().probe.model_copy(update={"film": Film.model_validate(film)})
        bonded = scene().model_copy(update={"probe": probe})
        bonded = bonded if observable is None else bonded.replace({"reading.observable": observable})
        warnings = compute_reading(measure(bonded), bonded, BENCH, Result("none", 0.0)).warnings
        return [text for text in warnings if "multiple of its force" in text]

    assert len(list_warnings({"bond_to_base": "tape-50um"}, "stress")) == 1
    assert len(list_warnings({"bond_to_base": "tape-50um", "psi1": 0.0})) == 1
    assert list_warnings({"psi1": 0.0}) == list_warnings({}) == []


def test_a_ratio_of_stresses_is_no_reading_of_charges() -> None:
    """Whatever the file says; files of older versions, which say nothing, hold ratios of stresses."""
    assert parse_field_reading(TOLD, "reading.json", scene()).ratio == TOLD["ratio"]
    assert parse_field_reading({**TOLD, "observable": "stress"}, "reading.json", scene()).ratio == TOLD["ratio"]
    with pytest.raises(InputError, match="observable = 'charge': allowed: a ratio of stresses, which the scene reads"):
        parse_field_reading({**TOLD, "observable": "charge"}, "reading.json", scene())
