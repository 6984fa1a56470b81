"""Round edges of the blocks: they close as the load grows; laws that hold on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry import Refusal, Scene, scene_to_toml
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Body
from geometry.scenes.scene_tables import Contact, Load
from solver.axisymmetric.sections import build_sections
from solver.contact.evaluator import ContactEvaluator
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.evaluation import evaluate
from solver.materials.hyperelastic import Hyperelastic
from solver.materials.linear import Isotropic
from solver.planning.plan import build_plan
from tests.support.load_paths import COARSE, pressed, ratio, scene_of, work

SHARP = scene_of("equal-blocks-6kpa")


def round_scene(radius: float) -> Scene:
    return SHARP.model_copy(update={"contact": Contact(edge_radius=radius)})


def test_stiffness_falls_with_the_radius_at_rest_to_that_of_sharp_edges() -> None:
    """Less of the faces is bonded: energy needs less, and next to nothing is as good as nothing."""
    radii = (0.0, 1e-5, 1e-4, 3e-4)
    stiffnesses = [float(pressed(round_scene(radius), COARSE).points[0].tangent.sum()) for radius in radii]
    assert np.all(np.diff(stiffnesses[1:]) < 0)
    assert stiffnesses[1] == pytest.approx(stiffnesses[0], rel=1e-2)


def test_edges_close_under_load_and_store_the_work_that_is_done() -> None:
    path = pressed(round_scene(2e-4), COARSE)
    for x in np.linspace(0.005, 0.03, 6):
        path.press_to_indentation(x * path.radius)
    points = path.points
    growing = [point.force / point.indentation for point in points[1:]]
    assert growing[-1] > float(points[0].tangent.sum())
    assert path.model.elements.compute_energy(points[-1].equilibrium.state.elements) == pytest.approx(work(path), rel=1e-4)
    for point in points[1:]:
        lengths = path.model.compute_contact_lengths(point.indentation)
        for length, touch in zip(lengths, point.equilibrium.equations.touches, strict=True):
            assert np.all(touch.pressure >= 0)
            assert np.all(touch.gap >= -1e-3 * length)
    reached = points[-1].equilibrium.equations.touches[-1]
    contact_places = path.model.pairs[-1].slave_places[reached.pressure > 0]
    assert 0 < float(contact_places.max()) < 1e-3  # tissue lies on a part of the arc, not on the wall above it


@pytest.mark.slow
def test_frictionless_faces_end_where_round_edges_begin() -> None:
    """Less of the faces is held: the probe is softer than with sharp edges, and stiffens as the edges close."""
    sharp, rounded = (SHARP.model_copy(update={"contact": Contact(interface="frictionless", edge_radius=r)}) for r in (0.0, 2e-4))
    at_rest, lying, deeper = (
        float(ContactEvaluator().prepare_scene(scene).press_to_indentation(depth).films.totals.sum())
        for scene, depth in ((sharp, 0.0), (rounded, 0.0), (rounded, 1e-4))
    )
    assert 0.9 * at_rest < lying < deeper < 1.05 * at_rest


def test_only_contact_takes_them() -> None:
    scene = round_scene(1e-4)
    for name in ("closed-form", "equivalent-inclusion", "axisymmetric", "solid"):
        with pytest.raises(Refusal, match=r"contact for contact\.edge_radius"):
            evaluate(scene, name)
    with pytest.raises(Refusal, match=r"contact for contact\.edge_radius"):
        evaluate(scene, linear=True)
    assert build_plan(scene, 0.02).evaluator == "contact"
    with pytest.raises(Refusal, match=r"load\.force = 1e\+06 N: .* by the probe's outer radius$"):  # without a linear way round
        evaluate(scene.model_copy(update={"load": Load(force=1e6)}))


def test_a_file_keeps_the_radius() -> None:
    scene = round_scene(1.5e-4)
    assert 'edge_radius = "0.15 mm"' in scene_to_toml(scene)


@pytest.mark.slow
def test_the_material_beyond_the_arc_changes_less_than_is_stated() -> None:
    """The blocks' corners, a third softer, stand for those that are cut off."""
    radius = 3e-4
    scene_sections = build_sections(round_scene(radius))
    model = ContactModel.from_section(scene_sections.section, scene_sections.materials, "bonded", COARSE)
    r, z = compute_nodes(scene_sections.section, model.mesh, UNIT_SQUARE).mean(axis=1).T
    walls = (
        scene_sections.section.inner_radius - radius / 2,
        scene_sections.section.hole_radius + radius / 2,
        scene_sections.section.tube_radius - radius / 2,
    )
    corner = (z > 0) & (z < radius) & np.any([np.abs(r - wall) < radius / 2 for wall in walls], axis=0)
    laws = np.array(
        [
            [scene_sections.materials[Body(body)].youngs_modulus, scene_sections.materials[Body(body)].poisson_ratio]
            for body in model.mesh.body
        ]
    )
    laws[corner, 0] *= 2 / 3
    softer = replace(model, elements=replace(model.elements, material=Hyperelastic.from_moduli(Isotropic(*laws.T))))
    whole, cut = (Path(source_model, sensitive=True).press_to_indentation(0.1 * 5.5e-3) for source_model in (model, softer))
    stated = ContactEvaluator().prepare_scene(round_scene(radius)).min_errors[0]
    assert corner.sum() >= 3
    assert ratio(SHARP, cut) == pytest.approx(ratio(SHARP, whole), rel=stated)
    assert cut.log_sensitivity == pytest.approx(whole.log_sensitivity, rel=stated)
