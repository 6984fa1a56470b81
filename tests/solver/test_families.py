"""Families of scenes: who belongs to one, and that what interpolation says of its own error is no less than the error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from geometry import Scene
from geometry.scenes.scene import Load
from solver import Result, evaluate, evaluate_many
from solver.axisymmetric import evaluator as axisymmetric
from solver.axisymmetric.converged_forces import Converged, compute_converged_forces
from solver.families import Family, find_families
from tests.support.references import named

OURS = named("axisymmetric", "shallow").scene
GAPS = OURS.probe.gap * np.geomspace(1.0, 1.4, 20)


def with_gap(gap: float, force: float = 1e-3) -> Scene:
    return OURS.model_copy(update={"probe": OURS.probe.model_copy(update={"gap": gap}), "load": Load(force=force)})


@pytest.mark.parametrize("count", [4, 7, 13])
@pytest.mark.parametrize("pole", [0.3, 1.0, 3.0])
def test_the_error_that_is_told_is_no_less_than_the_error(pole: float, count: int) -> None:
    """Of rational functions with poles near the range, and of a kink."""
    family = Family.from_numbers(range(40), np.linspace(-1.0, 1.0, 40), count)
    x = family.x[:, None]
    for values in (1 / (x**2 + pole**2), np.arctan(x / pole) + 2, np.abs(x - 0.1)):
        parameter, errors = family.interpolate(values[family.solved])
        assert np.all(np.abs(parameter - values) <= errors + 1e-13)


def test_families_differ_in_one_number_and_share_a_kind() -> None:
    """Not in the load, which is found at once anyway; in two numbers they are two families, if they are large enough."""
    scenes = [with_gap(gap, force) for gap in GAPS.tolist() for force in (1e-3, 2e-3)]
    families_found = [*find_families(scenes, lambda _: 0)]
    assert [sorted(family.places) for family in families_found] == [[*range(0, 40, 2)], [*range(1, 40, 2)]]
    for family in families_found:
        gaps = [scenes[place].probe.gap for place in family.places]
        assert np.allclose(np.log(gaps), family.x)
        assert len(family.solved) == 6
    assert [*find_families(scenes[:18], lambda _: 0)] == []  # nine of either load
    assert next(iter(find_families(scenes, lambda scene: scene.probe.gap > GAPS[8]))).places.size == 11


def test_gaps_are_interpolated_within_their_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[Scene] = []

    def counting(scene: Scene, accuracy: float, moduli: ArrayLike | None = None) -> Converged:
        solved.append(scene)
        return compute_converged_forces(scene, accuracy, None if moduli is None else np.asarray(moduli))

    monkeypatch.setattr(axisymmetric, "compute_converged_forces", counting)
    scenes = [with_gap(gap) for gap in GAPS.tolist()]
    shuffled = [scenes[k] for k in np.random.default_rng(1).permutation(len(scenes))]
    together = evaluate_many(shuffled, "axisymmetric", 0.02)
    assert len(solved) == 6
    for scene, result in list(zip(shuffled, together, strict=True))[::3]:
        alone = evaluate(scene, "axisymmetric", 0.02)
        assert isinstance(result, Result)
        compare(result, alone)


def compare(result: Result, alone: Result) -> None:
    numbers: list[tuple[Any, Any]] = [
        (getattr(result, name), getattr(alone, name)) for name in ("ratio", "stress_inner", "stiffness")
    ]
    assert all(
        abs(mine / alone_value - 1) <= 1e-4 for mine, alone_value in numbers
    )  # a hundredth of what 0.02 allows, and a half of that
    assert result.log_sensitivity == pytest.approx(alone.log_sensitivity, rel=1e-3, abs=1e-7)
    assert result.error_estimate is not None
    assert alone.error_estimate is not None
    assert result.linear_limit_load is not None
    assert alone.linear_limit_load is not None
    assert 0.98 * alone.error_estimate <= result.error_estimate <= 0.02
    assert result.linear_limit_load.force == pytest.approx(alone.linear_limit_load.force, rel=1e-3)
    assert (result.provenance, result.plan, result.warnings) == (alone.provenance, alone.plan, alone.warnings)
