"""Elastic multipoles about a sphere: fields against the equations they solve, scattering against Eshelby and exact fractions."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import sph_harm_y

from solver.inclusions.projection import build_projection
from solver.inclusions.solid_harmonics import SolidHarmonics
from solver.inclusions.sphere_scattering import compute_scattering, compute_surface_values
from solver.inclusions.vector_modes import VOIGT_PAIRS, Modes, Parity, Side

Array = NDArray[Any]
FULL = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # Voigt's places in a 3 x 3 tensor
SIDES: tuple[Side, ...] = ("regular", "outgoing")
NEARLY = (0.0, 0.3, 0.4999, 0.499999)


def scattered_points(number: int, low: float, high: float) -> Array:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(number, 3))
    return x / np.linalg.norm(x, axis=1)[:, None] * rng.uniform(low, high, (number, 1))


def derivatives(field: Any, x: Array) -> Array:
    """Derivatives by central differences of order six, axis last: (n, ..., 3)."""
    h, weights = 2e-3, ((1, 45 / 60), (2, -9 / 60), (3, 1 / 60))
    return np.stack([sum(w * (field(x + s * h * e) - field(x - s * h * e)) for s, w in weights) / h for e in np.eye(3)], axis=-1)


def uniform(modes: Modes, strain: Array) -> Array:
    sphere = build_projection(modes)
    return sphere.compute_coefficients((sphere.points @ strain)[:, :, None])[:, 0]


def strengths(E: float, nu: float, sphere_E: float, sphere_nu: float) -> tuple[float, float]:
    """Eshelby's sphere, PHYSICS section 4, in fractions: 1 - alpha and differences of bulk moduli cancel near nu = 1/2."""
    e, v, f, w = (Fraction(value) for value in (E, nu, sphere_E, sphere_nu))
    K, mu = e / (3 * (1 - 2 * v)), e / (2 * (1 + v))
    alpha, beta = (1 + v) / (3 * (1 - v)), 2 * (4 - 5 * v) / (15 * (1 - v))
    dK, dmu = f / (3 * (1 - 2 * w)) - K, f / (2 * (1 + w)) - mu
    return float(dK / (1 + alpha * dK / K)), float(2 * dmu / (1 + beta * dmu / mu))


@pytest.mark.parametrize("order", [0, 3, 12])
def test_harmonics_are_scipys(order: int) -> None:
    harmonics, x = SolidHarmonics(12, order), scattered_points(20, 0.7, 1.5)
    r, phi = np.linalg.norm(x, axis=1), np.arctan2(x[:, 1], x[:, 0])
    for side in SIDES:
        table = harmonics.evaluate(x, side)
        for n, m in [(a, b) for a in range(13) for b in range(min(a, order) + 1)]:
            Y = (-1) ** m * (np.sqrt(2) if m else 1) * sph_harm_y(n, m, np.arccos(x[:, 2] / r), phi)
            Y = Y * (r**n if side == "regular" else r ** (-n - 1))
            row = harmonics.find_row(n, m)
            assert table[row] == pytest.approx(Y.real, rel=1e-12, abs=1e-13 * np.abs(Y).max())
            assert table[harmonics.count + row] == pytest.approx(Y.imag, rel=1e-12, abs=1e-13 * np.abs(Y).max())


@pytest.mark.parametrize("parity", ["even", "both"])
@pytest.mark.parametrize("nu", [0.0, 0.25, 0.4999])  # 0.25 and 0: kind 0 of l = 3 and 4 has no grad_s part
@pytest.mark.parametrize("side", SIDES)
def test_fields_balance(side: Side, nu: float, parity: Parity) -> None:
    """Stress is Hooke's of the displacement's derivatives, and its divergence is zero."""
    modes, x = Modes(5, nu, 4, parity), scattered_points(6, 1.05, 1.4)
    unit_states, field = np.eye(len(modes)), modes.evaluate_regular if side == "regular" else modes.evaluate_outgoing
    u, stress = field(x, unit_states)
    gradient = derivatives(lambda places: field(places, unit_states)[0], x)
    strain = np.stack([(gradient[:, i, :, j] + gradient[:, j, :, i]) / 2 for i, j in VOIGT_PAIRS], axis=1)
    pressure = stress[:, :3].sum(axis=1) / (1 + nu)  # not lam times dilation, which amplifies the differences' errors near 1/2
    assert (1 - 2 * nu) * pressure == pytest.approx(strain[:, :3].sum(axis=1), abs=1e-10)
    strain[:, :3] += nu * pressure[:, None]
    assert stress == pytest.approx(strain, abs=1e-10 * np.abs(stress).max())
    change = derivatives(lambda places: field(places, unit_states)[1], x)
    divergence = sum(change[..., j][:, [row[j] for row in FULL]] for j in range(3))
    assert divergence == pytest.approx(np.zeros_like(u), abs=1e-10 * np.abs(change).max())
    assert modes.evaluate_shapes(x, side) == pytest.approx(u, abs=1e-14)
    assert modes.evaluate_displacement(x, unit_states, side) == pytest.approx(u, abs=1e-14)
    assert np.abs(u).max() < 2.5 * 1.4**6


def test_outward_decay_and_inward_regularity() -> None:
    """Powers of rho: l - 1, l + 1, l and -l, -l - 2, -l - 1 by kind."""
    modes, x = Modes(6, 0.4, 6, "both"), scattered_points(1, 1, 1)
    n = modes.ell
    powers = {"regular": np.choose(modes.kind, [n - 1, n + 1, n]), "outgoing": np.choose(modes.kind, [-n, -n - 2, -n - 1])}
    for side, power in powers.items():
        assert modes.evaluate_shapes(2 * x, side) == pytest.approx(
            2.0**power * modes.evaluate_shapes(x, side), rel=1e-9, abs=1e-14
        )
    assert np.isfinite(modes.evaluate_regular(np.zeros((1, 3)), np.eye(len(modes)))[1]).all()


def test_even_fields_mirror_and_axisymmetric_ones_turn() -> None:
    modes, x = Modes(6, 0.4, 6), scattered_points(9, 1.1, 2)
    mirror = np.array([1, -1, 1])
    for side in SIDES:
        assert modes.evaluate_shapes(x * mirror, side) == pytest.approx(
            modes.evaluate_shapes(x, side) * mirror[:, None], abs=1e-13
        )
    round_ones = Modes(6, 0.4, 0)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    turned = round_ones.evaluate_shapes(x @ turn.T, "outgoing")
    assert turned == pytest.approx(np.einsum("ij,njk->nik", turn, round_ones.evaluate_shapes(x, "outgoing")), abs=1e-14)
    meridian = round_ones.evaluate_shapes(np.array([[0.8, 0, 0.6]]), "regular")
    assert np.abs(meridian[:, 1]).max() == 0  # no torsion


@pytest.mark.parametrize(
    ("degree", "order", "parity"),
    [(10, 10, "even"), (10, 0, "even"), (7, 3, "both"), (4, 0, "both"), (30, 0, "even"), (30, 4, "even"), (1, 1, "both")],
)
@pytest.mark.parametrize("nu", [0.3, 0.499999])
def test_projection_returns_the_coefficients(degree: int, order: int, parity: Parity, nu: float) -> None:
    modes = Modes(degree, nu, order, parity)
    sphere = build_projection(modes, oversample=2)
    coefficients = sphere.compute_coefficients(modes.evaluate_shapes(sphere.points, "regular"))
    assert np.abs(coefficients - np.eye(len(modes))).max() < (1e-14 if degree < 11 else 5e-13) * 5
    assert sphere.weights.sum() == pytest.approx(4 * np.pi, rel=1e-13)


@pytest.mark.parametrize(("parity", "order"), [("even", 4), ("both", 4), ("even", 0)])
def test_higher_degrees_do_not_alias(parity: Parity, order: int) -> None:
    """Harmonics up to degree + oversample, of all their azimuthal orders, leave the lower ones alone."""
    modes = Modes(4, 0.4, order, parity)
    sphere, high = build_projection(modes, oversample=5), Modes(8, 0.4, 8 if order else 0, parity)
    coefficients = sphere.compute_coefficients(high.evaluate_shapes(sphere.points, "regular"))
    kept = [np.flatnonzero((label == high.labels.T).all(axis=1))[0] for label in modes.labels.T]
    assert coefficients[:, kept] == pytest.approx(np.eye(len(modes)), abs=1e-13)
    assert np.abs(np.delete(coefficients, kept, axis=1)).max() < 1e-13


@pytest.mark.parametrize("nu", [0.0, 0.4999])
def test_works_by_integrals(nu: float) -> None:
    """Betti's work of outgoing on regular modes over a sphere is -work and diagonal."""
    modes = Modes(5, nu, 5, "both")
    sphere, unit_states = build_projection(modes, oversample=4), np.eye(len(modes))
    fields = [modes.evaluate_outgoing(sphere.points, unit_states), modes.evaluate_regular(sphere.points, unit_states)]
    (u, t), (v, s) = ((u, np.einsum("nijk,nj->nik", stress[:, FULL], sphere.points)) for u, stress in fields)
    works = np.einsum("nik,nil,n->lk", t, v, sphere.weights) - np.einsum("nik,nil,n->lk", u, s, sphere.weights)
    assert works == pytest.approx(-np.diag(modes.work), abs=1e-13 * modes.work.max())


@pytest.mark.parametrize("side", SIDES)
def test_tractions_by_formula(side: Side) -> None:
    modes, x = Modes(6, 0.45, 6), scattered_points(5, 1, 1)
    unit_states = np.eye(len(modes))
    u, stress = modes.evaluate_regular(x, unit_states) if side == "regular" else modes.evaluate_outgoing(x, unit_states)
    radial = np.einsum("nik,ni->nk", u, x), np.einsum("nijk,ni,nj->nk", stress[:, FULL], x, x)
    tau = compute_surface_values(np.maximum(modes.ell, 1), 0.45, side)[np.arange(len(modes)), :, modes.kind % 2]
    kept = (modes.kind < 2) & (modes.ell > 0)
    assert (radial[1] * tau[:, 0])[:, kept] == pytest.approx((radial[0] * tau[:, 2])[:, kept], abs=1e-12)


@pytest.mark.parametrize("contrast", [1e-6, 0.1, 3.0, 1e6])
@pytest.mark.parametrize("nu", NEARLY)
@pytest.mark.parametrize("sphere_nu", NEARLY)
def test_uniform_strain_is_eshelbys(nu: float, sphere_nu: float, contrast: float) -> None:
    E, R, modes, rng = 2e4, 0.01, Modes(3, nu, 3, "both"), np.random.default_rng(1)
    strains = [strain + strain.T for strain in rng.normal(size=(2, 3, 3))]
    volume, shear = strengths(E, nu, contrast * E, sphere_nu)
    (a, b), T = (R * uniform(modes, strain) for strain in strains), compute_scattering(modes, E, contrast * E, sphere_nu, R).T
    e, f = (strain - np.eye(3) * np.trace(strain) / 3 for strain in strains)
    terms = np.array([volume * np.trace(strains[0]) * np.trace(strains[1]), shear * np.sum(e * f)]) * 4 / 3 * np.pi * R**3
    assert a @ T @ b == pytest.approx(terms.sum(), abs=1e-13 * np.abs(terms).max())


@pytest.mark.parametrize("contrast", [1e-6, 0.1, 10.0, 1e6])
@pytest.mark.parametrize("nu", [0.0, 0.4999])
def test_field_outside_is_eshelbys(nu: float, contrast: float) -> None:
    """The exact field of the sphere's uniform polarisation p: V p_jk d_k (1 + R^2 / 10 laplacian) G_ij, G Kelvin's solution."""
    E, sphere_nu, modes, x = 1.0, 0.4, Modes(4, nu, 3, "both"), scattered_points(20, 1.01, 30)
    strain = np.array([[0.3, 0.1, -0.5], [0.1, 0.7, 0.2], [-0.5, 0.2, -0.4]])
    volume, shear = strengths(E, nu, contrast, sphere_nu)
    p = volume * np.trace(strain) * np.eye(3) + shear * (strain - np.trace(strain) / 3 * np.eye(3))

    def kelvin(place: Array) -> Array:
        r = np.sqrt(np.sum(place**2, axis=1))[:, None, None]
        products = place[:, :, None] * place[:, None]
        G = (3 - 4 * nu) * np.eye(3) / r + products / r**3 - (3 * products / r**5 - np.eye(3) / r**3) / 5
        return G / (16 * np.pi * (E / 2 / (1 + nu)) * (1 - nu))

    steps = np.stack([kelvin(x + 1e-30j * e).imag / 1e-30 for e in np.eye(3)], axis=-1)
    known = 4 / 3 * np.pi * np.einsum("nijk,jk->ni", steps, p)
    c = compute_scattering(modes, E, contrast, sphere_nu, 1.0).S @ uniform(modes, strain)
    assert modes.evaluate_outgoing(x, c[:, None])[0][:, :, 0] == pytest.approx(known, rel=1e-10, abs=2e-13 * np.abs(known).max())


@pytest.mark.parametrize(("contrast", "sphere_nu"), [(1e-6, 0.3), (0.1, 0.499999), (10.0, 0.1), (1e6, 0.4999)])
@pytest.mark.parametrize("nu", [0.0, 0.45, 0.499999])
def test_surfaces_match(nu: float, contrast: float, sphere_nu: float) -> None:
    """Displacement and traction of incident and scattered fields are those inside, at points of the surface."""
    modes, inner, x = Modes(6, nu, 6, "both"), Modes(6, sphere_nu, 6, "both"), scattered_points(12, 1, 1)
    sphere, unit_states = compute_scattering(modes, 1, contrast, sphere_nu, 1), np.eye(len(modes))
    ratio = contrast * (1 + nu) / (1 + sphere_nu)

    def weigh_both(fields: tuple[Array, Array], factor: float) -> tuple[Array, Array]:
        return fields[0], factor * np.einsum("nijk,nj->nik", fields[1][:, FULL], x)

    u, t = weigh_both(modes.evaluate_regular(x, unit_states), 1)
    v, s = weigh_both(modes.evaluate_outgoing(x, sphere.S.toarray()), 1)
    w, r = weigh_both(inner.evaluate_regular(x, sphere.inside.toarray()), ratio)
    assert u + v == pytest.approx(w, abs=1e-13 * max(1, np.abs(v).max()))
    assert np.abs(t + s - r).max() < 2e-13 * max(np.abs(t).max(), np.abs(s).max())


@pytest.mark.parametrize("nu", NEARLY)
@pytest.mark.parametrize("sphere_nu", NEARLY)
@pytest.mark.parametrize("contrast", [1e-6, 0.5, 10.0, 1e6])
def test_work_by_fractions(nu: float, sphere_nu: float, contrast: float) -> None:
    """T of pairs, up to degree 30, in exact arithmetic from PHYSICS section 4; symmetric, rigid motions without any."""
    modes = Modes(30, nu, 1)
    T = compute_scattering(modes, 1, contrast, sphere_nu, 1).T.toarray()
    v, inner_v = Fraction(nu), Fraction(sphere_nu)
    for degree in (1, 2, 3, 5, 10, 30):  # not 4: no mode with b = 1 there at nu = 0
        known = np.array(exact_work(degree, v, inner_v, Fraction(contrast) * (1 + v) / (1 + inner_v)), dtype=float)
        b = compute_surface_values(np.array([degree]), nu, "regular")[0, 1]  # PHYSICS' modes have b = 1
        known *= np.outer(b, b) / (2 * (1 + nu))
        (index,) = np.nonzero((modes.ell == degree) & (modes.m == 0) & (modes.kind < 2))
        assert T[np.ix_(index, index)] == pytest.approx(known, abs=3e-14 * np.abs(known).max())
    (rigid,) = np.nonzero((modes.ell == 1) & (modes.kind != 1))
    assert np.abs(T[rigid]).max() == np.abs(T[:, rigid]).max() == 0


def exact_work(degree: int, nu: Fraction, sphere_nu: Fraction, ratio: Fraction) -> list[list[Fraction]]:
    """Q S of modes with b = 1, mu = 1, and integrals of Y^2 one."""
    L, p = degree * (degree + 1), degree + 1
    regular = [by_power(degree - 1, Fraction(degree), degree, nu), by_power(p, None, degree, nu)]
    outgoing = [by_power(-degree, None, degree, nu), by_power(-degree - 2, Fraction(-p), degree, nu)]
    inner = [by_power(degree - 1, Fraction(degree), degree, sphere_nu), by_power(p, None, degree, sphere_nu)]
    inner = [[a, b, ratio * r, ratio * t] for a, b, r, t in inner]
    rows = [[*(o[k] for o in outgoing), *(-i[k] for i in inner), *(-r[k] for r in regular)] for k in range(4)]
    S = eliminated(rows)[:2]
    Q = [[r[0] * o[2] - r[2] * o[0] + L * (r[1] * o[3] - r[3] * o[1]) for o in outgoing] for r in regular]
    return [[sum((Q[i][k] * S[k][j] for k in range(2)), Fraction(0)) for j in range(2)] for i in range(2)]


def by_power(p: int, a: Fraction | None, degree: int, nu: Fraction) -> list[Fraction]:
    """Displacement a, 1 and tractions tau_r, tau_t of rho^p; a from Navier's equation if not given."""
    L, lam = degree * (degree + 1), 2 * nu / (1 - 2 * nu)
    if a is None:
        a = ((lam + 2) * L - p * (p + 1)) / ((lam + 2) * (p + 2) - p)
    return [a, Fraction(1), lam * ((p + 2) * a - L) + 2 * p * a, p - 1 + a]


def eliminated(rows: list[list[Fraction]]) -> list[list[Fraction]]:
    """Solutions of a square system whose right-hand sides follow in its rows."""
    for i in range(len(rows)):
        pivot = next(k for k in range(i, len(rows)) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        rows = [row if k == i else [a - row[i] * b for a, b in zip(row, rows[i], strict=True)] for k, row in enumerate(rows)]
    return [row[len(rows) :] for row in rows]


def test_toroidal_work() -> None:
    """T of rho^l x cross grad Y: shear alone, mu (2l+1) (m-1) (l-1) / (m (l-1) + l+2) times l(l+1), scaled to unit Betti work."""
    modes = Modes(9, 0.3, 2, "both")
    T, mu = compute_scattering(modes, 1, 7, 0.45, 2).T.toarray(), 1 / 2.6
    ratio, (index,) = 7 * 1.3 / 1.45, np.nonzero(modes.kind == 2)
    n = modes.ell[index]
    known = 2 * 2 * mu * (ratio - 1) * (n - 1) / (ratio * (n - 1) + n + 2)
    assert np.diag(T)[index] == pytest.approx(known, rel=1e-13, abs=1e-15)


def test_like_materials_scatter_nothing() -> None:
    for nu in NEARLY:
        sphere = compute_scattering(Modes(20, nu, 20, "both"), 3e3, 3e3, nu, 1)
        assert np.abs(sphere.S.data).max() < 1e-13
        assert sphere.inside.diagonal() == pytest.approx(1)


def test_stiffer_adds_and_softer_takes_work() -> None:
    for contrast, sign in ((1e6, 1), (1.5, 1), (0.7, -1), (1e-6, -1)):
        T = sign * compute_scattering(Modes(12, 0.4999, 1, "both"), 1, contrast, 0.4999, 1).T.toarray()
        assert np.abs(T - T.T).max() < 1e-14 * np.abs(T).max()
        assert np.linalg.eigvalsh((T + T.T) / 2).min() > -1e-14 * np.abs(T).max()


@pytest.mark.parametrize("contrast", [1e-6, 0.3, 10.0, 1e6])
@pytest.mark.parametrize("nu", [0.3, 0.499999])
def test_derivatives(contrast: float, nu: float) -> None:
    """By ln E exactly as by complex steps, which leave 1e-15 of the value; by Poisson's ratio, complex steps as differences."""
    modes, step = Modes(12, nu, 2), 1e-30
    sphere = compute_scattering(modes, 5.0, 5 * contrast, 0.4, 2)
    stepped = compute_scattering(modes, 5.0, 5 * contrast * (1 + 1j * step), 0.4, 2)
    for exact, moved in zip(sphere.by_log_modulus, (stepped.S, stepped.T), strict=True):
        assert exact.toarray() == pytest.approx(moved.toarray().imag / step, rel=1e-11, abs=1e-15 * np.abs(moved.data).max())
    assert np.linalg.eigvalsh(sphere.by_log_modulus[1].toarray()).min() > -1e-14 * np.abs(sphere.by_log_modulus[1].data).max()
    derivative = compute_scattering(modes, 5.0, 5 * contrast, 0.4 + 1j * step, 2).T.toarray().imag / step
    upper, lower = (compute_scattering(modes, 5.0, 5 * contrast, 0.4 + h, 2).T.toarray() for h in (1e-5, -1e-5))
    assert (upper - lower) / 2e-5 == pytest.approx(derivative, rel=1e-5, abs=1e-8 * np.abs(upper).max())


def test_work_inside_is_the_derivative() -> None:
    """Twice the energy inside the sphere, by integrals over its surface, is the derivative of dF by ln E."""
    modes, inner = Modes(5, 0.45, 5, "both"), Modes(5, 0.3, 5, "both")
    sphere, surface_points = compute_scattering(modes, 1, 4, 0.3, 1), build_projection(modes, oversample=4)
    u, stress = inner.evaluate_regular(surface_points.points, sphere.inside.toarray())
    traction = np.einsum("nijk,nj->nik", stress[:, FULL], surface_points.points) * 4 / 1.3
    energy = np.einsum("nik,nil,n->kl", u, traction, surface_points.weights)
    assert sphere.by_log_modulus[1].toarray() == pytest.approx(energy, abs=1e-13)


def test_fields_by_the_matrixs_poisson_ratio() -> None:
    """Complex steps go through modes, projection and scattering alike: T of one displacement as a function of nu."""
    strain = np.array([[0.3, 0.1, -0.5], [0.1, 0.7, 0.2], [-0.5, 0.2, -0.4]])

    def energy(nu: complex) -> Any:
        modes = Modes(3, nu, 3, "both")
        c = uniform(modes, strain)
        work = c @ compute_scattering(modes, 1, 5, 0.45, 1).T @ c
        return work + modes.evaluate_outgoing(np.array([[1.1, 0.2, 0.4]]), c[:, None])[1].sum()

    change = (energy(0.3 + 1e-5) - energy(0.3 - 1e-5)) / 2e-5
    assert energy(0.3 + 1e-30j).imag / 1e-30 == pytest.approx(change, rel=1e-7)
