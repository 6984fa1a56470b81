"""Design derivatives with tumours anywhere: Taylor's theorem, the evaluator's own values, and the callback that IPOPT gets."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from geometry.scenes.variables import list_values
from solver.axisymmetric.gradients import CHARGE_NAMES, OUTPUT_NAMES, Gradients, compute_gradients
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import add_details, build_sections
from solver.casadi_functions.finite_elements import TumourCallback
from solver.equivalent_inclusion.gradients import FirstOrder, compute_tumour_gradients, solve_first_order
from solver.equivalent_inclusion.probe_on_tissue import FIELD_FINENESSES, solve_undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from tests.support.paths import SCENE
from tests.support.references import named
from tests.support.slow import slow_unless

FLANK = named("solid", "flank").scene
PAIR = named("off-axis", "pair-off-axis").scene
CYST = named("off-axis", "frictionless-cover-0.25-offset-0.5").scene
SINGLE = tuple(name for name in list_values(FLANK) if name not in ("tissue.length", "tissue.breadth"))
CASES = [(FLANK, name) for name in SINGLE] + [
    (scene, name)
    for scene in (PAIR, CYST)
    for name in ("probe.inner_radius", "probe.gap", "probe.outer.youngs_modulus", "tissue.poisson_ratio", "tissue.depth")
]


@cache
def start(scene: Scene) -> FirstOrder:
    """What all derivatives of a scene begin with."""
    return solve_first_order(scene, build_sections(scene))


@cache
def differentiate(scene: Scene) -> Gradients:
    """By all numbers that cases vary; each derivative is a complex step of its own."""
    return compute_tumour_gradients(scene, start(scene), tuple(name for item, name in CASES if item is scene))


def outputs(scene: Scene, name: str, step: float) -> np.ndarray:
    """All outputs of a scene with one number changed by a share of it, on the mesh topology of the scene.

    Steps are small: where a point of a tumour's quadrature passes from one element to the next, strains jump by their error.
    """
    kind = start(scene).states.model.mesh.layout.kind
    moved = scene.replace({name: list_values(scene)[name] * (1 + step)})
    derivatives = compute_tumour_gradients(moved, solve_first_order(moved, build_sections(moved), kind=kind), ())
    return np.array([derivatives.values[key][0] for key in OUTPUT_NAMES])


QUICK = [(FLANK, "inclusion.depth"), (CYST, "probe.inner_radius")]


@pytest.mark.parametrize(
    ("scene", "name"), slow_unless(QUICK.__contains__, CASES), ids=lambda part: part if isinstance(part, str) else ""
)
def test_central_differences_converge_to_the_derivative_at_second_order(scene: Scene, name: str) -> None:
    computed = differentiate(scene)
    column = computed.variables.index(name)
    mine = np.array([computed.derivatives[key][0, column] for key in OUTPUT_NAMES]) * list_values(scene)[name]
    errors = [np.abs((outputs(scene, name, h) - outputs(scene, name, -h)) / (2 * h) - mine) for h in (6e-4, 1.5e-4)]
    size = np.array([abs(computed.values[key][0]) for key in OUTPUT_NAMES])
    assert np.all((errors[1] < errors[0] / 14) | (errors[1] < 1e-8 * size))  # 16 at second order
    assert np.all(errors[1] < 1e-4 * size)


def test_values_are_those_of_the_level_to_first_order() -> None:
    computed = compute_tumour_gradients(FLANK, start(FLANK), ())
    readings = compute_readings(solve_undisturbed(FLANK, 0.01), Tumours.from_scene(FLANK), reflect=False)
    assert computed.values["ratio"][0] == pytest.approx(readings.ratio[0], rel=5e-5)
    assert computed.values["stiffness"][0] == pytest.approx(readings.stiffness[0], rel=5e-5)
    assert computed.values["log_sensitivity"][0] == pytest.approx(readings.log_sensitivity[0], rel=1e-4)


def test_callback() -> None:
    names = ("probe.gap", "probe.height")
    films = TumourCallback(FLANK, names, accuracy=0.05)
    x = np.array([list_values(FLANK)[name] for name in names])
    jacobian = np.array(films.jacobian()(x, films(x)))
    step = 1e-3 * x[0]
    moved = [np.array(films(x + np.array([sign * step, 0.0]))).ravel() for sign in (1, -1)]
    assert jacobian[:, 0] == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=1e-4)
    assert np.all(np.isnan(np.array(films([-1e-3, 3e-3]))))


def test_unknown_variables_are_refused() -> None:
    with pytest.raises(InputError, match=r"probe\.colour"):
        TumourCallback(FLANK, ("probe.colour",))


@cache
def build_taped() -> Scene:
    """The example scene with films of two thicknesses between tapes, and a tumour off the axis."""
    data = read_scene(SCENE).model_dump(exclude_unset=True)
    tape = {"thickness": "50 um", "youngs_modulus": "0.4 MPa", "poisson_ratio": 0.49}
    data["probe"]["film"] = {
        "thickness": "110 um", "electrode_inset": "0.3 mm", "bond_to_base": tape, "bond_to_block": tape,
        "outer": {"thickness": "28 um"},
    }  # fmt: skip
    data["inclusion"] = ({**data["inclusion"][0], "x": "5 mm"},)
    return Scene.model_validate(data)


def differentiate_taped(scene: Scene, names: tuple[str, ...]) -> Gradients:
    return compute_tumour_gradients(scene, solve_first_order(scene, add_details(scene, build_sections(scene))), names)


TAPED_NAMES = tuple(list_values(build_taped()))


@cache
def differentiate_taped_by_all() -> Gradients:
    return differentiate_taped(build_taped(), TAPED_NAMES)


QUICK_NAMES = ("probe.film.thickness", "probe.film.bond_to_base.youngs_modulus", "inclusion.depth")


@pytest.mark.parametrize("name", slow_unless(QUICK_NAMES.__contains__, TAPED_NAMES))
def test_derivatives_of_charges_are_the_limit_of_differences(name: str) -> None:
    scene, step = build_taped(), 2e-4
    value, computed = list_values(scene)[name], differentiate_taped_by_all()
    moved = [differentiate_taped(scene.replace({name: value * (1 + change)}), ()) for change in (step, -step)]
    assert tuple(computed.values) == (*OUTPUT_NAMES, *CHARGE_NAMES)
    for key, size in computed.values.items():
        difference = (moved[0].values[key][0] - moved[1].values[key][0]) / (2 * step * value)
        assert computed.derivatives[key][0, TAPED_NAMES.index(name)] * value == pytest.approx(
            difference * value, abs=1e-6 * abs(size[0])
        )


@pytest.mark.slow
def test_charges_and_derivatives_on_the_axis_are_those_of_finite_elements() -> None:
    """The tumour is weak, so that its reflections do not matter, and the axisymmetric mesh has it inside."""
    scene = build_taped().replace({"inclusion.x": 0.0, "inclusion.depth": 0.02, "inclusion.youngs_modulus": 6.6e3})
    names = ("probe.inner_radius", "probe.height", "probe.film.bond_to_base.thickness", "probe.outer.poisson_ratio")
    computed, sections = differentiate_taped(scene, names), add_details(scene, build_sections(scene))
    expected = compute_gradients(scene, solve_on_mesh(sections.section, sections, scene, FIELD_FINENESSES[1]), names)
    for key in ("charge_ratio", "charge_inner", "charge_outer"):
        assert computed.values[key][0] == pytest.approx(expected.values[key][0], rel=2e-4)
        sizes = np.abs(expected.derivatives[key][0])
        assert computed.derivatives[key][0] == pytest.approx(expected.derivatives[key][0], abs=2e-3 * sizes.max(), rel=2e-3)
