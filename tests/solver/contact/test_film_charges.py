"""Charges of bonded films under load: by other forms of the integral, limits, difference quotients and finer meshes."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body
from geometry.scenes.scene import Scene
from solver import evaluate, press
from solver.axisymmetric.sections import add_details, build_sections
from solver.contact.evaluator import ContactEvaluator
from solver.contact.load_curve import CHARGE_FIELDS
from solver.contact.loaded_scene import LoadedScene
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.states import Outputs, PathPoint
from solver.elements.shape_functions import evaluate_functions
from solver.results.film_forces import FilmForces
from tests.support.film_scenes import build_scene, read_cases
from tests.support.load_paths import COARSE, FINE
from tests.support.slow import slow_unless

TAPES, GLUED, SLIDING = "probe/two-tapes-0.4/tumour-300", "probe/bare/tumour-30", "frictionless/base-tape-1/tumour-30"
SHALLOW = "probe/two-tapes-0.4/tumour-shallow-100"


def build(name: str, force: float) -> Scene:
    return build_scene(name).replace({"reading.observable": "charge", "load.force": force})


def start(scene: Scene, fineness: MeridianFineness = COARSE) -> Path:
    """A path on one mesh that nothing corrects."""
    sections = add_details(scene, build_sections(scene))
    model = ContactModel.from_section(sections.section, sections.materials, "bonded", fineness, films=sections.films)
    return Path(model, sensitive=True)


def get_charges(point: PathPoint) -> Outputs:
    assert point.charges is not None
    return point.charges


def compute_log_ratio(charges: FilmForces | None) -> float:
    assert charges is not None
    return float(np.log(np.abs(charges.totals)) @ [1, -1])


@pytest.mark.parametrize("name", slow_unless({TAPES, GLUED}.__contains__, (TAPES, GLUED, SLIDING)))
def test_light_loads_give_the_charges_of_independent_codes(name: str) -> None:
    case, result = read_cases()[name], evaluate(build(name, 1e-4), evaluator="contact", accuracy=1e-2)
    values = (result.charge_per_force_inner, result.charge_per_force_outer)
    errors = (result.charge_per_force_inner_error, result.charge_per_force_outer_error)
    for value, error, expected in zip(values, errors, case["charge_per_force"], strict=True):
        assert value is not None
        assert error is not None
        assert 1e12 * value == pytest.approx(expected, rel=error + case["relative_uncertainty"])
        assert error < 1e-2


@pytest.mark.parametrize("name", [TAPES, GLUED])
def test_meshes_need_little_correction(name: str) -> None:
    """The linear charges correct a mesh by few per cent, so that what remains of its error under load is far below that."""
    case, path = read_cases()[name], start(build(name, 0.01), FINE)
    tangents = get_charges(path.points[0]).tangent / path.points[0].tangent
    np.testing.assert_allclose(1e12 * tangents, case["charge_per_force"], rtol=5e-3)


def test_displacements_give_the_same_charge_under_load() -> None:
    """FILM.md eq. 1: Int (s_r + s_t) dA = E/(1-nu) 2 pi [r u] + 2 nu/(1-nu) Int s_z dA, u the mean over the thickness."""
    scene = build(TAPES, 0.01)
    path, film = start(scene, FINE), scene.probe.film
    assert film is not None
    point = path.press_to_indentation(7e-4)  # the ratio of charges has changed by 5 %
    model, u = path.model, point.equilibrium.state.elements.u
    corners = compute_nodes(model.section, model.mesh, UNIT_SQUARE)
    probe, change = scene.probe, get_charges(point).values / get_charges(path.points[0]).tangent / point.indentation
    assert abs(change[0] / change[1] - 1) > 0.04
    radii = {Body.INNER_FILM: (0.0, probe.inner_radius), Body.OUTER_FILM: (probe.hole_radius, probe.tube_radius)}
    for k, (body, ends) in enumerate(radii.items()):
        moved = 0.0  # of Int r u dz / thickness at the outer end less that at the inner end
        for e in np.flatnonzero(model.mesh.body == body):
            for radius, sign in zip(ends, (-1, 1), strict=True):
                moved += sign * radius * _integrate_side(model, u[e], corners[e], radius)
        ratio = film.poisson_ratio / (1 - film.poisson_ratio)
        lateral = film.youngs_modulus / (1 - film.poisson_ratio) * 2 * np.pi * moved / film.thickness
        charge = film.mean_lateral_charge * (2 * ratio * point.films[k] - lateral) + film.d33 * point.films[k]
        assert charge == pytest.approx(get_charges(point).values[k], rel=3e-3)


def _integrate_side(model: ContactModel, values: np.ndarray, corners: np.ndarray, radius: float) -> float:
    """Int u_r dz along an element's side at a radius; 0 where it has none there."""
    degrees, (points, weights) = model.elements.shapes.degrees, np.polynomial.legendre.leggauss(12)
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        if np.allclose(corners[[a, b], 0], radius, rtol=1e-12, atol=1e-15):
            places = UNIT_SQUARE[a] + (points[:, None] + 1) / 2 * (UNIT_SQUARE[b] - UNIT_SQUARE[a])
            u = evaluate_functions(places, degrees)[0] @ values[: len(degrees)]
            return float(u @ weights / 2 * np.ptp(corners[[a, b], 1]))
    return 0.0


@pytest.mark.slow
def test_without_lateral_charge_films_measure_forces_at_any_load() -> None:
    """With d31 = d32 = 0 the charge is d33 times the force on the film, also where the gap's walls press on each other."""
    scene = build(TAPES, 0.01).replace({"probe.film.d31": 0.0, "probe.film.d32": 0.0, "probe.gap": 3e-6})
    path, film = start(scene), scene.probe.film
    assert film is not None
    for x in (0.02, 0.1, 0.3):
        point = path.press_to_indentation(x * path.radius)
        np.testing.assert_allclose(get_charges(point).values, film.d33 * point.films, rtol=1e-6)
        np.testing.assert_allclose(get_charges(point).tangent, film.d33 * point.tangent, rtol=1e-6)
        assert get_charges(point).log_sensitivity == pytest.approx(point.log_sensitivity, rel=1e-6)
    assert path.last.walls < 1e-7


def test_tangents_are_difference_quotients() -> None:
    path = start(build(TAPES, 0.01))
    step = 1e-6
    low, middle, high = (path.press_to_indentation(5e-4 + k * step) for k in (-1, 0, 1))
    quotient = (get_charges(high).values - get_charges(low).values) / (2 * step)
    np.testing.assert_allclose(get_charges(middle).tangent, quotient, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", [SHALLOW, TAPES])
def test_log_sensitivity_of_charges_is_the_derivative_at_one_force(name: str) -> None:
    scene, step = build(name, 0.08), 0.02
    films = ContactEvaluator().solve(scene, 1e-2).films[0]
    logs = []
    for factor in (np.exp(-step), np.exp(step)):
        body = scene.inclusion[0].model_copy(update={"youngs_modulus": factor * scene.inclusion[0].youngs_modulus})
        changed = ContactEvaluator().solve(scene.model_copy(update={"inclusion": (body,)}), 1e-2)
        logs.append(compute_log_ratio(changed.films[0].charges))
    assert films.charges is not None
    assert films.charges.log_sensitivity == pytest.approx((logs[1] - logs[0]) / (2 * step), rel=1e-3)


@pytest.mark.parametrize("name", slow_unless({TAPES}.__contains__, (TAPES, GLUED, SHALLOW)))
def test_finer_meshes_agree_within_the_bounds(name: str) -> None:
    scene = build(name, 0.06)
    loaded = LoadedScene.from_scene(scene, 1e-2)
    coarse = loaded.press_to_scene_load().films
    finer = loaded.refine()
    assert finer is not None
    fine = finer.press_to_scene_load().films
    assert coarse.charges is not None
    assert fine.charges is not None
    deviations = np.abs(coarse.charges.totals / fine.charges.totals - 1)
    assert np.all(deviations <= coarse.charges.relative_errors)
    assert abs(compute_log_ratio(coarse.charges) - compute_log_ratio(fine.charges)) <= coarse.charges.bound.log_ratio
    difference = abs((coarse.charges.log_sensitivity or 0.0) - (fine.charges.log_sensitivity or 0.0))
    assert difference <= coarse.charges.sensitivity_error


@pytest.mark.slow
def test_moduli_of_one_curve_are_those_of_their_points() -> None:
    scene, moduli = build(SHALLOW, 0.05), np.array([6e4, 1.5e5])
    films = ContactEvaluator().solve(scene, 1e-2, moduli).films
    for modulus, point in zip(moduli, films, strict=True):
        body = scene.inclusion[0].model_copy(update={"youngs_modulus": float(modulus)})
        alone = ContactEvaluator().solve(scene.model_copy(update={"inclusion": (body,)}), 1e-2).films[0]
        assert point.charges is not None
        assert alone.charges is not None
        np.testing.assert_allclose(point.charges.totals, alone.charges.totals, rtol=1e-3)
        assert point.charges.log_sensitivity == pytest.approx(alone.charges.log_sensitivity, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("observable", ["charge", "stress"])
def test_load_curves_hold_charges_and_limits_of_what_is_read(observable: str) -> None:
    scene = build(TAPES, 0.01).replace({"reading.observable": observable})
    curve = press(scene, force=0.04, points=2)
    result = evaluate(scene.replace({"load.force": 0.04}), evaluator="contact")
    for name in CHARGE_FIELDS:
        value, expected = getattr(curve, name)[1], getattr(result, name)
        if not name.endswith("_error"):
            assert value == pytest.approx(expected, rel=1e-4)
        else:
            assert 0 < value < (1e-3 if "sensitivity" in name else 1e-2)
    ratios = {"charge": curve.charge_ratio, "stress": curve.ratio}
    assert curve.reading.ratio == ratios[observable]
    ends = curve.load_limits
    assert ends is not None
    assert ends.ratio is not None
    # the ratio of charges changes by 1 % at 0.013 N, that of forces at 0.08 N
    limit = evaluate(scene.replace({"load.force": ends.ratio.force}), evaluator="contact", accuracy=1e-3)
    light = evaluate(scene.replace({"load.force": 1e-5}), evaluator="axisymmetric", accuracy=1e-3)
    assert limit.reading.ratio is not None
    assert light.reading.ratio is not None
    assert abs(limit.reading.ratio / light.reading.ratio - 1) == pytest.approx(0.01, abs=1e-3)
