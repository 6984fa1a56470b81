"""The stress picture: in balance with the films."""

from __future__ import annotations

import pytest

from geometry.meridian.section import Body
from probe_design.data.builtin import read_loaded_builtin_scene
from probe_design.reporting.stresses import compute_pressures, draw_stress_figure
from solver import evaluate
from solver.axisymmetric.evaluator import Axisymmetric


@pytest.mark.parametrize("bonds", [{"psi1": 0.0}, {"bond_to_base.name": "tape-50um", "bond_to_block.name": "tape-50um"}])
def test_pressures_in_the_blocks_are_the_films_stresses(bonds: dict[str, float | str]) -> None:
    """Each section of a block carries its film's force, so that the mean over the block is the film's stress."""
    scene = read_loaded_builtin_scene().replace({f"probe.film.{key}": value for key, value in bonds.items()})
    assert scene.probe.film is not None
    film = scene.probe.film.model_copy(update={} if "psi1" in bonds else {"psi1": None, "psi2": None})  # a film's own states
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": film})})
    states, result = Axisymmetric().compute_converged(scene, 0.05).sample.states, evaluate(scene, "axisymmetric", 0.05)
    pressure, weight = compute_pressures(states, scene), states.model.geometry.weight.sum(axis=1)
    for body, stress in ((Body.INNER, result.stress_inner), (Body.OUTER, result.stress_outer)):
        inside = states.model.mesh.body == body
        assert (pressure * weight)[inside].sum() / weight[inside].sum() == pytest.approx(stress, rel=1e-6)
    assert len(draw_stress_figure(states, scene).axes) == 2
