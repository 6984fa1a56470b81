"""Bounds on what a load changes cover the charges of films, as pressed at finite strain."""

from __future__ import annotations

import pytest

from solver import evaluate
from solver.planning.charge_changes import has_soft_bond
from solver.planning.load_limits import build_load_rule
from tests.support.film_scenes import build_scene


@pytest.mark.parametrize("name", ["probe/two-tapes-0.4/tumour-300", "probe/base-tape-1/tumour-30"])
def test_charges_change_less_than_the_bound(name: str) -> None:
    scene = build_scene(name).replace({"reading.observable": "charge"})
    rule = build_load_rule(scene)
    force = rule.find_ratio_limit(0.02).force
    linear = evaluate(scene.replace({"load.force": force}), evaluator="axisymmetric", accuracy=2e-3)
    pressed = evaluate(scene.replace({"load.force": force}), evaluator="contact", accuracy=2e-3)
    for key in ("charge_ratio", "charge_per_force_inner", "charge_per_force_outer"):
        assert abs(getattr(pressed, key) / getattr(linear, key) - 1) < rule.bound_ratio_change(force)
    # without the factor the bound would not hold
    stiff = build_load_rule(build_scene("probe/bare/tumour-30"))
    assert not has_soft_bond(build_scene("probe/bare/tumour-30"))
    assert 1 < rule.covered / stiff.covered < 10
    assert pressed.charge_ratio is not None
    assert linear.charge_ratio is not None
    assert abs(pressed.charge_ratio / linear.charge_ratio - 1) > stiff.bound_ratio_change(force)
