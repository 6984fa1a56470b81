"""The closed form against quadrature, an independent code's scenes, finite elements and limits."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scenes import Expected, expected
from scipy.integrate import quad
from scipy.special import hyp2f1, j0, j1

from geometry import CylinderTissue, HalfSpaceTissue, Inclusion, InputError, Load, Refusal, Scene
from solver import evaluate, half_space
from solver.closed_form import ClosedForm, function, parameters
from solver.compatibility import Ball, Block, Layer, polarisabilities

SCENES = expected("axisymmetric") + expected("extra") + expected("solid")


@pytest.mark.parametrize("one", SCENES, ids=lambda one: one.name)
def test_stated_error_is_not_below_the_true_one(one: Expected) -> None:
    if any(body.depth - body.diameter / 2 < 0.1 * body.diameter for body in one.scene.inclusion):
        with pytest.raises(Refusal, match="axisymmetric"):
            evaluate(one.scene, "closed-form")
        return
    result = evaluate(one.scene, "closed-form")
    assert abs(result.ratio / one.ratio - 1) <= result.error_estimate + one.uncertainty


def test_deep_and_real_scenes_are_close() -> None:
    # scenes of a probe with realistic moduli, a 3D code's ratios
    for one in expected("solid"):
        assert evaluate(one.scene, "closed-form").ratio == pytest.approx(one.ratio, rel=0.05)


@pytest.mark.parametrize(("a", "b"), [(0.1, 1.0), (0.7, 1.0), (0.999, 1.0)])
def test_work_of_discs(a: float, b: float) -> None:
    # Weber-Schafheitlin, DLMF 10.22.56, summed by scipy
    exact = 4 * np.pi * (1 - 0.3**2) / 2.0 * a * b * a / 2 * hyp2f1(0.5, -0.5, 2, (a / b) ** 2)
    assert float(half_space.work(a, b, 2.0, 0.3)) == pytest.approx(exact, rel=1e-12)
    assert float(half_space.work(a * (1 - 1e-9), a, 2.0, 0.3)) == pytest.approx(half_space.work_same(a, 2.0, 0.3), rel=1e-8)


@pytest.mark.parametrize(("a", "b", "nodes"), [(0.2, 0.5, 24), (0.8, 0.8, 24), (1.0, 1.5, 48)])
def test_layer_correction(a: float, b: float, nodes: int) -> None:
    nu, depth = 0.4, 1.0
    m = 3 - 4 * nu

    def integrand(x: float) -> float:
        kernel = (2 * m * np.sinh(2 * x) - 4 * x) / (2 * m * np.cosh(2 * x) + 1 + m**2 + 4 * x**2)
        return float(j1(x * a) * j1(x * b) * (kernel - 1) / x**2)

    exact = 4 * np.pi * (1 - nu**2) * a * b * depth * quad(integrand, 0, 20, limit=400)[0]
    found = half_space.layer_correction([ca.SX(a), ca.SX(b)], depth, 1.0, nu, nodes)
    assert float(ca.evalf(found)[0, 1]) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(("r", "z"), [(0.5, 1.0), (0.01, 1.0), (1.5, 0.7)])
def test_strain_under_a_disc(r: float, z: float) -> None:
    a, nu = 1.0, 0.4

    def integral(f: object) -> float:
        return quad(f, 0, 60 / z, limit=2000)[0]  # type: ignore[arg-type]

    A = a * integral(lambda k: np.exp(-k * z) * j1(k * a) * j0(k * r))
    zA = a * z * integral(lambda k: k * np.exp(-k * z) * j1(k * a) * j0(k * r))
    zC = a * z * integral(lambda k: k * np.exp(-k * z) * j1(k * a) * j1(k * r))
    rr, hoop, zz, rz = (float(ca.evalf(part)) for part in half_space.strain([ca.SX(a)], r, z, 1.0, nu))
    assert zz == pytest.approx(-(1 + nu) * ((1 - 2 * nu) * A + zA), rel=2e-5)
    assert rr + hoop + zz == pytest.approx(-2 * (1 + nu) * (1 - 2 * nu) * A, rel=1e-5)
    assert rz == pytest.approx(-(1 + nu) * zC, rel=1e-5)


def test_strain_on_the_axis_is_boussinesq() -> None:
    # stress on the axis: sigma [1 - (d / sqrt(a^2 + d^2))^3] (PHYSICS section 1); Hooke's law from the strains
    E, nu, a, d = 2.0, 0.3, 1.0, 2.0
    rr, hoop, zz, _ = (float(ca.evalf(part)) for part in half_space.strain([ca.SX(a)], 1e-4, d, E, nu))
    stress = E / ((1 + nu) * (1 - 2 * nu)) * ((1 - nu) * zz + nu * (rr + hoop))
    assert -stress == pytest.approx(1 - (d / np.hypot(a, d)) ** 3, rel=1e-6)


@pytest.mark.parametrize(
    ("radius_per_height", "nu", "apparent"),
    # bonded at both ends, an independent code's values, PHYSICS section 7
    [
        (1, 0.3, 1.118576),
        (1, 0.49, 1.502552),
        (1, 0.4999, 1.544227),
        (5, 0.3, 1.290414),
        (5, 0.49, 7.021501),
        (5, 0.4999, 13.034977),
    ],
)
def test_apparent_modulus_is_within_its_stated_12_percent(radius_per_height: float, nu: float, apparent: float) -> None:
    half = Block(0.0, 1.0, 0.5 / radius_per_height, 1.0, nu)  # one end free to widen: half of a bonded cylinder
    assert half.apparent_modulus == pytest.approx(apparent, rel=0.125)


def test_inclusion_of_matrix_modulus_has_no_polarisability() -> None:
    assert polarisabilities(Layer(None, 5.0, 0.4), Ball(1.0, 2.0, 0.0, 5.0, 0.4)) == pytest.approx((0.0, 0.0), abs=1e-15)


def test_slope_and_gradient_are_exact() -> None:
    shape, values = parameters(expected("axisymmetric")[0].scene)
    f = function(shape)
    step = 1e-5

    def forces(k: int, factor: float) -> np.ndarray:
        moved = values.copy()
        moved[k] *= factor
        return np.array(f(moved)[0])

    modulus = len(values) - 2
    difference = (forces(modulus, 1 + step) - forces(modulus, 1 - step)) / (2 * step)
    assert np.array(f(values)[1]) == pytest.approx(difference, rel=1e-4)
    gradient = np.array(f.jacobian()(values, *f(values))[0])
    for k, value in enumerate(values):
        if value:
            by_parts = (forces(k, 1 + step) - forces(k, 1 - step)).ravel(order="F") / (2 * step * value)
            assert gradient[:, k] == pytest.approx(by_parts, rel=1e-4, abs=1e-6 * np.abs(by_parts).max() + 1e-9)


def test_forces_are_symmetric_positive_and_grow_with_every_modulus() -> None:
    shape, values = parameters(expected("axisymmetric")[3].scene)
    f = function(shape)
    forces = np.array(f(values)[0])
    assert forces == pytest.approx(forces.T, rel=1e-10)
    assert np.all(np.linalg.eigvalsh(forces) > 0)
    for k in (5, 7, 10, len(values) - 2):  # the moduli: Rayleigh
        stiffer = values.copy()
        stiffer[k] *= 1.3
        assert np.linalg.eigvalsh(np.array(f(stiffer)[0]) - forces).min() > -1e-9 * forces.max()


def test_deep_layer_is_a_half_space() -> None:
    scene = expected("axisymmetric")[0].scene
    deep = CylinderTissue(shape="cylinder", radius=20.0 / 3, depth=9.9, youngs_modulus=1e3, poisson_ratio=0.4)
    endless = HalfSpaceTissue(shape="half-space", youngs_modulus=1e3, poisson_ratio=0.4)
    one, other = (evaluate(scene.model_copy(update={"tissue": tissue}), "closed-form") for tissue in (deep, endless))
    assert one.stiffness == pytest.approx(other.stiffness, rel=2e-3)


def test_two_halves_of_the_effect_add() -> None:
    # inclusions far off the axis and from each other: the first order is additive, and symmetric under mirroring
    scene = expected("solid")[0].scene
    base = {"diameter": 4e-3, "depth": 9e-3, "youngs_modulus": 6e4, "poisson_ratio": 0.45}
    right, left = Inclusion(x=8e-3, target=True, **base), Inclusion(x=-8e-3, **base)
    ratio = [
        evaluate(scene.model_copy(update={"inclusion": bodies}), "closed-form").stiffness
        for bodies in ((), (right,), (left.model_copy(update={"target": True}),), (right, left))
    ]
    assert ratio[1] == pytest.approx(ratio[2], rel=1e-12)
    assert ratio[3] - ratio[0] == pytest.approx(2 * (ratio[1] - ratio[0]), rel=0.01)


def test_refuses_shallow_inclusions() -> None:
    scene = expected("axisymmetric")[3].scene
    shallow = scene.inclusion[0].model_copy(update={"depth": 4.5e-3})
    with pytest.raises(Refusal, match="axisymmetric"):
        ClosedForm().evaluate(scene.model_copy(update={"inclusion": (shallow,)}))


def test_refuses_tilt() -> None:
    scene = expected("solid")[0].scene
    tilted = scene.model_copy(update={"placement": scene.placement.model_copy(update={"tilt": 0.01})})
    with pytest.raises(InputError, match="tilt"):
        evaluate(tilted, "closed-form")


def test_load_scales_stress() -> None:
    scene = expected("axisymmetric")[0].scene
    one, ten = (evaluate(scene.model_copy(update={"load": Load(force=force)}), "closed-form") for force in (1e-3, 1e-2))
    assert ten.stress_outer == pytest.approx(10 * one.stress_outer, rel=1e-12)
    assert ten.ratio == one.ratio


def test_more_rings_change_less() -> None:
    shape, values = parameters(expected("axisymmetric")[2].scene)

    def ratio(rings: int) -> float:
        inner, outer = np.array(function(replace(shape, rings=rings))(values)[0]).sum(axis=1)
        return float(np.log(inner / outer))

    assert abs(ratio(6) - ratio(3)) < abs(ratio(3) - ratio(1)) / 2


def test_target_of_none() -> None:
    scene: Scene = expected("axisymmetric")[2].scene
    result = evaluate(scene, "closed-form")
    assert result.log_sensitivity is None
    assert any("log_sensitivity is null" in warning for warning in result.warnings)
