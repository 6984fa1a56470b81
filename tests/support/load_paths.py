"""Probes of ``tests/reference/contact`` pressed along paths of loads."""

from __future__ import annotations

from itertools import pairwise

from geometry import Scene, read_scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.probe import Probe
from solver import Result
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.states import PathPoint
from tests.support.paths import REFERENCE

FOLDER = REFERENCE / "contact"
COARSE, FINE = MeridianFineness(1, 0, 2), MeridianFineness(1, 0, 3)


def scene_of(name: str, tissue: dict[str, float] | None = None, poisson_ratio: float | None = None) -> Scene:
    scene = read_scene(FOLDER / f"{name}.toml")
    data = scene.model_dump(exclude_unset=True)
    data["tissue"] |= tissue or {}
    if poisson_ratio is not None:
        for body in (data["tissue"], data["probe"]["inner"], data["probe"]["outer"], data["inclusion"][0]):
            body["poisson_ratio"] = poisson_ratio
    return Scene.model_validate(data)


def pressed(scene: Scene, fineness: MeridianFineness) -> Path:
    scene_sections = build_sections(scene)
    return Path(ContactModel.from_section(scene_sections.section, scene_sections.materials, "bonded", fineness), sensitive=True)


def ratio(scene: Scene, point: PathPoint) -> float:
    films = point.films if point.indentation > 0 else point.tangent
    return float(films[0] / films[1] * scene.probe.outer_area / scene.probe.inner_area)


def work(path: Path) -> float:
    """Work of the base along a path, J, by cubics through forces and their derivatives."""
    total = 0.0
    for a, b in pairwise(path.points):
        d = b.indentation - a.indentation
        total += d * (a.force + b.force) / 2 + d**2 * float(a.tangent.sum() - b.tangent.sum()) / 12
    return total


def added_by_blocks(probe: Probe, result: Result, indentation: float) -> float:
    """Eq. PL.3 from the blocks' stresses, which are their moduli times their mean strains."""
    strains = (result.stress_inner or 0.0) / probe.inner.youngs_modulus, (result.stress_outer or 0.0) / probe.outer.youngs_modulus
    slim = 1 + 0.15 * probe.tube_radius / (probe.tube_radius - probe.hole_radius)
    inner, outer = ((strain / indentation) ** 2 / 0.1 for strain in strains)
    return max(inner * probe.core_height, slim * outer * probe.tube_height)
