"""A probe near one edge of a block: bounds sharp enough for a hundredth, and a ratio between those of round tissues."""

import pytest

from geometry import Placement, read_scene
from geometry.scenes.scene_tables import CylinderTissue
from geometry.tetra.sizing import COARSE_FINENESS, ROUGH_FINENESS
from solver import evaluate, evaluator
from solver.solid.difference import solve_difference
from solver.solid.domain_mesh import mesh_domain
from solver.solid.symmetric_part import compute_symmetric_part
from tests.support.paths import ROOT

TUMOURS = read_scene(ROOT / "examples" / "two-tumours.toml")


def place_scene(x, **tissue):
    """The probe beside its tumours, at a place along the block."""
    block = TUMOURS.tissue.model_copy(update=tissue)
    return TUMOURS.model_copy(update={"placement": Placement(x=x), "tissue": block})


def in_round_tissue(radius):
    tissue = {key: getattr(TUMOURS.tissue, key) for key in ("depth", "youngs_modulus", "poisson_ratio")}
    cylinder = CylinderTissue(shape="cylinder", radius=radius, **tissue)
    scene = TUMOURS.model_copy(update={"inclusion": (), "placement": Placement(), "tissue": cylinder})
    return evaluator("axisymmetric").evaluate(scene, 0.001)


@pytest.mark.slow
def test_what_coarse_meshes_get_wrong_at_the_rims_cancels():
    """A coarse mesh's stiffness near an edge is within 0.3 % of a finer one's; a difference of forces leaves 0.5 %."""
    scene = place_scene(35e-3)
    symmetric = compute_symmetric_part(scene, 0.01)
    assert symmetric.domain.radius is not None
    differences = [
        solve_difference(symmetric.domain, mesh_domain(symmetric.domain, fine))[0] for fine in (ROUGH_FINENESS, COARSE_FINENESS)
    ]
    by_compliance = [symmetric.correct_forces(difference_found).sum() for difference_found in differences]
    assert abs(by_compliance[0] / by_compliance[1] - 1) < 0.003
    narrow, wide = in_round_tissue(15e-3), in_round_tissue(50e-3)  # inside the block's nearest side, and as wide as its half
    assert narrow.stiffness < by_compliance[1] < wide.stiffness


@pytest.mark.slow
def test_a_probe_near_an_edge_is_answered():
    x = 35e-3
    result = evaluate(place_scene(x))
    assert result.error_estimate
    assert result.error_estimate <= 0.01
    assert result.ratio
    assert in_round_tissue(50e-3 - x).ratio * 1.001 > result.ratio > in_round_tissue(50e-3).ratio * 0.999
