"""Choose how finely films and bonds are meshed: as few cells as a charge needs, by its film's bonds and the accuracy."""

from __future__ import annotations

from dataclasses import replace

from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.stack_fineness import StackFineness
from geometry.scenes.film import Bond
from geometry.scenes.scene import Scene

SOFT_MODULUS = 3e6  # Pa: on softer bonds a film floats, and a charge's error at its corners is small
GLUE_MODULUS = 1e8  # Pa: bonds between tape and glue, of which none are known, count as tape
MAX_FLOATING_BOND_M = 7.5e-5  # m: thicker ones need more cells at the walls where the accuracy is high
LOW_ACCURACY, THICK_LOW_ACCURACY = 1.8e-3, 5e-3  # from which few cells suffice at the corners of glue, too; and of thick bonds
HIGH_ACCURACY = 8e-4  # below it fewer cells than elsewhere would seldom do
MAX_OTHER_LAYERS = 2  # at other corners: a third changes forces by 1e-5, where a charge's error is bounded by some 1e-4
ONE_ROW = StackFineness(1, (1, 1, 1))
FLOATING = StackFineness(1, (2, 1, 1))  # most of the error bound comes from the bond to the block
BARE = StackFineness(2, (1, 1, 1))  # on the light mesh: half of the error bound comes from the blocks' upper corners
TWO_ROWS = StackFineness(1, (2, 2, 2))
GLUED = StackFineness(2, (2, 1, 2))  # strips at the walls are about as wide as thin rows are high
CORNERS = StackFineness(2, (2, 1, 2), corners=True)
FINE_CORNERS = StackFineness(3, (2, 1, 2), corners=True)  # as many layers as elsewhere without charges


def choose_stack_fineness(scene: Scene, fineness: MeridianFineness, accuracy: float) -> MeridianFineness:
    """Return the fineness of a mesh with that of the scene's films and bonds.

    Only the first meshes are changed; finer ones have as many corner layers in films and bonds as elsewhere.

    Parameters
    ----------
    scene
        With films, or without.
    fineness
        Of the mesh, without that of films and bonds.
    accuracy
        Relative, that is required of the charges.
    """
    stack = _choose(scene, fineness, accuracy)
    if stack is None:
        return fineness
    layers = min(fineness.layers, MAX_OTHER_LAYERS) if scene.models_charges else fineness.layers
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
    return ONE_ROW if thickest <= MAX_FLOATING_BOND_M else TWO_ROWS


def has_bare_film(scene: Scene) -> bool:
    """Return whether the charge of a film that is bonded rigidly on both sides is modelled."""
    films = scene.probe.film.by_block if scene.probe.film is not None and scene.models_charges else ()
    return any(film.stack_height == film.thickness for film in films)


def _choose(scene: Scene, fineness: MeridianFineness, accuracy: float) -> StackFineness | None:
    """Return the fineness of films and bonds; None for as many corner layers as elsewhere."""
    if scene.probe.film is None:
        return None
    if not scene.models_charges:
        return ONE_ROW if fineness.layers <= 3 else None  # forces alone are wanted
    bare, films = has_bare_film(scene), scene.probe.film.by_block
    if fineness.layers == 1:
        return BARE if bare else None
    if (fineness.layers, fineness.order) != (3, 5) or accuracy < HIGH_ACCURACY:
        return None
    if bare:
        return CORNERS
    if any(film.bonds[1].is_rigid for film in films):
        return FINE_CORNERS
    bonds = [bond for film in films for bond in film.bonds if not bond.is_rigid]
    is_glued = all(_get_modulus(bond) >= GLUE_MODULUS for bond in bonds)
    is_soft = all(_get_modulus(bond) <= SOFT_MODULUS for bond in bonds)
    is_thin = max(bond.thickness for bond in bonds) <= MAX_FLOATING_BOND_M
    if accuracy >= (LOW_ACCURACY if is_thin else THICK_LOW_ACCURACY) and (is_soft or is_glued):
        return ONE_ROW
    if is_soft and is_thin and _has_deep_tumour(scene):
        return FLOATING
    return GLUED if is_glued else CORNERS


def _get_modulus(bond: Bond) -> float:
    """Return Young's modulus of a bond that is not rigid, Pa."""
    assert bond.youngs_modulus is not None  # checked with the scene
    return bond.youngs_modulus


def _has_deep_tumour(scene: Scene) -> bool:
    """Return whether a sphere is covered by more tissue than the inner block is wide.

    Without one, or with a nearer one, the tissue's coarser cells use up most of the error.
    """
    return any(body.depth - (body.diameter or 0.0) / 2 > scene.probe.inner_radius for body in scene.inclusion)
