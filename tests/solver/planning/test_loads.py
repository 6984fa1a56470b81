"""The rule for loads against solutions with finite strain and contact, and against closed solutions of simple compression."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
import pytest

from geometry import Scene, read_scene
from solver.planning.coarse_model import CoarseModel
from solver.planning.loads import LoadRule, log_sensitivity_change, ratio_change
from tests.support.paths import REFERENCE
from tests.support.references import named


@dataclass(frozen=True)
class ContactReference:
    """Solutions of one scene at several loads, and at a small one; keys as in ``tests/reference/contact/expected.json``."""

    name: str
    scene: Scene
    small: dict[str, float]
    rows: tuple[dict[str, float], ...]
    closure: float

    @property
    def rule(self) -> LoadRule:
        rough = CoarseModel.of(self.scene)
        return LoadRule.of(self.scene, rough.forces.sum(axis=1), rough.closure)


def contact_references() -> list[ContactReference]:
    folder = REFERENCE / "contact"
    found = json.loads((folder / "expected.json").read_text())
    return [
        ContactReference(
            name, read_scene(folder / f"{name}.toml"), one["small_load"], tuple(one["rows"]), one["gap_closure_force"]
        )
        for name, one in found.items()
    ]


EVERY = pytest.mark.parametrize("one", contact_references(), ids=lambda one: one.name)


@EVERY
def test_the_rule_holds_for_every_row_below_the_closure_limit(one: ContactReference) -> None:
    for row in one.rows:
        if not one.rule.knows(row["force"]):
            continue
        x = row["indentation"] / one.scene.probe.tube_radius
        limits = {"ratio": ratio_change(x), "stiffness": ratio_change(x), "log_sensitivity": log_sensitivity_change(x)}
        values = row | {"stiffness": row["force"] / row["indentation"], "stiffness_unc": row["force_unc"] / row["indentation"]}
        for key, limit in limits.items():
            assert abs(values[key] / one.small[key] - 1) <= limit + values[f"{key}_unc"] / one.small[key], (key, x)


def test_some_rows_are_below_it() -> None:
    assert sum(one.rule.knows(row["force"]) for one in contact_references() for row in one.rows) >= 2


@EVERY
def test_x_is_indentation_over_outer_radius_unless_a_block_is_softer_than_the_tissue(one: ContactReference) -> None:
    times = one.rule.strain * one.scene.probe.tube_radius
    assert 1 < times < 1.5 if one.name == "paper" else times == pytest.approx(1, rel=1e-12)


@EVERY
def test_no_load_that_is_allowed_closes_the_gap(one: ContactReference) -> None:
    largest = one.rule.largest(0.9, promise=False)
    assert largest.force < one.closure
    assert one.rule.knows(largest.force * (1 - 1e-12))
    assert not one.rule.knows(largest.force * 1.001)


def test_each_cause_limits_in_its_turn() -> None:
    rule = LoadRule(strain=1 / 5e-3, stiffness=100.0, closure=math.inf)
    for accuracy, promise, cause, x in (
        (0.01, False, "ratio", 0.1),
        (0.01, True, "log_sensitivity", math.log(1.05) / 0.8),
        (0.5, False, "strain limit", 0.3),
    ):
        largest = rule.largest(accuracy, promise)
        assert largest.by == cause
        assert largest.indentation == pytest.approx(x * 5e-3, rel=1e-12)
        assert largest.force == pytest.approx(x * 5e-3 * 100.0, rel=1e-12)
    assert LoadRule(1 / 5e-3, 100.0, 0.5).largest(0.01, True).by == "gap closure"


def test_soft_blocks_count_as_much_as_their_own_strain() -> None:
    """Lubricated columns of incompressible neo-Hooke: nominal stress E/3 (l - l^-2) at the stretch l, against E e."""
    scene = named("axisymmetric", "homogeneous").scene
    strain = 0.01
    secant = ((1 - strain) ** -2 - (1 - strain)) / (3 * strain)
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    soft = np.array([scene.probe.inner.youngs_modulus, scene.probe.outer.youngs_modulus])
    height = np.array([scene.probe.core_height, scene.probe.tube_height])
    rule = LoadRule.of(scene, soft * areas / height, math.inf)  # all of the indentation shortens the blocks
    assert ratio_change(rule.strain * strain * height.min()) >= (secant - 1) * 0.97
