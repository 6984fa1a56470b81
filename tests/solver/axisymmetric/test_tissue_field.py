"""Strains anywhere in the tissue: against Boussinesq's formula, an energy on another mesh, and their own displacements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry import InputError, Material, Probe, Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body
from geometry.scenes.scene_tables import HalfSpaceTissue, Load
from solver.axisymmetric.base_states import BaseStates, build_model, solve_base_states
from solver.axisymmetric.sections import build_sections
from solver.axisymmetric.tissue_field import TissueField
from tests.support.references import named

SCENE = named("axisymmetric", "shallow").scene
LEVEL = MeridianFineness(1, 4, 8)


def without_sphere(scene: Scene) -> BaseStates:
    scene_sections = build_sections(scene)
    materials = {body: material for body, material in scene_sections.materials.items() if body != Body.INCLUSION}
    return solve_base_states(
        build_model(replace(scene_sections.section, sphere_radius=0.0, sphere_depth=0.0), materials, "bonded", LEVEL)
    )


@pytest.fixture(scope="module")
def field() -> TissueField:
    return TissueField(without_sphere(SCENE))


def test_far_below_the_probe_boussinesq_holds() -> None:
    E, nu, a = 6e3, 0.3, 4e-3
    block = Material(youngs_modulus=1e6, poisson_ratio=0.45)
    probe = Probe(inner_radius=a, outer_radius=6e-3, gap=1e-4, height=5e-3, inner=block, outer=block)
    tissue = HalfSpaceTissue(shape="half-space", youngs_modulus=E, poisson_ratio=nu)
    states = without_sphere(Scene(probe=probe, tissue=tissue, load=Load(force=1.0)))
    force = states.forces.sum()  # both bases moved down by one unit
    z = np.array([0.6, 1.0, 3.0])
    strains = TissueField(states).evaluate(np.zeros(3), -z)
    # a point force P on a half-space, on its axis: u_z = P (1 + nu)(3 - 2 nu) / (2 pi E z)
    assert -strains.displacement[:, 1].sum(axis=1) == pytest.approx(
        force * (1 + nu) * (3 - 2 * nu) / (2 * np.pi * E * z), rel=2e-3
    )
    # eps_zz = -P (1 + nu)(3 - 2 nu) / (2 pi E z^2)
    assert strains.strain[:, 1].sum(axis=1) == pytest.approx(-force * (1 + nu) * (3 - 2 * nu) / (2 * np.pi * E * z**2), rel=3e-3)


def test_energy_in_a_sphere_is_what_another_mesh_says(field: TissueField) -> None:
    """A sphere of tissue: dF / d ln E by Gauss quadrature of the strains here, by elements of a mesh round the sphere there."""
    scene_sections = build_sections(SCENE)
    derivative = solve_base_states(
        build_model(scene_sections.section, {**scene_sections.materials, Body.INCLUSION: SCENE.tissue}, "bonded", LEVEL)
    ).compute_modulus_derivative()
    radius, depth = scene_sections.section.sphere_radius, scene_sections.section.sphere_depth
    x, w = np.polynomial.legendre.leggauss(32)
    rho, cosine = (g.ravel() for g in np.meshgrid((x + 1) / 2 * radius, x, indexing="ij"))
    weight = np.outer(w / 2 * radius, w).ravel() * 2 * np.pi * rho**2
    strain = field.evaluate(rho * np.sqrt(1 - cosine**2), -depth + rho * cosine).strain
    E, nu = SCENE.tissue.youngs_modulus, SCENE.tissue.poisson_ratio
    two_mu, lam = E / (1 + nu), E * nu / ((1 + nu) * (1 - 2 * nu))
    trace = strain[:, :3].sum(axis=1)
    product = np.einsum("m,mci,mcj->ij", weight, strain[:, :3], strain[:, :3])
    product += 2 * np.einsum("m,mi,mj->ij", weight, strain[:, 3], strain[:, 3])
    assert two_mu * product + lam * np.einsum("m,mi,mj->ij", weight, trace, trace) == pytest.approx(derivative, rel=2e-4)


def test_strains_are_derivatives_of_displacements(field: TissueField) -> None:
    rng = np.random.default_rng(5)
    r, z, h = rng.uniform(1e-4, 9e-3, 500), -rng.uniform(1e-4, 9e-3, 500), 1e-7
    strains = field.evaluate(r, z)
    by_r = (field.evaluate(r + h, z).displacement - field.evaluate(r - h, z).displacement) / (2 * h)
    by_z = (field.evaluate(r, z + h).displacement - field.evaluate(r, z - h).displacement) / (2 * h)
    hoop = strains.displacement[:, 0] / r[:, None]
    numerical = np.stack([by_r[:, 0], by_z[:, 1], hoop, (by_z[:, 0] + by_r[:, 1]) / 2], axis=1)
    assert numerical == pytest.approx(strains.strain, abs=1e-5 * np.abs(strains.strain).max())


def test_supports_and_contact_are_met(field: TissueField) -> None:
    section = field.states.model.section
    floor = field.evaluate(np.linspace(0, section.tissue_radius, 7), np.full(7, -section.tissue_depth))
    assert np.abs(floor.displacement).max() < 1e-12
    axis = field.evaluate(np.zeros(5), -np.linspace(0, 0.01, 5))
    assert np.abs(axis.displacement[:, 0]).max() < 1e-12
    assert axis.strain[:, 0] == pytest.approx(axis.strain[:, 2], rel=1e-9)  # rr and hoop are one on the axis


def test_points_outside_are_refused(field: TissueField) -> None:
    for r, z in ((-1e-3, -1e-3), (1.0, -1e-3), (0.0, 1e-6), (0.0, -1.0), (np.nan, -1e-3)):
        with pytest.raises(InputError, match="points"):
            field.evaluate(np.array([r]), np.array([z]))
    assert field.evaluate(np.zeros(0), np.zeros(0)).strain.shape == (0, 4, 2)
