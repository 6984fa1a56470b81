"""Opening faces against Sneddon's solution for a round punch, of which Hertz's is the limit of small loads on a sphere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from geometry import Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.probe import Material, Probe
from geometry.scenes.scene_tables import CylinderTissue, Load
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.path import Path

FLAT, EDGE = 0.1e-3, 3.9e-3  # m: what is left of the inner block's face, and the radius of its edge
E, NU, SIZE = 6e3, 0.3, 0.3  # Pa; m, of the tissue
FINE = MeridianFineness(1, 1, 4)


def punch() -> Path:
    """A rigid inner block that is nearly a hemisphere, and an outer one that is next to nothing, on deep tissue."""
    stiff, nothing = Material(youngs_modulus=1e6 * E, poisson_ratio=NU), Material(youngs_modulus=1e-4 * E, poisson_ratio=0.0)
    radius = FLAT + EDGE
    probe = Probe(inner_radius=radius, outer_radius=4 * radius + 1e-3, gap=1e-3, height=2 * radius, inner=stiff, outer=nothing)
    tissue = CylinderTissue(shape="cylinder", radius=SIZE, depth=SIZE, youngs_modulus=E, poisson_ratio=NU)
    scene_sections = build_sections(Scene(probe=probe, tissue=tissue, load=Load(indentation=1e-6)))
    section = replace(scene_sections.section, edge_radius=EDGE)
    return Path(ContactModel.from_section(section, scene_sections.materials, "unilateral", FINE), sensitive=False)


def sneddon(depth: float, flat: float) -> tuple[float, float]:
    """Contact radius, m, and force, N, of a punch of outline f: a int f'(r) / sqrt(a^2 - r^2) dr and 2 E* int r^2 f' / sqrt.

    I. N. Sneddon, Int. J. Engng Sci. 3, 1965, 47, section 3, integrated by parts.
    """

    def integral(a: float, power: int) -> float:
        def part(t: float) -> float:
            r = a * np.sin(t)
            beyond = max(r - flat, 0.0)
            return float(r**power * beyond / np.sqrt(EDGE**2 - beyond**2))

        return float(quad(part, np.arcsin(min(1.0, flat / a)), np.pi / 2)[0])

    a = brentq(lambda a: a * integral(a, 0) - depth, flat + 1e-9, flat + 0.9 * EDGE)
    return float(a), 2 * E / (1 - NU**2) * integral(a, 2)


def test_without_a_flat_sneddon_s_force_is_hertz_s_at_small_depths() -> None:
    depth = 1e-4 * EDGE
    a, force = sneddon(depth, 0.0)
    assert a == pytest.approx(np.sqrt(EDGE * depth), rel=1e-3)
    assert force == pytest.approx(4 / 3 * E / (1 - NU**2) * np.sqrt(EDGE) * depth**1.5, rel=1e-3)


@pytest.mark.slow
def test_force_and_contact_radius_are_sneddon_s() -> None:
    """A sphere without the small flat would take 0.6 of the first force; the radius is told to the next watched point."""
    path = punch()
    for share in (0.003, 0.01):
        point = path.press_to_indentation(share * EDGE)
        a, force = sneddon(point.indentation, FLAT)
        assert point.films[0] == pytest.approx(force, rel=0.025)
        model, state = path.model, point.equilibrium.state
        places = model.pairs[1].compute_positions(model.compute_displacements(state.v, state.indentation))[:, 0]
        touching = point.equilibrium.equations.touches[1].pressure > 0
        last = float(places[touching].max())
        assert 0.98 * last < a < 1.02 * float(places[places > last].min())
