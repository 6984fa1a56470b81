"""Bounds on what a load changes cover the charges of films, as pressed at finite strain."""

from __future__ import annotations

import numpy as np
import pytest

from solver import evaluate
from solver.planning import charge_changes
from solver.planning.charge_changes import compute_loaded_charges, has_soft_bond
from solver.planning.coarse_model import CoarseModel
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


def test_charges_of_a_light_load_are_those_of_finite_strain() -> None:
    """Film states on the coarsest mesh give the change of charges per indentation that ``contact`` finds in equilibrium."""
    scene = build_scene("probe/base-tape-1/plain-6").replace({"reading.observable": "charge"})
    coarse = CoarseModel.from_scene(scene, details=False)
    rule, states = coarse.build_rule(scene), coarse.sample.states
    indentation = 0.05 / rule.strain
    charges = compute_loaded_charges(states, indentation) / (indentation * states.products[2:].sum(axis=1))
    loaded = scene.replace({"load.force": rule.stiffness * indentation})
    pressed, linear = (  # charges per indentation
        np.array([result.charge_inner, result.charge_outer], dtype=float) * (result.stiffness or np.nan)
        for result in (evaluate(loaded, evaluator=name, accuracy=1e-3) for name in ("contact", "axisymmetric"))
    )
    change = pressed / linear - 1
    assert np.abs(change).max() > 5e-3
    np.testing.assert_allclose(charges - 1, change, rtol=0.1, atol=5e-4)


def test_a_load_that_turns_a_part_inside_out_gives_way_to_a_lighter_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under the film of a light load tape may shear by more than it is thick; a negative volume has no power of -2/3."""
    scene = build_scene("probe/base-tape-1/plain-6").replace({"reading.observable": "charge"})
    factors = []
    for loads in ((0.02,), (20.0, 0.02)):
        monkeypatch.setattr(charge_changes, "TESTED_X", loads)
        factors.append(CoarseModel.from_scene(scene, details=False).charge_factor)
    assert factors[0] == factors[1] != charge_changes.SOFT_BOND_FACTOR
    coarse = CoarseModel.from_scene(scene, details=False)
    assert np.isnan(compute_loaded_charges(coarse.sample.states, 20.0 / coarse.build_rule(scene).strain)).all()
