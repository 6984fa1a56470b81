"""The totals of a pair of films: forces and, where the scene reads them, charges; refuse those whose ratio has no logarithm."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.readings import Readings
from solver.results.film_forces import FilmForces


def stack_totals(scene: Scene, films: FilmForces | Readings) -> Floats:
    """Return forces on both films per unit indentation and, where the scene reads them, their charges, shape (..., 2 or 4)."""
    read = films.get_observable(scene)
    return films.totals if read is films else np.concatenate([films.totals, read.totals], axis=-1)


def check_charge_signs(blank: Floats, totals: Floats) -> None:
    """Refuse charges, in totals of shape (..., 2 or 4), that a tumour turns from those without it, ``blank``.

    Raises
    ------
    Refusal
        The ratio passes 0 or infinity and has no logarithm.
    """
    if np.all(totals[..., 2:] * blank[2:] > 0):
        return
    remedy = "bonds on which both films give charges of one sign over every tumour, such as softer ones"
    raise Refusal("probe.film", Words("a film's charge changes its sign"), remedy)


def check_films_compressed(totals: Floats, scene: Scene) -> None:
    """Refuse film forces, shape (..., 2), of which one is tension: their ratio is negative and has no logarithm.

    Raises
    ------
    Refusal
        A film is in tension, for instance under a stiff skin that bends next to the block with the larger load.
    """
    if np.all(totals > 0):
        return
    film = "inner" if np.any(totals[..., 0] <= 0) else "outer"
    moduli = " and ".join(f"{block.youngs_modulus / 1e3:.4g} kPa" for block in (scene.probe.inner, scene.probe.outer))
    remedy = f"blocks of other areas, or of moduli, now {moduli}, that lie closer together"
    raise Refusal("probe", Words(f"the {film} film is pulled on"), remedy)


def append_charges(scene: Scene, products: Any) -> Any:
    """Return the totals of a scene's films from the closed form's products; charges only where the scene reads them.

    Parameters
    ----------
    scene
        The scene with the films.
    products
        Forces on both films and, where the closed form has them, charges, per unit indentation, shape (..., 2 or 4).
    """
    film = scene.probe.film
    if scene.observable == "stress" or film is None:
        return products[..., :2]
    if film.uses_psi:
        return np.concatenate([products[..., :2], products[..., :2] * [item.charge_per_force for item in film.by_block]], axis=-1)
    return products
