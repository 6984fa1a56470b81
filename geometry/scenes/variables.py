"""List the numbers of a scene by name, and differentiate the lengths of its meridian section with respect to them."""

from __future__ import annotations

from geometry.scenes.bonds import BOND_SIDES
from geometry.scenes.film import Bond, Film, OuterFilm
from geometry.scenes.probe import LAW_CONSTANTS, Material
from geometry.scenes.scene import Scene

BLOCK_NAMES = ("inner", "outer")
FILM_LENGTHS = ("thickness", "electrode_inset")
PIEZO_KEYS = ("d31", "d32", "d33")
BOND_VALUES = ("thickness", "youngs_modulus", "poisson_ratio")


def list_values(scene: Scene) -> dict[str, float]:
    """Return every length, modulus and Poisson's ratio that a scene's film forces and charges depend on, and d, SI, by its key.

    Keys are those of the scene file, ``probe.inner.youngs_modulus``; ``inclusion.depth`` is that of a scene's only inclusion.
    """
    probe, tissue = scene.probe, scene.tissue
    lengths = {f"probe.{key}": getattr(probe, key) for key in
             ("inner_radius", "area_ratio", "outer_radius", "gap", "height", "inner_height", "outer_height")}  # fmt: skip
    lengths |= {f"tissue.{key}": getattr(tissue, key, None) for key in ("radius", "length", "breadth", "depth")}
    lengths |= _list_film_values(probe.film)
    bodies = {f"probe.{block}": getattr(probe, block) for block in BLOCK_NAMES} | {"probe.base": probe.base, "tissue": tissue}
    if len(scene.inclusion) == 1:
        bodies["inclusion"] = scene.inclusion[0]
        lengths |= {f"inclusion.{key}": getattr(scene.inclusion[0], key) for key in ("diameter", "depth")}
    for index, layer in enumerate(tissue.layer):
        bodies[f"tissue.layer[{index}]"] = layer
        lengths[f"tissue.layer[{index}].thickness"] = layer.thickness
    for name, body in bodies.items():
        lengths |= {f"{name}.{key}": getattr(body, key) for key in ("youngs_modulus", "poisson_ratio")}
    return {key: value for key, value in lengths.items() if value is not None}


def _list_film_values(film: Film | None) -> dict[str, float | None]:
    """Return every number of the films and their bonds that charges depend on, by its key; None where there is none."""
    values: dict[str, float | None] = {}
    for prefix, part in _list_film_parts(film):
        values |= {f"{prefix}.{key}": getattr(part, key) or None for key in FILM_LENGTHS}  # an inset of 0 has no derivative
        values |= {f"{prefix}.{key}": getattr(part, key) for key in ("youngs_modulus", "poisson_ratio")}
        if film is not None and not film.uses_psi:
            values |= {f"{prefix}.{key}": getattr(part, key) for key in PIEZO_KEYS}
        for side in BOND_SIDES:
            bond = getattr(part, side)
            if bond is not None and not bond.is_rigid:
                values |= {f"{prefix}.{side}.{key}": getattr(bond, key) for key in BOND_VALUES}
    return values


def _list_film_parts(film: Film | None) -> list[tuple[str, Film | OuterFilm]]:
    """Return the film and what differs on the outer block, each after the key of its table."""
    parts: list[tuple[str, Film | OuterFilm]] = [] if film is None else [("probe.film", film)]
    return parts if film is None or film.outer is None else [*parts, ("probe.film.outer", film.outer)]


def find_film_part(film: Film | None, name: str) -> tuple[str, tuple[str, ...]]:
    """Return what a number of the films belongs to: "film" or a side of ``BOND_SIDES``, and the blocks whose film has it.

    ``name`` is a key such as ``probe.film.thickness`` or ``probe.film.outer.bond_to_base.youngs_modulus``; no block has a number
    of another table. A number of the film belongs to both blocks unless the outer film has its own.
    """
    if film is None or not name.startswith("probe.film."):
        return "", ()
    *tables, key = name.removeprefix("probe.film.").split(".")
    part = tables[-1] if tables and tables[-1] in BOND_SIDES else "film"
    if tables and tables[0] == "outer":
        return part, ("outer",)
    replaced = film.outer is not None and getattr(film.outer, key if part == "film" else part, None) is not None
    return part, ("inner",) if replaced else BLOCK_NAMES


def _differentiate_film_lengths(film: Film | None) -> dict[str, dict[str, float]]:
    """Return the derivatives of a section's lengths by those of films and bonds, see ``compute_length_derivatives``."""
    derivatives: dict[str, dict[str, float]] = {}
    for name in _list_film_values(film):
        key, (part, blocks) = name.rpartition(".")[2], find_film_part(film, name)
        length = {"thickness": part, "electrode_inset": "inset"}.get(key)
        if length is not None:
            derivatives[name] = {f"{block}_{length}": 1.0 for block in blocks}
    return derivatives


def list_loss_factors(scene: Scene) -> dict[str, float]:
    """Return tan delta of every material of a scene that can have one, by its key, ``inclusion[1].loss_factor``.

    A scene's only inclusion is called ``inclusion``, as in ``list_values``.
    """
    return {f"{name}.loss_factor": body.loss_factor for name, body in (list_materials(scene) | list_bonds(scene)).items()}


def list_law_constants(scene: Scene) -> dict[str, float]:
    """Return the constants of every law at finite strain that has some, by their keys, ``tissue.c2_over_c1``."""
    bodies = {name: body for name, body in list_materials(scene).items() if body.law != "neo-hookean"}
    return {f"{name}.{key}": getattr(body, key) for name, body in bodies.items() for key in LAW_CONSTANTS}


def list_materials(scene: Scene) -> dict[str, Material]:
    """Return every material of a scene that can be lossy, by its key; a scene's only inclusion is called ``inclusion``."""
    bodies = {f"probe.{block}": getattr(scene.probe, block) for block in BLOCK_NAMES} | {"tissue": scene.tissue}
    bodies |= {f"tissue.layer[{index}]": layer for index, layer in enumerate(scene.tissue.layer)}
    alone = len(scene.inclusion) == 1
    return bodies | {"inclusion" if alone else f"inclusion[{k}]": body for k, body in enumerate(scene.inclusion)}


def list_bonds(scene: Scene) -> dict[str, Bond]:
    """Return the bonds of a scene's films that have a thickness, by their keys."""
    sides = {
        f"{prefix}.{side}": getattr(part, side) for prefix, part in _list_film_parts(scene.probe.film) for side in BOND_SIDES
    }
    return {key: bond for key, bond in sides.items() if bond is not None and not bond.is_rigid}


def compute_length_derivatives(scene: Scene) -> dict[str, dict[str, float]]:
    """Return the derivatives of the lengths of a scene's ``geometry.meridian.section.Section`` with respect to its own lengths.

    The outer keys are those of the scene file, the inner ones fields of the section; derivatives that are 0 are left out.
    A block of tissue stands for the cylinder of the same area; a half-space has no length.
    """
    probe, tissue, present = scene.probe, scene.tissue, list_values(scene)
    ri, ro = probe.hole_radius, probe.tube_radius
    derivatives: dict[str, dict[str, float]] = {
        "probe.gap": {"hole_radius": 1.0},
        "probe.inner_radius": {"inner_radius": 1.0, "hole_radius": 1.0},
    }
    if probe.area_ratio is None:
        derivatives["probe.outer_radius"] = {"tube_radius": 1.0}
    else:  # the tube's radius follows from the area ratio: Ro^2 = Ri^2 + r2^2 / (A2/A1)
        derivatives["probe.gap"]["tube_radius"] = ri / ro
        derivatives["probe.inner_radius"]["tube_radius"] = (ri + probe.inner_radius / probe.area_ratio) / ro
        derivatives["probe.area_ratio"] = {"tube_radius": -(probe.inner_radius**2) / (2 * ro * probe.area_ratio**2)}
    derivatives["probe.height"] = {"inner_height": 1.0, "outer_height": 1.0}
    derivatives |= {f"probe.{block}_height": {f"{block}_height": 1.0} for block in BLOCK_NAMES}
    derivatives |= _differentiate_film_lengths(probe.film)
    derivatives["tissue.radius"], derivatives["tissue.depth"] = {"tissue_radius": 1.0}, {"tissue_depth": 1.0}
    if tissue.shape == "block":
        for side in ("length", "breadth"):
            derivatives[f"tissue.{side}"] = {"tissue_radius": tissue.side_radius / (2 * getattr(tissue, side))}
    derivatives |= {f"tissue.layer[{index}].thickness": {f"layer_{index}": 1.0} for index in range(len(tissue.layer))}
    derivatives["inclusion.diameter"], derivatives["inclusion.depth"] = {"sphere_radius": 0.5}, {"sphere_depth": 1.0}
    return {key: change for key, change in derivatives.items() if key in present}
