"""Elements on meridian meshes: energies of fields, rates of convergence, and what is held and tied."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import MeridianFineness, MeshTopology
from geometry.meridian.mesh_lines import find_kind as kind_of
from geometry.meridian.section import Body, Section
from solver.axisymmetric.dofs import Numbering, number_unknowns
from solver.elements.quadrilateral import compute_gradients, integrate_matrices, integrate_stiffness, project_dilations
from solver.elements.rectangles import integrate_rectangles
from solver.elements.shape_functions import build_shapes, evaluate_functions
from solver.materials.linear import Isotropic
from tests.support.meridian_sections import COARSE, PAPER, geometry_of, mesh_of, of_probe, section, special


def interpolated(s: Section, mesh: Topology, order: int, field: Any) -> np.ndarray:
    """Values of the elements' functions, (n, 2, s), that make field(r, z) = (u_r, u_z) right at the nodes."""
    table = build_shapes(order)
    u = np.stack(field(*np.moveaxis(compute_nodes(s, mesh, table.places), -1, 0)), axis=1)
    return np.linalg.solve(evaluate_functions(table.places, table.degrees)[0], u.transpose(0, 2, 1)).transpose(0, 2, 1)


def energies(stiffness: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.einsum("nis,nisjt,njt->n", u, stiffness, u, optimize=True)


def by_body(mesh: Topology, parts: np.ndarray) -> np.ndarray:
    return np.bincount(mesh.body, parts)[: Body.INCLUSION + 1]


@pytest.mark.parametrize("order", [3, 5, 8])
def test_uniform_strain_has_its_energy_in_every_body(order: int) -> None:
    """Patch test: u_r = a r, u_z = b z + c + d r."""
    a, b, c, d = 0.7, -1.3, 2e-3, 0.4
    s = section(**PAPER)
    mesh = mesh_of(s)
    geometry = geometry_of(s, mesh, order)
    u = interpolated(s, mesh, order, lambda r, z: (a * r, b * z + c + d * r))
    shear, volume = (by_body(mesh, energies(part, u)) for part in integrate_matrices(geometry, build_shapes(order)))
    rings = by_body(mesh, geometry.weight.sum(axis=1))
    np.testing.assert_allclose(shear, (2 * a**2 + b**2 + d**2 / 2) * rings, rtol=1e-9)
    np.testing.assert_allclose(volume, (2 * a + b) ** 2 * rings, rtol=1e-9)


@pytest.mark.parametrize("order", [2, 5])
def test_matrices_integrate_the_strains_at_the_gauss_points(order: int) -> None:
    """Any displacements: the tables of products against the strains themselves, the dilation projected."""
    s, table = section(**PAPER), build_shapes(order)
    geometry = geometry_of(s, mesh_of(s), order)
    u = np.random.default_rng(1).normal(size=(len(geometry.weight), 2, len(table.degrees)))
    derivatives, hoop = compute_gradients(geometry, table, u[..., None])
    rr, rz, zr, zz = derivatives
    squares = rr**2 + zz**2 + hoop**2 + (rz + zr) ** 2 / 2, project_dilations(geometry, table, rr + zz + hoop) ** 2
    for whole, square in zip(integrate_matrices(geometry, table), squares, strict=True):
        np.testing.assert_allclose(energies(whole, u), (geometry.weight * square[..., 0]).sum(axis=1), rtol=1e-9)
        np.testing.assert_allclose(whole, whole.transpose(0, 3, 4, 1, 2), atol=1e-10 * np.abs(whole).max())


@special
def test_rectangles_come_first_column_by_column(case: dict[str, float]) -> None:
    s = section(**case)
    mesh = mesh_of(s)
    corners, count = compute_nodes(s, mesh, UNIT_SQUARE), mesh.columns[-1]
    (left, right), (low, high) = (corners[..., [0, 1], 0].T, corners[..., [0, 3], 1].T)
    square = np.stack([left, low, right, low, right, high, left, high], axis=-1).reshape(-1, 4, 2)
    tolerance = 8 * np.finfo(float).eps
    is_rectangle = np.all(np.abs(corners - square) <= tolerance * np.abs(corners), axis=(1, 2))
    assert is_rectangle[:count].all()
    assert is_rectangle.sum() == count > len(is_rectangle) / 3
    for column in np.split(corners[:count], mesh.columns[1:-1]):
        assert np.all(np.ptp(column[..., 0], axis=0) <= tolerance * column[0, :, 0])


@pytest.mark.parametrize("order", [2, 4, 6])
def test_rectangles_have_the_matrices_of_any_quadrilateral(order: int) -> None:
    s, table = section(**PAPER), build_shapes(order)
    mesh = mesh_of(s)
    geometry = geometry_of(s, mesh, order).select(slice(0, mesh.columns[-1]))
    moduli, ratios = np.random.default_rng(2).uniform([[0.5], [0.1]], [[2.0], [0.45]], (2, mesh.columns[-1]))
    law = Isotropic(moduli, ratios)
    matrices, usual = (
        integrate_rectangles(geometry, table, law, mesh.columns),
        integrate_stiffness(geometry, table, law),
    )
    largest = np.abs(usual.outside).max(axis=(1, 2), keepdims=True)
    for name in ("outside", "across", "inside"):
        np.testing.assert_allclose(getattr(matrices, name) / largest, getattr(usual, name) / largest, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", [2, 5, 8])
def test_pressures_are_all_polynomials_of_a_lower_total_degree(order: int) -> None:
    table = build_shapes(order)
    x, y = table.points.T
    powers = np.stack([x**i * y**j for i in range(order) for j in range(order - i)], axis=1)
    assert table.pressure.shape == powers.shape
    assert np.linalg.matrix_rank(table.pressure) == powers.shape[1]
    best = table.pressure @ np.linalg.lstsq(table.pressure, powers, rcond=None)[0]
    np.testing.assert_allclose(best, powers, atol=1e-12)


WAVE = 600.0  # per m: three radians over the inner radius
# thin tissue, under which no lines end, so that all cells halve as their number doubles
THIN = {"gap": 2e-3, "area_ratio": 1.0, "sphere": 0.4, "cover": 0.5, "below": 1.0, "beside": 2.0, "inner_height": 0.6}


def wave(r: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return r * np.sin(WAVE * z), np.cos(WAVE * r) / WAVE


def wave_strains(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    """eps_rr, eps_zz, u_r / r and eps_rz times the root of 2, whose squares add up to eps:eps."""
    rz = (WAVE * r * np.cos(WAVE * z) - np.sin(WAVE * r)) / 2
    return np.stack([np.sin(WAVE * z), 0 * z, np.sin(WAVE * z), math.sqrt(2) * rz])


@pytest.mark.parametrize("order", [3, 4])
def test_interpolated_strains_converge_at_the_rate_of_the_order(order: int) -> None:
    """In every body, curved elements too."""
    s, table, wrong = section(**THIN), build_shapes(order), []
    for cells in (2, 4):
        mesh = mesh_of(s, MeridianFineness(cells, 0, order))
        geometry, height = geometry_of(s, mesh, order), compute_nodes(s, mesh, table.places)[..., 1] @ table.geometry.T
        (rr, rz, zr, zz), hoop = compute_gradients(geometry, table, interpolated(s, mesh, order, wave)[..., None])
        strains = np.stack([rr, zz, hoop, (rz + zr) / math.sqrt(2)])[..., 0]
        wrong.append(by_body(mesh, (geometry.weight * (strains - wave_strains(geometry.radius, height)) ** 2).sum(axis=(0, 2))))
    np.testing.assert_allclose(np.log2(wrong[0] / wrong[1]) / 2, order, atol=0.15)


@pytest.mark.parametrize("order", [3, 4])
def test_energy_of_a_block_converges_faster_than_its_strains(order: int) -> None:
    s = section(**THIN)
    x, weight = np.polynomial.legendre.leggauss(40)
    r, z = np.meshgrid(s.inner_radius * (1 + x) / 2, s.inner_height * (1 + x) / 2, indexing="ij")
    area = np.outer(weight, weight) * s.inner_radius * s.inner_height / 4
    exact, wrong = (2 * np.pi * r * area * (wave_strains(r, z) ** 2).sum(axis=0)).sum(), []
    for cells in (1, 2, 4):
        mesh = mesh_of(s, MeridianFineness(cells, 0, order))
        shear = integrate_matrices(geometry_of(s, mesh, order), build_shapes(order))[0]
        wrong.append(abs(by_body(mesh, energies(shear, interpolated(s, mesh, order, wave)))[Body.INNER] - exact))
    assert np.all(np.log2(wrong[:-1]) - np.log2(wrong[1:]) > order)


def numberings(s: Section, order: int) -> tuple[Numbering, Numbering]:
    mesh = mesh_of(s, MeridianFineness(1, 1, order))
    return number_unknowns(mesh, order, "bonded"), number_unknowns(mesh, order, "frictionless")


@special
def test_a_bond_ties_the_radial_unknowns_under_the_blocks(case: dict[str, float]) -> None:
    """On every contact of m edges m p + 1 functions, of which the one on the axis is held anyway."""
    s, order, layers = section(**case), 3, 1
    column = MeshTopology(kind_of(s), COARSE).column
    inner, outer = column["inner"] + layers, column["tube"] - column["hole"] + 2 * layers
    bonded, frictionless = numberings(s, order)
    assert frictionless.unknowns - bonded.unknowns == inner * order + outer * order + 1


@special
@pytest.mark.parametrize("order", [2, 5])
def test_a_continuous_field_has_unknowns(case: dict[str, float], order: int) -> None:
    """Elements agree on what they share, odd functions along edges that run against each other with it."""
    s = section(**case)
    mesh = mesh_of(s, MeridianFineness(1, 1, order))
    size = s.tube_radius

    def field(r: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(r / size) * np.exp(z / size), np.cos(r / size + z / size)

    continuous = interpolated(s, mesh, order, field)[:, :, : build_shapes(order).skeleton].ravel()
    for numbers in numberings(s, order):
        gather, free = numbers.gather, np.diff(numbers.gather.indptr) > 0
        unknowns = (gather.T @ continuous) / (abs(gather).T @ np.ones(len(continuous)))
        np.testing.assert_allclose((gather @ unknowns)[free], continuous[free], atol=1e-9)


@special
def test_what_is_held(case: dict[str, float]) -> None:
    """u_r on the axis; both displacements on the bottom and under a rigid base, or on an elastic base's top; nothing else."""
    s, order = section(**case), 3
    mesh = mesh_of(s, MeridianFineness(1, 1, order))
    positions = compute_nodes(s, mesh, UNIT_SQUARE)
    tops = list(s.top_heights)
    if s.flange_thickness:
        tops = [max(tops) + s.step_height + s.flange_thickness]
    supports = np.isclose(positions[..., 1, None], [-s.tissue_depth, *tops], rtol=1e-9, atol=0).any(axis=-1)
    for numbers in numberings(s, order):
        free = (np.diff(numbers.gather.indptr) > 0).reshape(len(positions), 2, -1)[..., :4]
        np.testing.assert_array_equal(free[:, 1], ~supports)
        np.testing.assert_array_equal(free[:, 0], ~supports & (positions[..., 0] > 0))


@special
def test_lift_is_what_a_block_moved_down_does_to_the_tissue_under_it(case: dict[str, float]) -> None:
    s, order = section(**case), 3
    mesh = mesh_of(s, MeridianFineness(1, 1, order))
    r, z = np.moveaxis(compute_nodes(s, mesh, UNIT_SQUARE), -1, 0)
    touching = (~of_probe(mesh))[:, None] & (z == 0)
    touched = touching & (r <= s.inner_radius), touching & (r >= s.hole_radius) & (r <= s.tube_radius)
    for numbers in numberings(s, order):
        lift = numbers.lift.reshape(len(r), 2, -1, 2)
        np.testing.assert_array_equal(lift[:, 1, :4], -np.stack(touched, axis=-1).astype(float))
        assert not lift[:, 0].any()
        assert not lift[:, 1, 4:].any()


def test_a_rigid_shift_strains_nothing() -> None:
    """``vertical`` is one, in the elements and in the unknowns of all that no support holds."""
    s, order = section(**PAPER), 4
    mesh = mesh_of(s, MeridianFineness(1, 1, order))
    bonded = number_unknowns(mesh, order, "bonded")
    shift = np.tile(bonded.vertical, len(mesh.body))
    unknowns = (bonded.gather.T @ shift > 0).astype(float)
    free = np.diff(bonded.gather.indptr) > 0
    np.testing.assert_array_equal((bonded.gather @ unknowns)[free], shift[free])
    uniform = np.zeros((len(mesh.body), 2, len(build_shapes(order).degrees)))
    uniform[:, 1, :4] = 1.0
    for whole in integrate_matrices(geometry_of(s, mesh, order), build_shapes(order)):
        assert np.abs(np.einsum("nisjt,njt->nis", whole, uniform)).max() < 1e-12 * np.abs(whole).max()


def test_assembled_matrix_adds_the_elements_up() -> None:
    mesh = mesh_of(section(**PAPER), MeridianFineness(1, 0, 2))
    numbers = number_unknowns(mesh, 2, "frictionless")
    stiffness = np.random.default_rng(2).normal(size=(len(mesh.body), 16, 16))
    whole = numbers.gather.T @ (sp.block_diag(stiffness, format="csr") @ numbers.gather)
    np.testing.assert_allclose(numbers.assemble(stiffness).toarray(), whole.toarray(), atol=1e-12)
