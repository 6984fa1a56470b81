"""Loads at which the gap closes and linear elasticity ends: against solutions of other codes; curves of loads."""

from __future__ import annotations

import json

import numpy as np
import pytest

from geometry import Refusal, Scene, read_scene
from geometry.common.errors import InputError
from geometry.common.resources import Limits
from geometry.meridian.mesh_lines import MeridianFineness
from solver.axisymmetric.sections import build_sections
from solver.contact.limits import find_gap_closure_load
from solver.contact.load_curve import find_load_ends
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.evaluation import press
from tests.support.paths import REFERENCE

FOLDER = REFERENCE / "contact"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
EXAMPLE = read_scene(FOLDER / "example.toml")


def coarse(scene: Scene, order: int = 2) -> Path:
    scene_sections = build_sections(scene)
    return Path(
        ContactModel.from_section(scene_sections.section, scene_sections.materials, "bonded", MeridianFineness(1, 0, order)),
        sensitive=False,
    )


@pytest.mark.parametrize("name", ["paper", *(pytest.param(n, marks=pytest.mark.slow) for n in ("example", "equal-blocks-6kpa"))])
def test_the_gap_closes_where_other_codes_close_it(name: str) -> None:
    closure, expected = find_gap_closure_load(coarse(read_scene(FOLDER / f"{name}.toml"))), EXPECTED[name]
    assert closure is not None
    assert closure.by == "gap closure"
    assert closure.force == pytest.approx(
        expected["gap_closure_force"], abs=0.05 * expected["gap_closure_force"] + expected["gap_closure_force_unc"]
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "order"), [("paper", 3), ("example", 2), ("equal-blocks-6kpa", 2)])
def test_the_gap_closes_there_to_two_percent(name: str, order: int) -> None:
    """The paper's probe on the next finer mesh; on the coarsest it is 3.3 % off."""
    closure, expected = find_gap_closure_load(coarse(read_scene(FOLDER / f"{name}.toml"), order)), EXPECTED[name]
    assert closure is not None
    tolerance = 0.02 * expected["gap_closure_force"] + expected["gap_closure_force_unc"]
    assert closure.force == pytest.approx(expected["gap_closure_force"], abs=tolerance)


def test_points_at_one_place_are_no_curve() -> None:
    """Where the force jumps, as both sides of a fold are in balance, a search for one leaves several points at one place."""
    path = coarse(read_scene(FOLDER / "paper.toml"))
    closure = find_gap_closure_load(path)
    del path.points[3:-1]
    path.points[3:3] = [path.points[2]] * 3
    repeated = find_gap_closure_load(path)
    assert closure is not None
    assert repeated is not None
    assert repeated.force == pytest.approx(closure.force, rel=0.02)


def test_a_wide_gap_closes_nowhere() -> None:
    probe = EXAMPLE.probe.model_copy(update={"gap": 2e-3})
    path = coarse(EXAMPLE.model_copy(update={"probe": probe}))
    path.press_to_indentation(0.3 * path.radius)
    assert path.last.walls > 1e-3


@pytest.mark.slow
def test_linear_elasticity_ends_where_the_trial_says() -> None:
    """5 % in log-sensitivity at 0.042 N (shared trial of two codes), long before 1 % in ratio at 0.23 N."""
    result = press(EXAMPLE, force=0.05, points=2)
    assert result.linear_limit_load is not None
    assert result.linear_limit_load.by == "log_sensitivity"
    assert result.linear_limit_load.force == pytest.approx(0.042, rel=0.05)
    assert result.gap_closure_load is not None
    assert result.gap_closure_load.force == pytest.approx(0.45, abs=0.02 + 0.05 * 0.45)
    assert np.diff(result.closest_walls) < 0
    assert result.force == pytest.approx((0.025, 0.05), rel=1e-6)
    assert np.multiply(result.stiffness, result.indentation) == pytest.approx(result.force, rel=1e-9)
    assert result.constant_ratio is not None
    assert result.stopped is None


@pytest.mark.slow
def test_what_converged_is_kept_when_the_time_is_over() -> None:
    result = press(EXAMPLE, indentation=40e-3, points=40, limits=Limits(seconds=15.0))
    assert result.stopped is not None
    assert 0 < len(result.force) < 40
    assert any("ends early" in note for note in result.warnings)


@pytest.mark.parametrize(
    "wanted", [{}, {"force": 0.0}, {"force": 0.1, "indentation": 1e-3}, {"force": float("nan")}, {"indentation": 0.06}]
)
def test_loads_that_are_none_are_refused(wanted: dict[str, float]) -> None:
    with pytest.raises(InputError):
        press(EXAMPLE, **wanted)


def test_scenes_of_other_kinds_are_refused() -> None:
    with pytest.raises(Refusal, match=r"solid for placement\.tilt"):
        press(EXAMPLE.model_copy(update={"placement": EXAMPLE.placement.model_copy(update={"tilt": 0.1})}), force=0.1)


def test_a_load_far_beyond_all_is_refused_by_what_was_asked() -> None:
    with pytest.raises(Refusal, match=r"force = 1e\+06 N: allowed: up to about 0.5\d* N"):
        press(EXAMPLE, force=1e6, points=1)


@pytest.mark.slow
def test_next_to_no_load_is_the_load_that_was_asked_for() -> None:
    result = press(EXAMPLE, force=1e-9, points=1)
    assert result.force == pytest.approx((1e-9,), rel=1e-6)
    assert result.indentation == pytest.approx((1e-9 / result.stiffness[0],), rel=1e-9)


@pytest.mark.slow
def test_a_gap_that_stays_open_is_said_to() -> None:
    """Stiff blocks on soft tissue, 1 mm apart."""
    stiff = EXAMPLE.probe.inner.model_copy(update={"youngs_modulus": 1e8})
    probe = EXAMPLE.probe.model_copy(update={"gap": 1e-3, "inner": stiff, "outer": stiff})
    limits = find_load_ends(EXAMPLE.model_copy(update={"probe": probe}), 0.01)
    assert limits.gap_closure is None
    assert any("gap_closure_load is null: the walls are apart up to" in note for note in limits.notes)
