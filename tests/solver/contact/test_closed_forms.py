"""Pressed sections against closed forms of linear elasticity, at small loads."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.probe import Interface, Material, Probe
from geometry.scenes.scene_tables import CylinderTissue, Load
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.path import Path
from tests.support.load_paths import scene_of

PUNCH = MeridianFineness(1, 1, 3)
STIFF = 1e7  # of tissue over blocks
SIZES = 0.3, 0.6  # m, of the tissue: what its sides and floor add goes with one over it


def rigid_probe(size: float, poisson_ratio: float, youngs_modulus: float = 6e3) -> Scene:
    """Blocks a million times as stiff as tissue without a tumour."""
    data = scene_of("equal-blocks-6kpa").model_dump(exclude_unset=True)
    data["inclusion"] = []
    for block in ("inner", "outer"):
        data["probe"][block] |= {"youngs_modulus": 1e6 * youngs_modulus}
    material = {"youngs_modulus": youngs_modulus, "poisson_ratio": poisson_ratio}
    data["tissue"] = {"shape": "cylinder", "radius": size, "depth": size, **material}
    return Scene.model_validate(data)


def stiffness(size: float, interface: Interface, friction: float = 0.0) -> float:
    """Of a flat punch on tissue of Poisson's ratio 0, over that without friction on a half-space, 2 E a."""
    scene = rigid_probe(size, 0.0)
    scene_sections = build_sections(scene)
    path = Path(
        ContactModel.from_section(scene_sections.section, scene_sections.materials, interface, PUNCH, friction), sensitive=False
    )
    point = path.press_to_indentation(1e-5)
    return point.force / point.indentation / (2 * 6e3 * scene.probe.tube_radius)


def on_half_space(*values: float) -> float:
    """The limit of ``SIZES`` without end."""
    return 2 * values[1] - values[0]


@pytest.mark.slow
@pytest.mark.parametrize(("interface", "friction", "share"), [("bonded", 0.0, 0.005), ("unilateral", 10.0, 0.015)])
def test_stuck_punch(interface: Interface, friction: float, share: float) -> None:
    """P = 4 mu a w ln(3 - 4 nu) / (1 - 2 nu) (D. A. Spence, Proc. R. Soc. A 305, 1968, 55): ln 3 of a smooth one's at nu = 0.

    Friction's springs give way to a tenth of what sticking adds.
    """
    stiffnesses = on_half_space(*(stiffness(size, interface, friction) for size in SIZES))
    assert stiffnesses == pytest.approx(np.log(3), rel=share)


@pytest.mark.slow
def test_slipping_punch() -> None:
    """To first order friction adds f (1 - 2 nu) (pi/2 - 1) / (pi (1 - nu)) of a smooth punch's force.

    By Betti's theorem that is f times the work of a smooth punch's pressure on the slip of the surface below it, per indentation,
    over its force (both by K. L. Johnson, Contact Mechanics, 1985, section 3.4). What sticks round the axis is small.
    """
    friction = 0.05
    smooth, rough = (stiffness(SIZES[1], "unilateral", f) for f in (0.0, friction))
    assert rough / smooth - 1 == pytest.approx(friction * (np.pi / 2 - 1) / np.pi, rel=0.1)


@pytest.mark.parametrize(
    ("radius_per_height", "nu", "apparent"),
    # E_app / E, an independent code's values, PHYSICS section 7
    [(1, 0.3, 1.118576), (1, 0.4999, 1.544227), (5, 0.49, 7.021501), (5, 0.4999, 13.034977)],
)
def test_bonded_cylinder_at_small_strain(radius_per_height: float, nu: float, apparent: float) -> None:
    """The inner block between the base and tissue far stiffer; both blocks alike, so that nothing turns."""
    block = Material(youngs_modulus=1e3, poisson_ratio=nu)
    probe = Probe(inner_radius=0.01, outer_radius=0.02, gap=1e-3, height=0.01 / radius_per_height, inner=block, outer=block)
    tissue = CylinderTissue(shape="cylinder", radius=0.1, depth=0.05, youngs_modulus=STIFF * 1e3, poisson_ratio=0.3)
    scene_sections = build_sections(Scene(probe=probe, tissue=tissue, load=Load(indentation=1e-6)))
    model = ContactModel.from_section(scene_sections.section, scene_sections.materials, "bonded", MeridianFineness(1, 2, 4))
    stiffness = Path(model, sensitive=False).points[0].tangent[0]  # of the inner film's force
    assert stiffness * probe.core_height / (1e3 * probe.inner_area) == pytest.approx(apparent, rel=1e-3)
