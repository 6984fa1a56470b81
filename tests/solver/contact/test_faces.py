"""Faces that slide and open: against linear elements, closed forms, laws of contact, friction and energy."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from geometry import Scene
from geometry.common.errors import SolveError
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.probe import Interface
from solver.axisymmetric.base_states import build_model as linear_model
from solver.axisymmetric.base_states import solve_base_states
from solver.axisymmetric.sections import build_sections
from solver.contact.contact_forces import Grip, compute_touch
from solver.contact.model import ContactModel
from solver.contact.pairs import RoundEdge
from solver.contact.path import Path
from tests.support.load_paths import COARSE, ratio, scene_of, work

SCENE = scene_of("equal-blocks-6kpa")


def path_of(interface: Interface, friction: float = 0.0, scene: Scene = SCENE, fineness: MeridianFineness = COARSE) -> Path:
    scene_sections = build_sections(scene)
    return Path(
        ContactModel.from_section(scene_sections.section, scene_sections.materials, interface, fineness, friction), sensitive=True
    )


def linear_stiffness(interface: str, scene: Scene = SCENE, fineness: MeridianFineness = COARSE) -> np.ndarray:
    """Films' forces per indentation by linear elements on the same mesh, N/m."""
    scene_sections = build_sections(scene)
    tied = "bonded" if interface == "bonded" else "frictionless"
    return np.asarray(
        solve_base_states(linear_model(scene_sections.section, scene_sections.materials, tied, fineness)).forces.sum(axis=1)
    )


@pytest.mark.parametrize("interface", ["unilateral", "frictionless"])
def test_the_limit_of_no_load_is_that_of_linear_elements_where_nothing_pulls(interface: Interface) -> None:
    """Each side is off by what penalties give way, 1e-3 of an element at the faces."""
    at_rest = path_of(interface).points[0]
    np.testing.assert_allclose(at_rest.tangent, linear_stiffness(interface), rtol=2e-4)


def test_a_skin_far_stiffer_than_its_tissue_has_the_limit_of_linear_elements() -> None:
    """The penalty is the skin's, the forces are those of soft tissue: rounding errors of the gaps exceed a fixed tolerance."""
    inner, outer = ({"youngs_modulus": modulus, "poisson_ratio": 0.48} for modulus in (1e6, 80e3))
    sizes = {"inner_radius": 4e-3, "area_ratio": 1.2, "gap": 0.1e-3, "height": 3e-3}
    soft = {"youngs_modulus": 8e3, "poisson_ratio": 0.45}
    skin = {"thickness": 0.5e-3, "youngs_modulus": 400e3, "poisson_ratio": 0.45}
    tissue = {"shape": "cylinder", "radius": 45e-3, "depth": 50e-3, **soft, "layer": [skin]}
    probe = {**sizes, "inner": inner, "outer": outer, "base": {"rigid": True}}
    contact, load = {"interface": "frictionless"}, {"force": 1e-3}
    scene = Scene.from_tables({"probe": probe, "tissue": tissue, "contact": contact, "load": load})
    fineness = MeridianFineness(1, 0, 2)
    at_rest = path_of("frictionless", scene=scene, fineness=fineness).points[0]
    np.testing.assert_allclose(at_rest.tangent, linear_stiffness("frictionless", scene, fineness), rtol=1e-3)


def test_much_friction_is_a_bond_at_small_load() -> None:
    """But for what its springs give way: 5 % of what a bond changes at most."""
    free, bonded = linear_stiffness("unilateral"), linear_stiffness("bonded")
    held = path_of("unilateral", friction=10.0).points[0].tangent
    quotients = [tangent[0] / tangent[1] for tangent in (free, bonded, held)]
    assert abs(quotients[2] - quotients[1]) < 0.15 * abs(quotients[0] - quotients[1])


def test_forces_and_tangent_are_derivatives_with_friction_and_round_edges() -> None:
    path = path_of("unilateral")
    model, state = path.model, path._light_state
    rng, step = np.random.default_rng(0), 1e-11
    displaced = model.compute_displacements(state.v, state.indentation) + 1e-7 * rng.standard_normal(model.lift.shape[:2])
    direction = rng.standard_normal(displaced.shape)
    seen = {"held": 0, "sliding": 0}
    for frictionless, grip in zip(model.pairs[1:], ContactModel.build_rest_state(model).grips[1:], strict=True):
        assert grip is None
        pair = replace(frictionless, friction=0.3, master_edge=RoundEdge(frictionless.master_edge.place, 3e-4))
        first = compute_touch(pair, displaced, np.zeros(pair.points), blur=1e-9)
        reached = np.isfinite(first.gap)
        multiplier = rng.uniform(5e3, 1e4, pair.points) + pair.penalty * np.where(reached, first.gap, 0.0)
        slip = rng.uniform(-2e-5, 2e-5, pair.points)
        moved = Grip(first.grip.place + slip, np.zeros(pair.points), np.zeros(pair.points, dtype=int))
        touch_now, ahead, behind = (
            compute_touch(pair, displaced + k * step * direction, multiplier, 1.0, 1e-9, grip=moved) for k in (0, 1, -1)
        )
        assert not touch_now.sliding_reversed
        seen["held"] += int(np.sum((touch_now.pressure > 0) & (touch_now.grip.sliding == 0)))
        seen["sliding"] += int(np.sum(touch_now.grip.sliding != 0))
        expected = touch_now.stiffness @ direction.ravel()
        derivative = (ahead.forces - behind.forces) / (2 * step)
        np.testing.assert_allclose(derivative, expected, atol=1e-6 * np.abs(expected).max())
    assert min(seen.values()) > 3, seen


def test_a_round_edge_is_an_arc() -> None:
    edge, radii = RoundEdge(2.0, 0.5), np.linspace(1.4, 2.6, 25) + 1e-3
    taken, derivative, bend = edge.compute_removed_height(radii)
    t = (radii - 2.0) * 0.5**0.5
    rounded = np.abs(radii - 2.0) < 0.5
    # distance of what is left from the arc's centre, which lies the root of two radii above the corner
    np.testing.assert_allclose(np.hypot(t, np.abs(t) + taken - 2**0.5 * 0.5)[rounded], 0.5, rtol=1e-12)
    assert not np.any(taken[~rounded])
    ahead, behind = edge.compute_removed_height(radii + 1e-6), edge.compute_removed_height(radii - 1e-6)
    np.testing.assert_allclose((ahead[0] - behind[0]) / 2e-6, derivative, atol=1e-8)
    np.testing.assert_allclose((ahead[1] - behind[1]) / 2e-6, bend, atol=1e-6)


def test_tissue_that_slides_past_a_face_it_cannot_leave_is_refused() -> None:
    path = path_of("frictionless")
    pair = path.model.pairs[-1]
    displaced = np.zeros(path.model.lift.shape[:2])
    edge = RoundEdge(pair.master_edge.place - 2 * float(pair.master.lengths.max()), pair.master_edge.radius)
    with pytest.raises(SolveError, match="past the edge"):
        compute_touch(replace(pair, master_edge=edge), displaced, np.zeros(pair.points))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.3])
def test_laws_of_contact_and_friction_hold_along_the_path(friction: float) -> None:
    path = path_of("unilateral", friction)
    path.press_to_indentation(0.05 * path.radius)
    model, slid = path.model, 0
    block = np.any(model.lift != 0, axis=(1, 2))
    for point in path.points[1:]:
        equilibrium, length = point.equilibrium.equations, 0.02 * point.indentation
        for touch_state in equilibrium.touches[1:]:
            assert np.all(touch_state.pressure >= 0)
            assert np.all(touch_state.gap >= -1e-3 * length)
            assert np.all(touch_state.gap[touch_state.pressure > 0] < 1e-3 * length)
            assert np.all(np.abs(touch_state.grip.shear) <= friction * touch_state.normal * (1 + 1e-12))
            slid += int(np.sum(touch_state.grip.sliding != 0))
        pushed = sum(touch_state.forces for touch_state in equilibrium.touches).reshape(model.lift.shape[:2])
        on_blocks, on_tissue = (float(pushed[selection][:, model.numbering.vertical > 0].sum()) for selection in (block, ~block))
        assert -on_blocks == pytest.approx(point.force, rel=1e-9)
        assert on_tissue == pytest.approx(point.force, rel=1e-9)
    assert (slid > 0) == (friction == 0.05)  # 0.3 holds everything


@pytest.mark.slow
@pytest.mark.parametrize(("interface", "friction"), [("unilateral", 0.0), ("frictionless", 0.0), ("unilateral", 0.1)])
def test_work_is_stored_or_rubbed_away(interface: Interface, friction: float) -> None:
    path = path_of(interface, friction)
    for x in np.linspace(0.0025, 0.05, 20):
        path.press_to_indentation(x * path.radius)
    last = path.last.equilibrium
    stored = path.model.elements.compute_energy(last.state.elements)
    if friction:
        assert 1e-4 < 1 - stored / work(path) < 0.1
    else:
        assert stored == pytest.approx(work(path), rel=1e-4)


@pytest.mark.slow
def test_next_to_no_friction_is_none() -> None:
    free, rubbed = (path_of("unilateral", friction).press_to_indentation(1e-4) for friction in (0.0, 1e-7))
    np.testing.assert_allclose(rubbed.films, free.films, rtol=1e-6)
    assert rubbed.log_sensitivity == pytest.approx(free.log_sensitivity, rel=1e-5)


@pytest.mark.slow
def test_flat_punch_on_a_half_space() -> None:
    """P = 2 E a w / (1 - nu^2) (K. L. Johnson, Contact Mechanics, 1985, eq. 3.36), within 0.5 % for a gap of a tenth of a mm.

    Blocks a thousand times as stiff as the tissue; what the tissue's sides and floor add goes with one over their distance.
    """
    data, forces = SCENE.model_dump(exclude_unset=True), []
    data["inclusion"] = []
    for block in ("inner", "outer"):
        data["probe"][block] |= {"youngs_modulus": 6e6}
    for size in (0.3, 0.6):
        data["tissue"] = {"shape": "cylinder", "radius": size, "depth": size, "youngs_modulus": 6e3, "poisson_ratio": 0.3}
        scene = Scene.model_validate(data)
        at_rest = path_of("unilateral", scene=scene, fineness=MeridianFineness(1, 1, 3)).points[0]
        forces.append(at_rest.tangent.sum() / (2 * 6e3 * scene.probe.tube_radius / (1 - 0.3**2)))
    assert 2 * forces[1] - forces[0] == pytest.approx(1, abs=5e-3)


@pytest.mark.slow
def test_other_meshes_agree_while_no_point_passes_an_edge() -> None:
    """The ratio's change by the load, to 0.1 % of the ratio."""
    changes = []
    for order in (2, 3):
        path = path_of("unilateral", fineness=MeridianFineness(1, 0, order))
        point = path.press_to_indentation(0.02 * path.radius)
        changes.append(ratio(SCENE, point) / ratio(SCENE, path.points[0]))
    assert changes[0] == pytest.approx(changes[1], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_newton_s_method_ends_quadratically(friction: float) -> None:
    path = path_of("unilateral", friction)
    point = path.press_to_indentation(0.02 * path.radius)
    ends = [(a, b) for a, b in pairwise(point.equilibrium.residuals) if b < a < 1e-3]
    assert len(ends) > 3
    assert all(b < max(1e3 * a**2, 1e-8) for a, b in ends)  # rounding leaves about 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.05, 0.3])
def test_log_sensitivity_with_friction_is_the_derivative_at_one_force(friction: float) -> None:
    path = path_of("unilateral", friction)
    point, logs, step = path.press_to_indentation(0.05 * path.radius), [], 0.02
    for factor in (1 - step, 1 + step):
        data = SCENE.model_dump(exclude_unset=True)
        data["inclusion"][0]["youngs_modulus"] *= factor
        changed = Scene.model_validate(data)
        logs.append(np.log(ratio(changed, path_of("unilateral", friction, changed).press_to_force(point.force))))
    derivative = (logs[1] - logs[0]) / (np.log(1 + step) - np.log(1 - step))
    assert point.log_sensitivity == pytest.approx(derivative, rel=5e-3)
