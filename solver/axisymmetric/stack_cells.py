"""Choose how finely films and bonds are meshed: as few cells as a charge needs, by its film's bonds."""

from __future__ import annotations

from dataclasses import replace

from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.stack_fineness import StackFineness
from geometry.scenes.scene import Scene

# of the inner radius: a film whose shear length is longer floats, and a charge's error at its corners is small
MIN_FLOATING_SHARE = 0.4
MAX_THIN_BOND_M = 7.5e-5  # m: thicker ones need more cells at the walls
MAX_OTHER_LAYERS = 2  # at other corners below order 6: a third changes forces by 1e-5, a charge's error is bounded by some 1e-4
WALL_RATIO = 0.22  # of strips and layers: after two of them cells at a wall are about as wide as rows are high
ONE_ROW = StackFineness(1, (1, 1, 1), 1)
TWO_ROWS = StackFineness(1, (2, 2, 2), 1)
CORNERS = StackFineness(2, (2, 1, 2), 1)
LIGHT = StackFineness(2, (1, 1, 1), 2, 0.3)  # wider strips, as one row does not follow a corner's field
COARSE = StackFineness(2, (2, 1, 2), 2, WALL_RATIO)
MIDDLE = StackFineness(3, (2, 1, 2), 2, WALL_RATIO)


def choose_stack_fineness(scene: Scene, fineness: MeridianFineness) -> MeridianFineness:
    """Return the fineness of a mesh with that of the scene's films and bonds.

    Parameters
    ----------
    scene
        With films, or without.
    fineness
        Of the mesh, without that of films and bonds.
    """
    stack = _choose(scene, fineness)
    if stack is None:
        return fineness
    layers = min(fineness.layers, MAX_OTHER_LAYERS) if scene.models_charges and fineness.order < 6 else fineness.layers
    return replace(fineness, layers=layers, stack=stack)


def choose_strain_stack(scene: Scene) -> StackFineness:
    """Return the fineness of films and bonds on a mesh that strains in the tissue are taken from, to some 1e-4 of each.

    With it the effect of a tumour on a charge changes by at most 3e-5 under films that are bonded rigidly to the base, 1.3e-4
    under others (10 probes), against a mesh with more cells and a higher order.
    """
    films = scene.probe.film.by_block if scene.probe.film is not None and scene.models_charges else ()
    if any(film.bonds[1].is_rigid for film in films):
        return CORNERS
    thickest = max((bond.thickness for film in films for bond in film.bonds), default=0.0)
    return ONE_ROW if thickest <= MAX_THIN_BOND_M else TWO_ROWS


def has_bare_film(scene: Scene) -> bool:
    """Return whether the charge of a film that is bonded rigidly on both sides is modelled."""
    films = scene.probe.film.by_block if scene.probe.film is not None and scene.models_charges else ()
    return any(film.stack_height == film.thickness for film in films)


def _choose(scene: Scene, fineness: MeridianFineness) -> StackFineness | None:
    """Return the fineness of films and bonds; None for as many corner layers as elsewhere."""
    if scene.probe.film is None:
        return None
    if not scene.models_charges:
        return ONE_ROW if fineness.layers <= 3 else None  # forces alone are wanted
    if fineness.order >= 6:
        rows = fineness.count(2)
        return StackFineness(fineness.layers + 1, (rows, rows, rows), 2, WALL_RATIO)
    films = scene.probe.film.by_block
    bonds = [bond for film in films for bond in film.bonds]
    glue = [bond.is_glue for bond in bonds]
    thin = all(bond.thickness <= MAX_THIN_BOND_M for bond in bonds)
    floats = all(film.shear_length >= MIN_FLOATING_SHARE * scene.probe.inner_radius for film in films)
    is_glued = all(glue) and thin  # on both sides alike, which clamps neither
    if fineness.order == 5:
        return COARSE if is_glued or (floats and thin and not any(glue)) else MIDDLE
    if fineness.layers > 1:
        return COARSE
    return ONE_ROW if is_glued or floats else LIGHT
