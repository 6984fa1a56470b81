"""Prepare the tumours of a population for a search: as arrays of the closed form, at all places of a protocol."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.populations.design_file import Design
from probe_design.populations.population import PLACE_AXES, TumourDraw
from solver.closed_form.contact import Films as FilmStacks
from solver.closed_form.designs import Shape, build_parameters, split_parameters
from solver.closed_form.film_membrane import FilmArray
from solver.tumour_waves.moments import TumourDraws
from solver.tumour_waves.population_films import ManyTumours

PLACE_UNIT_M = 10e-3  # m: x and y count in it, so that their steps are about as large as those of depth


def build_stacks(scene: Scene) -> FilmStacks | None:
    """Return the films and bonds of a scene's blocks, for one probe, where the scene reads charges that need them."""
    shape, values = build_parameters(scene.model_copy(update={"inclusion": ()}))
    return split_stacks(scene, shape, values[:, None])


def split_stacks(scene: Scene, shape: Shape, parameters: Floats) -> FilmStacks | None:
    """Return ``build_stacks`` of n probes, from the closed form's parameters, shape (parameters, n)."""
    if scene.observable == "stress" or not shape.films:
        return None
    inner, outer = (FilmArray(*row) for row in split_parameters(shape, parameters)[2])
    return FilmStacks(inner, outer, shape.insets)


def build_draws(draw: TumourDraw) -> TumourDraws:
    """Convert a draw of tumours to the arrays of ``TumourDraws``, in the scene's coordinates."""
    tissues = np.array([_list_layers(scene.tissue) for scene in draw.tissues])  # (t, layers + 1, 3)
    tissue, ones = np.moveaxis(tissues[draw.tissue], 0, 2), np.ones(len(draw))
    bounded = draw.scene.tissue.shape != "half-space"
    return TumourDraws(
        draw.diameter / 2, draw.depth, draw.x, draw.y, draw.youngs_modulus, draw.poisson_ratio * ones, tissue, bounded
    )


def _list_layers(tissue: Any) -> list[list[float]]:
    """Return thickness, Young's modulus and Poisson's ratio of each layer and of the tissue below."""
    depth = getattr(tissue, "depth", 1.0)  # a half-space has none: its number is not used
    layers = [[layer.thickness, layer.youngs_modulus, layer.poisson_ratio] for layer in tissue.layer]
    return [*layers, [depth, tissue.youngs_modulus, tissue.poisson_ratio]]


def prepare_tumours(design: Design, draw: TumourDraw, draws: TumourDraws, widest: float) -> ManyTumours:
    """Prepare tumours at all positions of the protocol.

    Parameters
    ----------
    design
        The design file.
    draw
        The draw with its tissues.
    draws
        Its tumours as arrays, perhaps with one parameter moved.
    widest
        Outer radius of the widest probe for which they are used, m.
    """
    scene = draw.tissues[0]
    shape, values = build_parameters(scene, merged=False)
    return ManyTumours.from_draws(
        draws,
        design.protocol.list_places(scene.placement.y),
        widest,
        bonded=scene.contact.interface in ("bonded", "unilateral"),
        side=(float(values[10]), shape.side_nodes) if shape.bounded else (1.0, 0),
        layer_nodes=shape.layer_nodes,
    )


def step_parameter(draws: TumourDraws, name: str, step: float) -> TumourDraws:
    """Return tumours with ``step`` added to ln of diameter, depth or tissue modulus, or to x or y in ``PLACE_UNIT_M``."""
    factor = math.exp(step)
    if name in PLACE_AXES:
        return replace(draws, **{name: getattr(draws, name) + step * PLACE_UNIT_M})
    if name == "diameter":
        return replace(draws, radius=draws.radius * factor)
    if name == "depth":
        return replace(draws, depth=draws.depth * factor)
    tissue = draws.tissue.copy()
    tissue[-1, 1] *= factor  # Young's modulus of the tissue below the layers, see ``_list_layers``
    return replace(draws, tissue=tissue)
