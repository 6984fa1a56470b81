"""From a scene to the meridian sections that stand for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from geometry.probe import Material
from geometry.scene import Scene
from geometry.section import Body, Section
from geometry.solids import base_sizes

HALF_SPACE = 1e6  # radius and depth of what stands for a half-space, in sizes of probe and inclusion
FILM_POISSON_RATIO = 0.3  # of films and adhesive, whose lateral stiffness the blocks hardly feel


@dataclass(frozen=True)
class Sections:
    """What is solved for a scene.

    Material added to the tissue's sides adds energy to every state, so that in the order of symmetric matrices
    F(inscribed cylinder) <= F <= F(circumscribed cylinder), eq. (A1); the cylinder of the same area lies between them too.

    Attributes:
        section: with the tissue as a cylinder of its own cross-section's area about the probe's axis.
        bracket: the inscribed and the circumscribed cylinder, where they differ from it; else empty.
        materials: of every body.
    """

    section: Section
    bracket: tuple[Section, ...]
    materials: dict[Body, Material]


def sections(scene: Scene) -> Sections:
    """Return the sections of a scene on a rigid base without films."""
    probe, tissue, at = scene.probe, scene.tissue, scene.placement
    materials: dict[Body, Material] = {Body.TISSUE: tissue, Body.INNER: probe.inner, Body.OUTER: probe.outer}
    sphere = (0.0, 0.0)
    if scene.inclusion:
        materials[Body.INCLUSION] = scene.inclusion[0]
        sphere = (scene.inclusion[0].diameter or 0.0) / 2, scene.inclusion[0].depth
    blocks = probe.inner_radius, probe.hole_radius, probe.tube_radius, probe.core_height, probe.tube_height
    if tissue.shape == "cylinder":
        off = math.hypot(at.x, at.y)
        radii, depth = [tissue.radius, tissue.radius - off, tissue.radius + off], tissue.depth
    elif tissue.shape == "block":
        x, y = abs(at.x), abs(at.y)
        near = min(tissue.length / 2 - x, tissue.breadth / 2 - y)
        radii = [
            math.sqrt(tissue.length * tissue.breadth / math.pi),
            near,
            math.hypot(tissue.length / 2 + x, tissue.breadth / 2 + y),
        ]
        depth = tissue.depth
    else:
        depth = HALF_SPACE * max(*blocks, sum(sphere))
        radii = [depth]
    same = all(radius == radii[0] for radius in radii)
    found = [Section(*blocks, radius, depth, *sphere) for radius in radii]
    return Sections(found[0], () if same else tuple(found[1:]), materials)


def with_layers(scene: Scene, plain: Sections) -> Sections:
    """Add the scene's films and elastic base.

    Raises:
        InputError: the base's flange is narrower than the tube.
    """
    probe, layers, materials = scene.probe, {}, dict(plain.materials)
    film, base = probe.film, probe.base
    if film is not None:
        materials[Body.FILM] = Material(youngs_modulus=film.youngs_modulus, poisson_ratio=FILM_POISSON_RATIO)
        layers["film"] = film.thickness
        if film.adhesive_thickness > 0:
            modulus = film.adhesive_modulus or film.youngs_modulus
            materials[Body.ADHESIVE] = Material(youngs_modulus=modulus, poisson_ratio=FILM_POISSON_RATIO)
            layers["adhesive"] = film.adhesive_thickness
    if base.youngs_modulus is not None and base.poisson_ratio is not None:
        materials[Body.BASE] = Material(youngs_modulus=base.youngs_modulus, poisson_ratio=base.poisson_ratio)
        sizes = base_sizes(probe)
        wide = sizes.flange_radius > probe.tube_radius * (1 + 1e-9)
        layers |= {"flange_thickness": sizes.thickness, "step_height": sizes.step_height}
        layers["flange_radius"] = sizes.flange_radius if wide else 0.0
    return Sections(replace(plain.section, **layers), tuple(replace(s, **layers) for s in plain.bracket), materials)
