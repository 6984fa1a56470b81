"""Derivatives by every number of a scene: against an independent code, Taylor's theorem and laws of physics."""

from __future__ import annotations

import json
from functools import partial

import casadi
import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.mesh_lines import find_kind as kind_of
from geometry.scenes.variables import list_values
from solver.axisymmetric.energy_derivatives import list_variables
from solver.axisymmetric.gradients import OUTPUT_NAMES, compute_gradients, differentiate_by_section
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import add_details, build_sections
from solver.casadi_functions.finite_elements import FilmCallback
from tests.support.paths import REFERENCE
from tests.support.references import named
from tests.support.slow import slow_unless

INDEPENDENT = json.loads((REFERENCE / "gradients.json").read_text())  # benchmarks/references/gradients.py, NGSolve
FINE, COARSE = MeridianFineness(1, 4, 8), MeridianFineness(1, 2, 4)
RENAMED = {"sphere_radius": "inclusion_radius", "sphere_depth": "inclusion_depth"}


def solved(scene: Scene, fineness: MeridianFineness, moduli: np.ndarray | None = None, like: Scene | None = None) -> MeshSample:
    """A sample on the mesh topology of another scene."""
    add = add_details if scene.probe.film or not scene.probe.base.rigid else lambda _, plain: plain
    scene_sections = add(scene, build_sections(scene))
    kind = kind_of(add(like, build_sections(like)).section) if like else None
    return solve_on_mesh(scene_sections.section, scene_sections, scene, fineness, moduli=moduli, kind=kind)


@pytest.mark.parametrize("name", slow_unless("examples/scene.toml".__eq__, INDEPENDENT))
def test_against_an_independent_code(name: str) -> None:
    root = REFERENCE.parents[1]
    scene = read_scene(root / name)
    sample_found = solved(scene, FINE)
    names, derivatives = list_variables(sample_found.states.model), differentiate_by_section(sample_found)
    probe, ring = scene.probe, scene.probe.outer_area / np.pi
    areas = {
        "inner_radius": (2.0, 0.0),
        "hole_radius": (0.0, -2 * probe.hole_radius**2 / ring),
        "tube_radius": (0.0, 2 * probe.tube_radius**2 / ring),
    }
    for k, variable in enumerate(names):
        true = INDEPENDENT[name][RENAMED.get(variable, variable)]
        inner, outer = derivatives.totals[0, k] - areas.get(variable, (0.0, 0.0))
        ours = {
            "ratio": inner - outer,
            "stress_inner": inner,
            "stress_outer": outer,
            "log_sensitivity": derivatives.sensitivity[0, k],
        }
        for output, value in ours.items():
            assert value == pytest.approx(true[output], rel=1e-3, abs=1e-4 if output != "log_sensitivity" else 1e-5), (
                variable,
                output,
            )


SCENES = {
    "bonded": ("axisymmetric", "shallow"),
    "frictionless": ("axisymmetric", "published-materials-frictionless"),
    "thin cover": ("extra", "thin-cover-stiff"),
    "wider than the probe": ("axisymmetric", "equal-areas-small"),
    "elastic base and films": ("layers", "plastic-base-soft-adhesive"),
}


@pytest.mark.parametrize("name", slow_unless("bonded".__eq__, SCENES))
def test_taylor_rate_is_two_for_every_variable(name: str) -> None:
    scene = named(*SCENES[name]).scene
    start = solved(scene, COARSE)
    at_start = compute_gradients(scene, start)
    for k, variable in enumerate(at_start.variables):
        x = at_start_value = list_values(scene)[variable]
        step = 2e-2 * min(x, 0.5 - x) if variable.endswith("poisson_ratio") else 2e-2 * x
        if variable in ("probe.inner_radius", "inclusion.diameter", "inclusion.depth"):
            cover = scene.inclusion[0].depth / scene.inclusion[0].diameter - 0.5
            step *= min(1.0, list_values(scene)["probe.gap"] / x * 10, 2 * cover)
        left = []
        for h in (step, step / 2):
            moved = scene.replace({variable: at_start_value + h})
            moved_gradients = compute_gradients(moved, solved(moved, COARSE, like=scene), ()).values
            left.append(
                [
                    moved_gradients[output_key][0] - at_start.values[output_key][0] - h * at_start.derivatives[output_key][0, k]
                    for output_key in OUTPUT_NAMES
                ]
            )
        size = [
            abs(step * at_start.derivatives[output_key][0, k]) + 1e-12 * abs(at_start.values[output_key][0])
            for output_key in OUTPUT_NAMES
        ]
        for output, first, second, scale in zip(OUTPUT_NAMES, *left, size, strict=True):
            if abs(second) > 1e-6 * scale:  # else rounding: the output is as good as linear
                assert np.log2(abs(first / second)) == pytest.approx(2, abs=0.35), (variable, output)


def test_gradient_of_a_curve_is_that_of_its_points() -> None:
    scene = named("axisymmetric", "nearly-incompressible").scene
    moduli = np.geomspace(1e3, 1e7, 4)
    curve = compute_gradients(scene, solved(scene, COARSE, moduli))
    for k, modulus in enumerate(moduli):
        softer = scene.replace({"inclusion.youngs_modulus": modulus})
        alone = compute_gradients(softer, solved(softer, COARSE))
        for output in OUTPUT_NAMES:
            assert curve.values[output][k] == pytest.approx(alone.values[output][0], rel=1e-6)
            scale = np.abs(alone.derivatives[output][0]).max()
            # the states of a curve are good to the root of the forces' tolerance, and so are derivatives
            assert curve.derivatives[output][k] == pytest.approx(alone.derivatives[output][0], rel=2e-3, abs=1e-7 * scale)


def test_few_pairs_of_states_stand_for_a_long_curve() -> None:
    scene = named("axisymmetric", "nearly-incompressible").scene
    few, many = (compute_gradients(scene, solved(scene, COARSE, np.geomspace(1e3, 1e7, count))) for count in (4, 40))
    for output in OUTPUT_NAMES:
        scale = np.abs(few.derivatives[output]).max()
        np.testing.assert_allclose(many.derivatives[output][::13], few.derivatives[output], atol=1e-6 * scale)


def test_sums_that_physics_fixes() -> None:
    """Stresses at a given indentation scale with all moduli as the first power, with all lengths as the power -1."""
    scene = named("axisymmetric", "equal-areas-small").scene
    assert scene.load.indentation is not None
    sample_gradients = compute_gradients(scene, solved(scene, COARSE))
    x = np.array([list_values(scene)[name] for name in sample_gradients.variables])
    moduli = np.array([name.endswith("youngs_modulus") for name in sample_gradients.variables])
    lengths = np.array(
        [not name.endswith(("youngs_modulus", "poisson_ratio", "area_ratio")) for name in sample_gradients.variables]
    )
    for output, by_moduli, by_lengths in (("ratio", 0, 0), ("stress_inner", 1, -1), ("stress_outer", 1, -1), ("stiffness", 1, 1)):
        logs = sample_gradients.derivatives[output][0] * x / sample_gradients.values[output][0]
        assert logs[moduli].sum() == pytest.approx(by_moduli, abs=1e-8)
        assert logs[lengths].sum() == pytest.approx(by_lengths, abs=1e-7)
    assert (sample_gradients.derivatives["log_sensitivity"][0] * x)[lengths].sum() == pytest.approx(0, abs=1e-8)


def test_unknown_variable_is_refused() -> None:
    scene = named("axisymmetric", "shallow").scene
    with pytest.raises(InputError, match=r"probe\.colour"):
        compute_gradients(scene, solved(scene, COARSE), ("probe.colour",))


@pytest.mark.slow
def test_ipopt_climbs_with_the_callback() -> None:
    """Gap and moduli for the largest log-sensitivity: what IPOPT ends with beats the start and both neighbours of its end."""
    scene = named("axisymmetric", "shallow").scene
    names = ("probe.height", "probe.outer.youngs_modulus")
    films = FilmCallback(scene, names, accuracy=0.05)
    start = np.log([list_values(scene)[name] for name in names])
    x = casadi.MX.sym("x", 2)
    problem = {"x": x, "f": -1e3 * films(casadi.exp(x))[3]}
    options = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 12, "ipopt.print_level": 0, "print_time": False}
    solver = casadi.nlpsol("solver", "ipopt", problem, options)
    best = np.array(solver(x0=start, lbx=start - np.log(4), ubx=start + np.log(4))["x"]).ravel()
    log_sensitivity = partial(lambda y: float(films(np.exp(y))[3]))
    assert log_sensitivity(best) > 1.1 * log_sensitivity(start)
    for step in np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]):
        inside = np.clip(best + step, start - np.log(4), start + np.log(4))
        assert log_sensitivity(inside) <= log_sensitivity(best) * (1 + 1e-4)


def test_callback_gives_no_number_where_there_is_no_scene() -> None:
    scene = named("axisymmetric", "shallow").scene
    films = FilmCallback(scene, ("probe.gap",), accuracy=0.05)
    assert np.all(np.isnan(np.array(films(-1e-3))))
    assert np.all(np.isfinite(np.array(films(1e-4))))
