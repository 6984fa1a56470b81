"""Build the meridian sections that represent a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import LAYERS, STACKS, Body, Section
from geometry.scenes.base_sizes import find_base_sizes
from geometry.scenes.film import Film
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.film_states import Films
from solver.linalg.workspace import keep_table

OUTLINE_DIRECTIONS = 1440  # directions in which the distance of the tissue's sides is computed
HALF_SPACE_SIZES = 1e6  # radius and depth of the model of a half-space, in sizes of probe and inclusion
MIN_CUT_RELATIVE, TOUCHING_RELATIVE = 1e-7, 1e-6  # of the sphere's radius; nearer interfaces move to the cut


@dataclass(frozen=True)
class Sections:
    """The meridian sections of a scene, with materials.

    Material added to the tissue's sides adds energy to every state, so that in the order of symmetric matrices
    F(inscribed cylinder) <= F <= F(circumscribed cylinder) (AX.1); the cylinder of the same area lies between them too.

    Attributes
    ----------
    section
        With the tissue as a cylinder of its own cross-section's area about the probe's axis.
    bracket
        Cylinders from the inscribed to the circumscribed one; empty where the tissue is round about the axis.
    materials
        The material of every body.
    outline
        Distances of the sides from the probe's axis in evenly spaced directions, m, shape (ANGLES,).
    films
        The inner and the outer film, whose layers are in the sections; None where charges are not modelled.
    """

    section: Section
    bracket: tuple[Section, ...]
    materials: dict[Body, Material]
    outline: Floats
    films: Films | None = None


def build_sections(scene: Scene) -> Sections:
    """Return the sections of a scene with blocks and tissue alone: on a rigid base, without films (see ``add_details``)."""
    probe, tissue, placement = scene.probe, scene.tissue, scene.placement
    angle = (np.arange(OUTLINE_DIRECTIONS) + 0.5) * 2 * np.pi / OUTLINE_DIRECTIONS
    materials: dict[Body, Material] = {Body.TISSUE: tissue, Body.INNER: probe.inner, Body.OUTER: probe.outer}
    sphere = (0.0, 0.0)  # radius and depth of the centre; no inclusion
    materials |= dict(zip(LAYERS, tissue.layer, strict=False))
    layers = {body.name.lower(): layer.thickness for body, layer in zip(LAYERS, tissue.layer, strict=False)}
    if scene.inclusion:
        materials[Body.INCLUSION] = scene.inclusion[0]
        sphere = (scene.inclusion[0].diameter or 0.0) / 2, scene.inclusion[0].depth
    blocks = probe.inner_radius, probe.hole_radius, probe.tube_radius, probe.core_height, probe.tube_height
    if tissue.shape == "cylinder":
        offset = math.hypot(placement.x, placement.y)
        radius, depth = tissue.radius, tissue.depth
        # distance from a point ``offset`` off the centre of a circle to the circle
        outline = np.sqrt(radius**2 - (offset * np.sin(angle)) ** 2) - offset * np.cos(angle)
    elif tissue.shape == "block":
        radius, depth = tissue.side_radius, tissue.depth
        sides = ((np.cos(angle), tissue.length / 2, placement.x), (np.sin(angle), tissue.breadth / 2, placement.y))
        # distance to the first side met; 1e-9 avoids division by 0 parallel to a side
        outline = np.min([(half - np.sign(cosine) * centre) / (np.abs(cosine) + 1e-9) for cosine, half, centre in sides], axis=0)
    else:
        radius = depth = HALF_SPACE_SIZES * max(*blocks, sum(sphere), *layers.values())
        outline = np.full(OUTLINE_DIRECTIONS, radius)
    section = _move_off_poles(Section(*blocks, radius, depth, *sphere, **layers, edge_radius=scene.contact.edge_radius))
    low, high = float(outline.min()), float(outline.max())
    # tissue that is round about the axis needs no bracket; 1e-9 allows for rounding
    bracket = (
        ()
        if high - low < 1e-9 * radius
        else tuple(
            replace(section, tissue_radius=cylinder_radius)
            for cylinder_radius in (low, (low + radius) / 2, (radius + high) / 2, high)
        )
    )
    return Sections(section, bracket, materials, outline)


def _move_off_poles(section: Section) -> Section:
    """Move interfaces that touch the sphere at a pole slightly into it, so that they cut it.

    They move by about ``TOUCHING_RELATIVE`` of the radius at most, less than the rounding of their positions.
    """
    if not section.sphere_radius:
        return section
    radius, thicknesses, last = section.sphere_radius, {}, 0.0
    # ``last``: depth of the interface above
    for body, depth in zip(LAYERS, section.interfaces, strict=False):
        for inwards in (1, -1):  # the upper pole, from which the sphere lies deeper, and the lower one
            pole = section.sphere_depth - inwards * radius
            moved = pole + inwards * MIN_CUT_RELATIVE * radius
            if abs(depth - pole) < TOUCHING_RELATIVE * radius and moved > last:
                depth = moved
        thicknesses[body.name.lower()], last = depth - last, depth
    return replace(section, **thicknesses)


def add_details(scene: Scene, plain: Sections) -> Sections:
    """Return the sections ``plain`` of a scene with its films and elastic base added.

    Raises
    ------
    InputError
        The base's flange is narrower than the tube.
    """
    probe, base = scene.probe, scene.probe.base
    if base.youngs_modulus is None or base.poisson_ratio is None:
        return add_stacks(scene, plain)
    sizes = find_base_sizes(probe)
    # a flange of the tube's radius is none, within rounding
    wide = sizes.flange_radius > probe.tube_radius * (1 + 1e-9)
    lengths = {"flange_thickness": sizes.thickness, "step_height": sizes.step_height}
    lengths["flange_radius"] = sizes.flange_radius if wide else 0.0
    material = Material(youngs_modulus=base.youngs_modulus, poisson_ratio=base.poisson_ratio)
    return _add_bodies(add_stacks(scene, plain), lengths, {Body.BASE: material})


def add_stacks(scene: Scene, plain: Sections) -> Sections:
    """Return the sections ``plain`` of a scene with its films and their bonds added, but without its base."""
    film = scene.probe.film
    stacks = _add_bodies(plain, *_list_stack_layers(film))
    return replace(stacks, films=None if film is None or film.uses_psi else film.by_block)


def _add_bodies(sections: Sections, lengths: dict[str, float], materials: dict[Body, Material]) -> Sections:
    """Return sections with further lengths, by name, and the materials of the bodies that these add."""
    return replace(
        sections,
        section=replace(sections.section, **lengths),
        bracket=tuple(replace(section, **lengths) for section in sections.bracket),
        materials=sections.materials | materials,
    )


@keep_table
def _build_material(youngs_modulus: float, poisson_ratio: float) -> Material:
    """Return a layer's material; the same layer is part of many scenes, and a material checks its numbers."""
    return Material(youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio)


def _list_stack_layers(film: Film | None) -> tuple[dict[str, float], dict[Body, Material]]:
    """Return the thicknesses of the layers on both blocks and the insets of their electrodes, by length, and their materials."""
    lengths: dict[str, float] = {}
    materials: dict[Body, Material] = {}
    for name, block_film, bodies in zip(("inner", "outer"), () if film is None else film.by_block, STACKS, strict=False):
        lengths[f"{name}_inset"] = block_film.electrode_inset
        for body, layer in zip(bodies, block_film.stack, strict=True):
            if layer.thickness > 0 and layer.youngs_modulus is not None and layer.poisson_ratio is not None:
                lengths[body.name.lower()] = layer.thickness
                materials[body] = _build_material(layer.youngs_modulus, layer.poisson_ratio)
    return lengths, materials
