"""Spheres that all but touch an interface, the bottom or the side: usable bounds, held by ``axisymmetric``."""

import pytest

from benchmarks.evaluators.inclusion_audit import compare
from benchmarks.evaluators.inclusion_draws import draw_near
from geometry import Inclusion, read_scene
from geometry.scenes.scene_tables import CylinderTissue, Layer
from solver.axisymmetric.evaluator import Axisymmetric
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from tests.support.paths import SCENE


def evaluate_both(scene, accuracy=0.01):
    """What both evaluators find, compared."""
    true = Axisymmetric().compute_converged(scene, accuracy / 10).films[0]
    comparison = compare(compute_readings(solve_undisturbed(scene, accuracy), Tumours.from_scene(scene), reflect=True), true)
    assert comparison
    return comparison


@pytest.mark.parametrize("gap", [1e-5, 1e-4])
@pytest.mark.parametrize("contrast", [0.4, 18.0])
def test_next_to_an_interface_the_bound_is_of_use(gap, contrast):
    """A tumour seven times as hard as its layer: 0.15 was stated where 1e-4 was true."""
    skin = Layer(thickness=1.5e-3, youngs_modulus=contrast * 3e3, poisson_ratio=0.45)
    tissue = CylinderTissue(shape="cylinder", radius=45e-3, depth=40e-3, youngs_modulus=3e3, poisson_ratio=0.45, layer=(skin,))
    body = Inclusion(diameter=6e-3, depth=4.5e-3 + gap, youngs_modulus=20e3, poisson_ratio=0.45)
    comparison = evaluate_both(read_scene(SCENE).model_copy(update={"tissue": tissue, "inclusion": (body,)}))
    assert comparison.wrong == ""
    assert comparison.stated < max(0.01, 20 * comparison.true)


@pytest.mark.parametrize("number", [38, 2, 3])  # hard spheres: at the bottom of nearly incompressible tissue; any; at the side
def test_bounds_hold_where_tissue_is_all_but_pinched_off(number):
    comparison = evaluate_both(draw_near(7, number).scene())
    assert comparison.wrong == ""
