"""Design derivatives with tumours anywhere: Taylor's theorem, the level's own values, and the callback that IPOPT gets."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from geometry import InputError, Scene
from geometry.scenes.variables import changed, values
from solver.axisymmetric.gradients import OUTPUTS
from solver.axisymmetric.sections import sections
from solver.casadi_functions.finite_elements import TumourCallback
from solver.equivalent_inclusion.gradients import FirstOrder, first_order, tumour_gradients
from solver.equivalent_inclusion.probe_on_tissue import undisturbed
from solver.equivalent_inclusion.readings import readings
from solver.inclusions.tumours import Tumours
from tests.support.references import named
from tests.support.slow import slow_unless

FLANK = named("solid", "flank").scene
PAIR = named("off-axis", "pair-off-axis").scene
CYST = named("off-axis", "frictionless-cover-0.25-offset-0.5").scene
SINGLE = tuple(name for name in values(FLANK) if name not in ("tissue.length", "tissue.breadth"))
CASES = [(FLANK, name) for name in SINGLE] + [
    (scene, name)
    for scene in (PAIR, CYST)
    for name in ("probe.inner_radius", "probe.gap", "probe.outer.youngs_modulus", "tissue.poisson_ratio", "tissue.depth")
]


@cache
def start(scene: Scene) -> FirstOrder:
    """What all derivatives of a scene begin with."""
    return first_order(scene, sections(scene))


def outputs(scene: Scene, name: str, step: float) -> np.ndarray:
    """All outputs of a scene with one number changed by a share of it, on the mesh topology of the scene.

    Steps are small: where a point of a tumour's quadrature passes from one element to the next, strains jump by their error.
    """
    kind = start(scene).states.model.mesh.layout.kind
    moved = changed(scene, {name: values(scene)[name] * (1 + step)})
    found = tumour_gradients(moved, first_order(moved, sections(moved), kind=kind), ())
    return np.array([found.values[key][0] for key in OUTPUTS])


QUICK = [(FLANK, "inclusion.depth"), (CYST, "probe.inner_radius")]


@pytest.mark.parametrize(
    ("scene", "name"), slow_unless(QUICK.__contains__, CASES), ids=lambda part: part if isinstance(part, str) else ""
)
def test_central_differences_converge_to_the_derivative_at_second_order(scene: Scene, name: str) -> None:
    found = tumour_gradients(scene, start(scene), (name,))
    mine = np.array([found.derivatives[key][0, 0] for key in OUTPUTS]) * values(scene)[name]
    errors = [np.abs((outputs(scene, name, h) - outputs(scene, name, -h)) / (2 * h) - mine) for h in (6e-4, 1.5e-4)]
    size = np.array([abs(found.values[key][0]) for key in OUTPUTS])
    assert np.all((errors[1] < errors[0] / 14) | (errors[1] < 1e-8 * size))  # 16 at second order
    assert np.all(errors[1] < 1e-4 * size)


def test_values_are_those_of_the_level_to_first_order() -> None:
    found = tumour_gradients(FLANK, start(FLANK), ())
    level = readings(undisturbed(FLANK, 0.01), Tumours.of(FLANK), reflect=False)
    assert found.values["ratio"][0] == pytest.approx(level.ratio[0], rel=5e-5)
    assert found.values["stiffness"][0] == pytest.approx(level.stiffness[0], rel=5e-5)
    assert found.values["log_sensitivity"][0] == pytest.approx(level.log_sensitivity[0], rel=1e-4)


def test_callback() -> None:
    names = ("probe.gap", "probe.height")
    films = TumourCallback(FLANK, names, accuracy=0.05)
    x = np.array([values(FLANK)[name] for name in names])
    jacobian = np.array(films.jacobian()(x, films(x)))
    step = 1e-3 * x[0]
    moved = [np.array(films(x + np.array([sign * step, 0.0]))).ravel() for sign in (1, -1)]
    assert jacobian[:, 0] == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=1e-4)
    assert np.all(np.isnan(np.array(films([-1e-3, 3e-3]))))


def test_unknown_variables_are_refused() -> None:
    with pytest.raises(InputError, match=r"probe\.colour"):
        TumourCallback(FLANK, ("probe.colour",))
