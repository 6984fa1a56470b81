"""The stress picture: in balance with the films."""

from __future__ import annotations

import pytest

from geometry.meridian.section import Body
from probe_design.data.builtin import read_loaded_builtin_scene
from probe_design.reporting.stresses import compute_pressures, draw_stress_figure
from solver import evaluate
from solver.axisymmetric.evaluator import Axisymmetric


def test_pressures_in_the_blocks_are_the_films_stresses() -> None:
    """Each section of a block carries its film's force, so that the mean over the block is the film's stress."""
    scene = read_loaded_builtin_scene()
    states, result = Axisymmetric().compute_converged(scene, 0.05).sample.states, evaluate(scene, "axisymmetric", 0.05)
    pressure, weight = compute_pressures(states, scene), states.model.geometry.weight.sum(axis=1)
    for body, stress in ((Body.INNER, result.stress_inner), (Body.OUTER, result.stress_outer)):
        inside = states.model.mesh.body == body
        assert (pressure * weight)[inside].sum() / weight[inside].sum() == pytest.approx(stress, rel=1e-6)
    assert len(draw_stress_figure(states, scene).axes) == 2
