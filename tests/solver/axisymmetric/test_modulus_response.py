"""The curve over a modulus: from one factorisation, against one factorisation for each modulus."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import InputError, Load, Material, Refusal, Scene, SolveError
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body
from solver import curve, evaluate
from solver.axisymmetric.base_states import BaseStates, build_model, solve_base_states
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.modulus_response import compute_response
from solver.axisymmetric.sections import build_sections
from tests.support.references import named
from tests.support.slow import slow_unless

LEVEL = MeridianFineness(1, 2, 4)


def states(scene: Scene, body: Body, factor: float) -> BaseStates:
    """Base states with one body's modulus multiplied."""
    scene_sections = build_sections(scene)
    material = scene_sections.materials[body]
    stiffer = Material(youngs_modulus=material.youngs_modulus * factor, poisson_ratio=material.poisson_ratio)
    interface = scene.contact.interface
    assert interface != "unilateral"
    return solve_base_states(build_model(scene_sections.section, {**scene_sections.materials, body: stiffer}, interface, LEVEL))


@pytest.mark.parametrize(
    ("folder", "name", "body", "tolerance"),
    [
        ("axisymmetric", "shallow", Body.INCLUSION, 1e-9),
        ("axisymmetric", "nearly-incompressible", Body.INCLUSION, 1e-8),
        ("extra", "thin-cover-stiff", Body.INCLUSION, 1e-8),
        ("extreme", "incompressible-six-nines-frictionless", Body.INCLUSION, 2e-6),  # rounding, which differs by processor
        ("axisymmetric", "shallow", Body.OUTER, 1e-9),
        ("axisymmetric", "homogeneous", Body.TISSUE, 1e-9),
    ],
)
def test_every_modulus_from_one_factorisation(folder: str, name: str, body: Body, tolerance: float) -> None:
    scene = named(folder, name).scene
    modulus_response, _ = compute_response(states(scene, body, 1.0), 1e-3, 1e3, body)
    times = np.array([1e-3, 0.03, 1.0, 7.0, 1e3])
    forces, derivatives = modulus_response.evaluate(times)
    for t, F, dF in zip(times, forces, derivatives, strict=True):
        alone = states(scene, body, t)
        assert pytest.approx(alone.forces, rel=tolerance) == F
        assert dF == pytest.approx(
            alone.compute_modulus_derivative(body),
            abs=max(1e-5, 1e3 * tolerance) * np.abs(alone.compute_modulus_derivative(body)).max(),
        )


def test_slope_is_the_derivative_of_the_forces() -> None:
    modulus_response, _ = compute_response(states(named("axisymmetric", "shallow").scene, Body.INCLUSION, 1.0), 0.1, 10.0)
    step = 1e-4
    for t in (0.2, 1.0, 5.0):
        upper, lower = modulus_response.evaluate(np.array([t * np.exp(step), t * np.exp(-step)]))[0]
        assert modulus_response.evaluate(np.array([t]))[1][0] == pytest.approx((upper - lower) / (2 * step), rel=1e-6)


def test_a_body_that_is_not_there_is_refused() -> None:
    with pytest.raises(SolveError, match="inclusion"):
        compute_response(states(named("axisymmetric", "homogeneous").scene, Body.TISSUE, 1.0), 0.5, 2.0)


@pytest.mark.parametrize("name", slow_unless("soft-cyst".__eq__, ["soft-cyst", "published-materials-frictionless"]))
def test_curve_agrees_with_evaluate(name: str) -> None:
    scene = named("axisymmetric", name).scene.model_copy(update={"load": Load(force=0.0)})  # at which all is linear
    modulus_curve = curve(scene, np.array([1e2, 3e3, 1e6]), accuracy=1e-3)
    for modulus, ratio, log_sensitivity, error in zip(
        modulus_curve.youngs_modulus,
        modulus_curve.ratio,
        modulus_curve.log_sensitivity,
        modulus_curve.error_estimate,
        strict=True,
    ):
        alone = evaluate(scene.replace({"inclusion.youngs_modulus": modulus}), accuracy=1e-4)
        assert ratio == pytest.approx(alone.ratio, rel=error + alone.error_estimate)
        assert log_sensitivity == pytest.approx(alone.log_sensitivity, rel=5e-3, abs=1e-5)
        assert error <= 1e-3


def test_curve_reaches_an_independent_codes_value_at_its_own_modulus() -> None:
    reference = named("extra", "deep-large-cover")
    modulus = reference.scene.inclusion[0].youngs_modulus
    modulus_curve = curve(reference.scene, np.array([0.01 * modulus, modulus, 100 * modulus]), accuracy=1e-3)
    assert modulus_curve.ratio[1] == pytest.approx(reference.ratio, rel=modulus_curve.error_estimate[1])
    assert modulus_curve.log_sensitivity[1] == pytest.approx(reference.log_sensitivity, rel=5e-3)


def test_curve_needs_an_inclusion_and_moduli() -> None:
    scene = named("axisymmetric", "shallow").scene
    with pytest.raises(InputError, match="inclusion"):
        curve(named("axisymmetric", "homogeneous").scene, np.array([1e3]))
    for moduli in (np.array([]), np.array([1e3, -1.0]), np.array([np.nan]), np.array([[1e3]])):
        with pytest.raises(InputError, match="moduli"):
            Axisymmetric().curve(scene, moduli)
    with pytest.raises(InputError, match="accuracy"):
        curve(scene, np.array([1e3]), accuracy=2.0)
    with pytest.raises(Refusal, match="equivalent-inclusion"):
        Axisymmetric().curve(named("solid", "flank").scene, np.array([1e3]))
