"""The film as a membrane: against boundary value problems solved by collocation, its limits, and extreme films and bonds."""

from __future__ import annotations

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.special import i0e, i1e, k0e, k1e

from geometry.common.arrays import Floats
from solver.closed_form.film_membrane import FilmArray, compute_actuator, compute_scaled_bessel

TAPE = {"base_bond_thickness": 50e-6, "base_bond_modulus": 4e5, "base_bond_poisson": 0.49}
DISC, RING = (None, 4e-3), (4.1e-3, 5.49e-3)  # inner and outer radius, m


def build_film(**changes: float | Floats) -> FilmArray:
    """A film of 110 um, rigidly bonded unless changed, as arrays of the changes' length."""
    values = {"thickness": 110e-6, "modulus": 2.5e9, "poisson": 0.34, "lateral_charge": 11e-12, "normal_charge": -20e-12}
    values |= dict.fromkeys(("inset", "base_bond_thickness", "block_bond_thickness"), 0.0)
    values |= dict.fromkeys(("base_bond_modulus", "block_bond_modulus"), 1e6)
    values |= dict.fromkeys(("base_bond_poisson", "block_bond_poisson"), 0.45) | changes
    size = max(np.size(value) for value in values.values())
    return FilmArray(**{part.name: np.broadcast_to(values[part.name], size) * 1.0 for part in fields(FilmArray)})


def solve_actuator(film: FilmArray, face: tuple[float | None, float], r: Floats) -> tuple[Floats, Floats]:
    """v and e of one film for increasing radii r, shape (points,) both."""
    start, radius = (None if x is None else np.array([x] * len(film.thickness)) for x in face)
    v, e = compute_actuator(film, start, radius, np.tile(r, (len(film.thickness), 1)))
    return v, e


def test_scaled_bessel_functions() -> None:
    x = np.concatenate([np.geomspace(1e-6, 1e7, 4000), [2.0, 3.75]])
    for computed, exact in zip(compute_scaled_bessel(x), (i0e, i1e, k0e, k1e), strict=True):
        assert computed == pytest.approx(exact(x), rel=1e-6)


@pytest.mark.parametrize("inset", [0.0, 0.15e-3])
@pytest.mark.parametrize("face", [DISC, RING])
@pytest.mark.parametrize("tape", [1e5, 1e7, 1e9])
def test_against_collocation(face: tuple[float | None, float], inset: float, tape: float) -> None:
    """SciPy solves D (v' + v/r)' = k v piece by piece, with e and v as unknowns, from one electrode's edge to the next."""
    film = build_film(inset=inset, **TAPE | {"base_bond_modulus": tape})
    length, nu = float(film.decay_length[0]), film.poisson[0]
    low, high = face[0] or 0.0, face[1]
    inner_cut = low + inset if face[0] else low
    cuts = [low, inner_cut, high - inset, high] if inset and face[0] else [low, high - inset, high] if inset else [low, high]
    covered = [inner_cut <= (a + b) / 2 <= high - inset for a, b in itertools.pairwise(cuts)]
    count, sizes = len(covered), np.diff(cuts)

    def compute_slopes(s: Floats, y: Floats) -> Floats:
        r = np.array(cuts[:-1])[:, None] + sizes[:, None] * s
        v, e = y[:count], y[count:]
        # about the axis v / r is v'
        slope = e - np.divide(v, r, out=e / 2, where=r > 0)
        return np.concatenate([slope * sizes[:, None], v / length**2 * sizes[:, None]])

    def compute_gaps(start: Floats, end: Floats) -> Floats:
        def tension(y: Floats, k: int, r: float) -> float:
            return float(y[count + k] - (1 - nu) * y[k] / r - (1 + nu) * covered[k])

        gaps = [end[k] - start[k + 1] for k in range(count - 1)]
        gaps += [tension(end, k, cuts[k + 1]) - tension(start, k + 1, cuts[k + 1]) for k in range(count - 1)]
        gaps += [tension(end, count - 1, high), tension(start, 0, low) if low else start[0]]
        return np.array(gaps)

    mesh = (1 - np.cos(np.linspace(0, np.pi, 200))) / 2
    exact = solve_bvp(compute_slopes, compute_gaps, mesh, np.zeros((2 * count, 200)), tol=1e-8, max_nodes=100_000)
    assert exact.success
    for k in range(count):
        s = np.linspace(0.02, 0.98, 15)
        v, e = solve_actuator(film, face, cuts[k] + sizes[k] * s)
        assert v[0] == pytest.approx(exact.sol(s)[k], rel=1e-4, abs=1e-6 * high)
        assert e[0] == pytest.approx(exact.sol(s)[count + k], rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("face", [DISC, RING])
def test_limits(face: tuple[float | None, float]) -> None:
    """Held rigidly a film does not widen, but for an edge as wide as it is thick; afloat it widens freely, v = r and e = 2."""
    r = np.linspace((face[0] or 0.0) + 5e-4, face[1] - 5e-4, 9)
    v, e = solve_actuator(build_film(thickness=1e-6), face, r)
    assert np.abs(v).max() < 1e-12
    assert np.abs(e).max() < 1e-12
    v, e = solve_actuator(build_film(**TAPE | {"base_bond_modulus": 1e-3}), face, r)
    assert v[0] == pytest.approx(r, rel=1e-4)
    assert e[0] == pytest.approx(2 * np.ones(9), rel=1e-4)


@pytest.mark.parametrize("inset", [0.0, 1e-4])
@pytest.mark.parametrize("face", [DISC, RING, (0.2e-3, 19e-3), (18e-3, 18.3e-3)])
def test_extremes_are_approached_monotonically(face: tuple[float | None, float], inset: float) -> None:
    """The stiffer the tape or the thinner the film, from 10 GPa and 1 um to 1 kPa and 500 um, the less the electrode widens."""
    moduli, thicknesses = np.geomspace(1e10, 1e3, 60), np.geomspace(1e-6, 500e-6, 40)
    with np.errstate(all="raise", under="ignore"):
        for thickness in (1e-6, 110e-6, 500e-6):
            films = build_film(inset=inset, thickness=thickness, **TAPE | {"base_bond_modulus": moduli})
            _check_rising(films, face, inset)
        for modulus in (1e3, 4e5, 1e10):
            films = build_film(inset=inset, thickness=thicknesses, **TAPE | {"base_bond_modulus": modulus})
            _check_rising(films, face, inset)


def _check_rising(films: FilmArray, face: tuple[float | None, float], inset: float) -> None:
    """The electrode's gain of area, Int e dA / 2 pi = [r v], rises from film to film, up to that of a free electrode.

    It is the actuator's work, which falls with every spring that is added.
    """
    ends = np.array([face[0] + inset if face[0] else 0.0, face[1] - inset])
    v, _ = solve_actuator(films, face, np.maximum(ends, 1e-9))
    gain = v @ (ends * [-1, 1])
    assert np.all(np.diff(gain) >= -1e-6 * gain[1:])
    assert np.all(gain > 0)
    assert gain.max() <= (ends[1] ** 2 - ends[0] ** 2) * (1 + 1e-4)


@pytest.mark.parametrize("face", [DISC, RING])
def test_dilation_is_the_divergence(face: tuple[float | None, float]) -> None:
    """Int e dA = 2 pi [r v] between the edges: eq. 1's two forms of the lateral charge."""
    film = build_film(inset=1e-4, **TAPE)
    start = face[0] or 0.0
    cuts = [start, start + 1e-4, face[1] - 1e-4, face[1]] if face[0] else [0.0, face[1] - 1e-4, face[1]]
    x, weight = np.polynomial.legendre.leggauss(12)
    total = 0.0
    for a, b in itertools.pairwise(cuts):
        r = (a + b) / 2 + (b - a) / 2 * x
        total += float(solve_actuator(film, face, r)[1][0] * r @ weight * (b - a) / 2)
    ends = np.array([max(start, 1e-9), face[1]])
    v, _ = solve_actuator(film, face, ends)
    assert total == pytest.approx(float(v[0, 1] * ends[1] - v[0, 0] * ends[0]), rel=1e-5)


def test_complex_steps_differentiate() -> None:
    """By every number of the film, against differences."""
    film = build_film(inset=2e-4, block_bond_thickness=5e-5, **TAPE)
    r = np.linspace(4.2e-3, 5.4e-3, 7)
    for part in ("thickness", "modulus", "poisson", "inset", "base_bond_thickness", "base_bond_modulus", "base_bond_poisson"):
        value = getattr(film, part)
        exact = solve_actuator(replace(film, **{part: value * (1 + 1e-30j)}), RING, r)
        ahead, behind = (solve_actuator(replace(film, **{part: value * (1 + h)}), RING, r) for h in (1e-4, -1e-4))
        for k in range(2):
            scale = np.abs(exact[k].real).max()
            assert exact[k].imag * 1e30 == pytest.approx((ahead[k] - behind[k]) / 2e-4, rel=1e-3, abs=1e-4 * scale), part
