"""The totals of a pair of films: forces and, where the scene reads them, charges; refuse those whose ratio has no logarithm."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats, Numeric
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.readings import Readings
from solver.planning.charge_changes import has_soft_bond
from solver.results.film_forces import FilmForces

MIN_STIFF_SHARE, MIN_SOFT_SHARE = 0.4, 3.0  # of |d33| times force: films glued have 0.55 to 0.85, most films on tape 4 to 10
LOADED_FACTOR = 0.5  # of these under load, which moves charges towards 0
SHARE_WIDTH_RELATIVE = 0.08  # of the step: a film that is glued rigidly keeps 0.99 of its force
MAX_EXPONENT = 40.0  # its factor is 0 to rounding; larger ones would overflow


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


def find_min_share(scene: Scene) -> float:
    """Return the least charge of a film that a search accepts, over d33 times its force: larger where films have soft bonds."""
    return MIN_SOFT_SHARE if has_soft_bond(scene) else MIN_STIFF_SHARE


def compute_charge_shares(scene: Scene, totals: Numeric) -> list[Numeric]:
    """Return the charge of each film over d33 times its force, from totals of shape (..., 4); above 0 on most bonds."""
    films = [] if scene.probe.film is None else scene.probe.film.by_block
    return [totals[..., 2 + number] / (item.d33 * totals[..., number]) for number, item in enumerate(films) if item.d33]


def check_loaded_charges(scene: Scene, films: FilmForces) -> None:
    """Refuse a probe under a load at which what d31 and d33 give of a film's charge nearly cancels.

    Raises
    ------
    Refusal
        A charge is below ``LOADED_FACTOR`` times the least one of a search.
    """
    film = scene.probe.film
    if scene.observable == "stress" or film is None or film.uses_psi:
        return
    if min(compute_charge_shares(scene, stack_totals(scene, films)), default=np.inf) < LOADED_FACTOR * find_min_share(scene):
        remedy = "a load under which both films give charges that do not nearly cancel, or higher blocks"
        raise Refusal("load.force", Words("a film's charge nearly cancels"), remedy)


def find_charge_signs(scene: Scene, totals: Numeric) -> Numeric:
    """Return the signs by which totals of shape (..., 2 or 4) are multiplied to count charges of the right sign as positive.

    Right is the sign that d33 gives. A charge of the other one passes 0 for some modulus of the bonds. Forces keep their sign;
    so do charges whose film has no d33, or psi in its place, whatever it is: they become positive.
    """
    film, signs = scene.probe.film, np.where(np.real(totals) < 0, -1.0, 1.0)
    signs[..., :2] = 1.0
    if totals.shape[-1] == 4 and film is not None and not film.uses_psi:
        expected = np.sign([item.d33 for item in film.by_block])
        signs[..., 2:] = np.where(expected == 0, signs[..., 2:], expected)
    return signs


def weigh_charges(scene: Scene, totals: Numeric) -> Numeric:
    """Return a factor on a design's force in a search, which leaves out films whose charges nearly cancel.

    Where what d31 and d33 give cancels, the ratio is sensitive to everything, most of all to the bonds' modulus, which nobody
    knows to a factor of two, and to the load. The factor is 1 where both charges have the sign and more than the least size that
    films on such bonds have, and falls to 0 below; it is smooth, for gradients.

    Parameters
    ----------
    scene
        Scene with the films.
    totals
        Forces on both films and, where they are read, their charges, without tumours, shape (..., 2 or 4), real or complex.
    """
    film = scene.probe.film
    if totals.shape[-1] == 2 or film is None or film.uses_psi:
        return np.ones(totals.shape[:-1])
    factor, min_share = np.ones(totals.shape[:-1]), find_min_share(scene)
    for share in compute_charge_shares(scene, totals):
        size = np.where(np.real(share) < 0, -share, share)  # searches leave out charges of the wrong sign: ``find_charge_signs``
        exponent = (min_share - size) / (SHARE_WIDTH_RELATIVE * min_share)
        factor = factor / (1 + np.exp(np.where(np.real(exponent) > MAX_EXPONENT, MAX_EXPONENT, exponent)))
    return factor


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


def append_charges(scene: Scene, products: Numeric) -> Numeric:
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
