"""A probe that is pressed: against solutions of other codes, the linear limit, laws of mechanics, Newton's rate."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from geometry import Scene
from geometry.common import resources
from geometry.common.arrays import Floats
from geometry.common.resources import LimitReached
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.contact.contact_forces import compute_pressure, compute_touch
from solver.contact.contact_steps import correct_step
from solver.contact.footpoints import PointGaps
from solver.contact.model import ContactModel
from solver.contact.states import StoppedError, compute_hermite_weights
from tests.support.load_paths import COARSE, FINE, FOLDER, pressed, ratio, scene_of, work

EXPECTED = json.loads((FOLDER / "expected.json").read_text())
NAMES = ("example", "equal-blocks-6kpa", "paper")


def check_rows(name: str, rows: list[dict[str, Any]]) -> None:
    """Ratio within 0.2 % and the row's uncertainty, force within 0.1 %, log-sensitivity within 1 %, walls within 1 % of the gap.

    What the mesh is off at rest is taken off, as the level does.
    """
    scene, small_load = scene_of(name), EXPECTED[name]["small_load"]
    path = pressed(scene, FINE)
    start = path.points[0]
    for row in rows:
        point = path.press_to_indentation(row["indentation"])
        ratio_found = ratio(scene, point) / ratio(scene, start) * small_load["ratio"]
        assert ratio_found == pytest.approx(row["ratio"], abs=2e-3 * row["ratio"] + row["ratio_unc"])
        force = point.force / start.tangent.sum() * small_load["stiffness"]
        assert force == pytest.approx(row["force"], abs=1e-3 * row["force"] + row["force_unc"])
        sensitivity = point.log_sensitivity / start.log_sensitivity * small_load["log_sensitivity"]
        assert sensitivity == pytest.approx(
            row["log_sensitivity"], abs=0.01 * row["log_sensitivity"] + row["log_sensitivity_unc"]
        )
        assert point.walls == pytest.approx(row["closest_walls"], abs=1e-6 + row["closest_walls_unc"])


def test_other_codes_agree_before_anything_touches() -> None:
    check_rows("equal-blocks-6kpa", EXPECTED["equal-blocks-6kpa"]["rows"][:1])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_other_codes_agree(name: str) -> None:
    check_rows(name, EXPECTED[name]["rows"])


def test_the_limit_of_no_load_is_that_of_linear_elements() -> None:
    scene = scene_of("example")
    scene_sections = build_sections(scene)
    linear = solve_on_mesh(scene_sections.section, scene_sections, scene, COARSE)
    at_rest = pressed(scene, COARSE).points[0]
    np.testing.assert_allclose(at_rest.tangent, linear.totals[0, :2], rtol=2e-6)
    assert at_rest.log_sensitivity == pytest.approx(float(linear.log_sensitivities[0, 0]), rel=2e-5)
    model = ContactModel.from_section(scene_sections.section, scene_sections.materials, "bonded", COARSE)
    state = model.build_rest_state()
    _, derivatives = model.compute_responses(state, model.linearise(state))
    np.testing.assert_allclose(derivatives[:, 0], linear.totals[0, :2], rtol=1e-8)


def test_work_is_stored_and_slopes_are_the_path_s() -> None:
    """Neither elastic bodies nor frictionless contact lose energy; cubics through forces and their slopes tell the work."""
    scene = scene_of("equal-blocks-6kpa")
    path = pressed(scene, COARSE)
    for x in np.linspace(0.02, 0.4, 20):
        path.press_to_indentation(x * path.radius)
    last = path.last.equilibrium
    assert any(np.any(touch_state.pressure > 0) for touch_state in last.equations.touches)
    assert path.model.elements.compute_energy(last.state.elements) == pytest.approx(work(path), rel=1e-4)


def test_log_sensitivity_is_the_derivative_at_one_force() -> None:
    scene, step = scene_of("paper"), 0.02
    point = pressed(scene, COARSE).press_to_indentation(8e-4)  # the gap has closed
    logs = []
    for factor in (1 - step, 1 + step):
        data = scene.model_dump(exclude_unset=True)
        data["inclusion"][0]["youngs_modulus"] *= factor
        changed = Scene.model_validate(data)
        logs.append(np.log(ratio(changed, pressed(changed, COARSE).press_to_force(point.force))))
    derivative = (logs[1] - logs[0]) / (np.log(1 + step) - np.log(1 - step))
    assert point.log_sensitivity == pytest.approx(derivative, rel=0.02)


def test_contact_s_forces_and_tangent_are_derivatives() -> None:
    scene = scene_of("paper")
    path = pressed(scene, COARSE)
    equilibrium = path.press_to_indentation(1e-3).equilibrium
    model, state = path.model, equilibrium.state
    displaced = model.compute_displacements(state.v, state.indentation)
    rng, step = np.random.default_rng(3), 1e-10
    direction = rng.standard_normal(displaced.shape)
    checked = 0
    for pair, multiplier in zip(model.pairs, state.multipliers, strict=True):
        touch_now, ahead, behind = (
            compute_touch(pair, displaced + k * step * direction, multiplier, blur=1e-6) for k in (0, 1, -1)
        )
        if not np.any(touch_now.pressure > 0):
            continue
        checked += 1
        expected = touch_now.stiffness @ direction.ravel()
        np.testing.assert_allclose(
            (ahead.forces - behind.forces) / (2 * step), expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max()
        )
        assert abs(touch_now.stiffness - touch_now.stiffness.T).max() <= 1e-12 * abs(touch_now.stiffness).max()
        assert (
            abs(touch_now.forces.reshape(displaced.shape)[:, model.numbering.vertical > 0].sum())
            <= 1e-9 * np.abs(touch_now.forces).sum()
        )
    assert checked >= 2


def test_kinks_of_a_wall_are_rounded_and_their_derivatives_exact() -> None:
    """Points pass the nodes of a rough wall, where forces would jump over a sharp kink."""
    path = pressed(scene_of("example"), COARSE)
    model, rng, checked = path.model, np.random.default_rng(5), 0
    for pair in model.pairs:
        pressing = np.full(pair.points, 1e3 * pair.penalty * path.radius)  # whatever the gap
        rough = 0.02 * float(pair.master.lengths.min()) * rng.standard_normal(model.lift.shape[:2])
        rough = (model.numbering.gather @ (model.numbering.scatter @ rough.ravel() / 4)).reshape(
            rough.shape
        )  # lines hang together
        slide, direction = np.zeros_like(rough), 1e-11 * rng.standard_normal(rough.shape)
        slide[pair.slave.element[:, None], pair.slave.values[:, 0, :2]] = pair.axes[0, 0]
        slide[pair.slave.element[:, None], pair.slave.values[:, 1, :2]] = pair.axes[0, 1]
        for distance in np.linspace(0, float(pair.master.lengths[0]), 5):
            moved = rough + distance * slide
            now, ahead, behind = (compute_touch(pair, moved + k * direction, pressing, blur=1e-6) for k in (0, 1, -1))
            checked += PointGaps.from_displacements(pair, moved).kinks.any_near
            expected = 2 * (now.stiffness @ direction.ravel())
            np.testing.assert_allclose(ahead.forces - behind.forces, expected, rtol=1e-3, atol=1e-5 * np.abs(expected).max())
    assert checked >= 4


def test_a_corrected_step_solves_with_the_pressures_at_its_end() -> None:
    """Eq. CT.14 as virtual work, with gaps' derivatives by differences, where the tangent alone would lead through a wall."""
    path = pressed(scene_of("equal-blocks-6kpa"), COARSE)
    model, before = path.model, path.press_to_indentation(0.1 * path.radius).equilibrium
    changes, _ = model.compute_responses(before.state, before.equations)
    deeper = 0.15 * path.radius
    state = model.shift(before.state, before.equations, deeper * changes[:, 0], before.state.indentation + deeper)
    equations = model.factorise_tangent(model.linearise(state))
    assert equations.factor is not None
    step = -equations.factor.solve(equations.residual[:, None])[:, 0]
    corrected, expected = correct_step(model, state, equations, step)
    assert np.linalg.norm(corrected - step) > 0.02 * np.linalg.norm(step)
    gaps = np.concatenate([touch.gap for touch in equations.touches])
    reached = gaps < path.radius

    def differentiate_gaps(direction: Floats) -> Floats:
        """Return the derivative of the gaps along a direction of the unknowns."""
        small = 1e-9 / np.abs(direction).max()
        moved = [model.compute_touches(replace(state, v=state.v + sign * small * direction)) for sign in (1, -1)]
        ahead, behind = (np.concatenate([touch.gap for touch in touches])[reached] for touches in moved)
        return np.asarray((ahead - behind) / (2 * small))

    penalties, blurs, weights, multipliers = (
        np.concatenate(parts)[reached]
        for parts in (
            [np.full(pair.points, pair.penalty) for pair in model.pairs],
            [np.full(pair.points, pair.penalty * x) for pair, x in zip(model.pairs, model.compute_blurs(state), strict=True)],
            [pair.weights for pair in model.pairs],
            state.multipliers,
        )
    )
    opening, trial = differentiate_gaps(corrected), multipliers - penalties * gaps[reached]
    (now, rising), (then, _) = (compute_pressure(x, blurs) for x in (trial, trial - penalties * opening))
    assert np.any((now > 0) != (then > 0))
    np.testing.assert_allclose(np.concatenate(expected)[reached], then, atol=1e-6 * then.max())
    surplus = weights * (then - now + penalties * rising * opening)
    forces = model.assembly.assemble_tangent(equations.stiffness, equations.contact_stiffness) @ corrected + equations.residual
    for direction in np.random.default_rng(7).standard_normal((5, len(step))):
        works = surplus * differentiate_gaps(direction)
        assert forces @ direction == pytest.approx(works.sum(), abs=1e-4 * np.abs(works).sum())


def test_a_limit_of_time_names_the_force_that_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    path = pressed(scene_of("example"), COARSE)
    path.press_to_force(0.05)
    monkeypatch.setattr(resources, "find_seconds_left", lambda: 0.0)
    with pytest.raises(LimitReached, match=rf"pressing .*; {path.last.force:.3g} N is reached$"):
        path.press_to_force(0.1)


@pytest.mark.parametrize("poisson_ratio", [0.45, 0.4999])
def test_newton_s_method_ends_quadratically(poisson_ratio: float) -> None:
    path = pressed(scene_of("example", poisson_ratio=poisson_ratio), COARSE)
    for point in path.iterate_steps(0.15 * path.radius):
        residuals = [r for r in point.equilibrium.residuals if r > 1e-12]
        for a, b in pairwise(residuals):
            if a < 1e-3 and b > 1e-11:
                assert np.log(b) / np.log(a) > 1.5


def test_incompressible_bodies_take_few_more_steps() -> None:
    counts = []
    for poisson_ratio in (0.45, 0.4999):
        path = pressed(scene_of("example", poisson_ratio=poisson_ratio), COARSE)
        path.press_to_indentation(0.3 * path.radius)
        counts.append(sum(len(point.equilibrium.residuals) for point in path.points))
    assert counts[1] <= 1.5 * counts[0]


REACHED = {
    "example": scene_of("example"),
    "equal blocks": scene_of("equal-blocks-6kpa"),
    "paper": scene_of("paper"),
    "tissue of 1 kPa": scene_of("equal-blocks-6kpa", tissue={"youngs_modulus": 1e3}),
    "tissue of 10 kPa": scene_of("equal-blocks-6kpa", tissue={"youngs_modulus": 1e4}),
    "nu = 0.499": scene_of("equal-blocks-6kpa", poisson_ratio=0.499),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REACHED)
def test_half_an_outer_radius_is_reached(name: str) -> None:
    path = pressed(REACHED[name], FINE)
    point = path.press_to_indentation(0.5 * path.radius)
    assert point.residual < 1e-8
    assert all(a.force < b.force for a, b in pairwise(path.points))


@pytest.mark.slow
def test_tissue_that_reaches_the_base_ends_the_path() -> None:
    """A probe of flat blocks has no wall left for tissue that rises beside it."""
    scene = scene_of("example")
    flat = scene.probe.model_copy(update={"height": 0.1e-3})
    path = pressed(scene.model_copy(update={"probe": flat}), COARSE)
    with pytest.raises(StoppedError, match="the tissue reaches the base"):
        path.press_to_indentation(0.4 * path.radius)
    assert path.last.indentation > 0.05e-3


def test_the_cubic_through_two_states_and_their_rates_reproduces_cubics() -> None:
    """In whichever order the two places stand; between and beyond them."""
    cubic = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7])
    for places in ([0.2, 0.5], [0.5, 0.2]):
        values = [*cubic(np.array(places)), *cubic.deriv()(np.array(places))]
        for wanted in (0.3, 0.9):
            assert np.dot(compute_hermite_weights(places, wanted), values) == pytest.approx(cubic(wanted), rel=1e-12)
