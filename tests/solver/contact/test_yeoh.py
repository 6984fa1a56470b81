"""Probes pressed on materials of Yeoh's law: limits, uniform strain, derivatives, and what is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.optimize import brentq

from geometry import Refusal, Scene
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Body
from geometry.scenes.probe import Material
from geometry.scenes.scene_tables import Layer
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.sections import build_sections
from solver.contact.elements import ElementValues
from solver.contact.evaluator import ContactEvaluator
from solver.contact.model import ContactModel
from solver.materials.hyperelastic import Hyperelastic
from solver.planning.load_limits import build_load_rule, compute_load_limits
from tests.support.load_paths import COARSE, pressed, ratio, scene_of

EXAMPLE = scene_of("example")
SKIN = Layer(thickness=1e-3, youngs_modulus=2e4, poisson_ratio=0.45)
C2, C3 = 0.8, 0.1


def yeoh(parts: tuple[str, ...] = ("tissue",), c2: float = C2, c3: float = C3, scene: Scene = EXAMPLE) -> Scene:
    values = {"law": "yeoh", "c2_over_c1": c2, "c3_over_c1": c3}
    return scene.replace({f"{part}.{key}": value for part in parts for key, value in values.items()})


def test_uniform_strain_is_in_balance_and_stores_the_energy_of_the_law() -> None:
    """A patch test: all bodies of one material, strained alike. Within an element nothing pulls; E = W V."""
    material = {"youngs_modulus": 6e3, "poisson_ratio": 0.45}
    parts = ("probe.inner", "probe.outer", "tissue")
    scene = EXAMPLE.model_copy(update={"inclusion": ()}).replace({f"{p}.{k}": v for p in parts for k, v in material.items()})
    sections = build_sections(yeoh(parts, scene=scene))
    model = ContactModel.from_section(sections.section, sections.materials, "bonded", COARSE)
    elements, mesh = model.elements, model.mesh
    across, along = 1.3, 0.8
    rest = elements.build_rest_values()
    u = rest.u.reshape(len(rest.u), 2, -1).copy()
    r, z = np.moveaxis(compute_nodes(sections.section, mesh, UNIT_SQUARE), -1, 0)
    u[:, 0, :4], u[:, 1, :4] = (across - 1) * r, (along - 1) * z
    J, shear = across**2 * along, 6e3 / 2.9
    lam, bulk = shear * 2 * 0.45 / (1 - 0.9), 6e3 / 0.3
    p = np.zeros_like(rest.p)
    p[:, 0] = lam / 2 * (J - 1 / J)  # the first pressure function is 1
    state = ElementValues(u.reshape(rest.u.shape), p)
    balance = elements.linearise(state)[0]
    scale = np.abs(balance.internal).max(axis=1, keepdims=True)
    assert np.abs(balance.internal.reshape(u.shape)[:, :, elements.shapes.skeleton :] / scale[:, :, None]).max() < 1e-9
    x = J ** (-2 / 3) * (2 * across**2 + along**2) - 3
    density = shear / 2 * (x + C2 * x**2 + C3 * x**3) + bulk / 4 * (J**2 - 1 - 2 * np.log(J))
    assert elements.compute_energy(state) == pytest.approx(density * elements.square.weight.sum(), rel=1e-9)


@pytest.mark.slow
def test_constants_of_zero_leave_every_digit() -> None:
    result, plain = (ContactEvaluator().evaluate(scene) for scene in (yeoh(c2=0.0, c3=0.0), EXAMPLE))
    assert (result.stress_inner, result.ratio, result.log_sensitivity) == (plain.stress_inner, plain.ratio, plain.log_sensitivity)


def test_small_loads_do_not_feel_the_law() -> None:
    light = yeoh(("tissue", "probe.inner", "probe.outer", "inclusion")).replace({"load.indentation": 1e-6})
    result, linear = ContactEvaluator().evaluate(light), Axisymmetric().evaluate(light, 1e-3)
    assert result.ratio == pytest.approx(linear.ratio, rel=2e-3)
    assert result.stiffness == pytest.approx(linear.stiffness, rel=1e-3)
    assert result.log_sensitivity == pytest.approx(linear.log_sensitivity, rel=5e-3)


def test_a_stiffening_tissue_resists_more_the_deeper_it_is_pressed() -> None:
    paths = [pressed(scene, COARSE) for scene in (EXAMPLE, yeoh())]
    forces = np.array([[path.press_to_indentation(depth).force for path in paths] for depth in (2e-4, 5e-4, 1e-3)])
    excess = forces[:, 1] / forces[:, 0] - 1
    assert np.all(np.diff(excess) > 0)
    assert excess[0] > 0


@pytest.mark.parametrize("parts", [("tissue",), ("tissue", "inclusion", "probe.outer")])
def test_the_log_sensitivity_is_a_derivative_at_one_force(parts: tuple[str, ...]) -> None:
    scene, force, step = yeoh(parts), 0.06, 1e-3
    modulus = scene.inclusion[0].youngs_modulus
    ends = []
    for sign in (1, -1):
        turned = scene.replace({"inclusion.youngs_modulus": modulus * float(np.exp(sign * step))})
        ends.append(np.log(ratio(turned, pressed(turned, COARSE).press_to_force(force))))
    expected = (ends[0] - ends[1]) / (2 * step)
    assert pressed(scene, COARSE).press_to_force(force).log_sensitivity == pytest.approx(expected, rel=2e-3)


def test_a_law_that_is_not_stable_under_the_load_is_refused_in_one_sentence() -> None:
    """By the plane mode the stress of c2 = -0.3 stops rising at I - 3 = 0.34 or so, which a corner reaches early."""
    scene = yeoh(c2=-0.3, c3=0.0).replace({"load.force": 0.1})
    law = "Yeoh's law with c2_over_c1 = -0.3, c3_over_c1 = 0"
    sentence = rf"up to 0\.0\d+ N for contact: .*{law} is unstable where a material is stretched beyond"
    with pytest.raises(Refusal, match=sentence) as fault:
        ContactEvaluator().evaluate(scene)
    assert "\n" not in str(fault.value)
    assert re.match(r"load.force = 0.1 N", str(fault.value))


@pytest.mark.slow
def test_a_slightly_softening_law_is_used_while_it_is_stable() -> None:
    soft, plain = (ContactEvaluator().evaluate(scene) for scene in (yeoh(c2=-0.02, c3=0.0), EXAMPLE))
    assert soft.stiffness < plain.stiffness


@pytest.mark.parametrize(
    ("parts", "c2", "c3"),
    [(("tissue",), 1.0, 0.0), (("tissue",), 20.0, 0.0), (("tissue",), 0.0, 3.0), (("inclusion",), 8.0, 1.0)],
)
def test_the_linear_limit_knows_the_law(parts: tuple[str, ...], c2: float, c3: float) -> None:
    """At the limits that the rule sets, ratio and log-sensitivity have changed by no more than it says."""
    scene, accuracy = yeoh(parts, c2, c3), 0.01
    limits, plain = (compute_load_limits(case, accuracy) for case in (scene, EXAMPLE))
    assert limits.auto.force < plain.auto.force
    path, rule = pressed(scene, COARSE), build_load_rule(scene)
    for limit in (rule.find_ratio_limit(accuracy), rule.find_sensitivity_limit(accuracy)):
        point = path.press_to_force(limit.force)
        if limit.by == "log_sensitivity":
            assert point.log_sensitivity == pytest.approx(path.points[0].log_sensitivity, rel=5 * accuracy)
        allowed = max(accuracy, rule.bound_ratio_change(limit.force))
        assert ratio(scene, point) == pytest.approx(ratio(scene, path.points[0]), rel=allowed)


def test_layers_and_blocks_have_laws_of_their_own() -> None:
    layered = EXAMPLE.model_copy(update={"tissue": EXAMPLE.tissue.model_copy(update={"layer": (SKIN,)})})
    for part, body in (("tissue.layer[0]", Body.LAYER_0), ("probe.inner", Body.INNER)):
        scene = yeoh((part,), scene=layered)
        sections = build_sections(scene)
        model = ContactModel.from_section(sections.section, sections.materials, "bonded", COARSE)
        ((elements, law),) = model.elements.material.laws
        assert set(model.mesh.body[elements]) == {body}
        assert law.description == "Yeoh's law with c2_over_c1 = 0.8, c3_over_c1 = 0.1"


def test_a_lubricated_cylinder_has_the_closed_form_of_its_law() -> None:
    """CONTACT.md's exact check with Yeoh's law: nominal stress 2 (s - 1/s^2) dW/dI1 of an incompressible body."""
    nu, s, E = 0.49999, 0.5, 1.0
    values = {"youngs_modulus": E, "poisson_ratio": nu, "law": "yeoh", "c2_over_c1": C2, "c3_over_c1": C3}
    law = Hyperelastic.from_materials([Material.model_validate(values)])

    def pressed_sides(across: float) -> tuple[float, float]:
        h = np.array([across - 1, 0.0, 0.0, s - 1, across - 1])[:, None, None]
        J = across**2 * s
        p = law.lam / 2 * (J - 1 / J)  # eq. LW.3
        stress = law.compute_stress(h)
        first = stress.first_piola[:, 0, 0] + p * stress.cofactor[:, 0, 0]
        return float(first[0]), float(first[3])

    across = brentq(lambda a: pressed_sides(a)[0], 0.9 / np.sqrt(s), 1.1 / np.sqrt(s), xtol=1e-15)
    x = s**2 + 2 / s - 3
    mu = E / (2 * (1 + nu))
    expected = mu * (s - s**-2) * (1 + 2 * C2 * x + 3 * C3 * x**2)
    assert pressed_sides(across)[1] == pytest.approx(expected, rel=2e-4)


@pytest.mark.slow
def test_a_strain_beyond_the_curve_of_a_law_warns() -> None:
    light, heavy = (yeoh().replace({"tissue.law_strain": 0.2, "load.force": force}) for force in (0.005, 0.15))
    assert [note for note in ContactEvaluator().evaluate(light).warnings if "extrapolated" in note] == []
    (note,) = [note for note in ContactEvaluator().evaluate(heavy).warnings if "extrapolated" in note]
    assert note.startswith("tissue: ")
    assert "beyond a strain of 0.2" in note
