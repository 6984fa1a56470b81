"""Compute the fields of a result that concern the films' charges."""

from __future__ import annotations

import numpy as np

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from solver.results.film_forces import FilmForces, compute_indentation
from solver.results.warnings import Note

RATIO_FIELDS = ("charge_ratio", "charge_ratio_error", "charge_log_sensitivity", "charge_log_sensitivity_error")


def warn_of_bonds(scene: Scene, films: FilmForces) -> tuple[Note, ...]:
    """Return a warning where a film has no bonds and is taken as bonded rigidly, or where eq. (12) leaves its bonds out."""
    film = scene.probe.film
    return () if film is not None and not film.uses_psi and films.charges is None else _describe_bonds(scene)


def _describe_bonds(scene: Scene) -> tuple[Note, ...]:
    """Return the warning of ``warn_of_bonds`` for films whose charges are computed."""
    film = scene.probe.film
    if film is None:
        return ()
    if film.uses_psi and film.has_bonds:
        text = "psi1 and psi2 put eq. (12) in place of the film's stress, whatever its bonds"
        return (Note("bond", f"{text}: leave both out of [probe.film] for the charge that the bonds give"),)
    if film.uses_psi or film.by_block[0].has_bonds:
        return ()  # the outer film has the bonds of the inner one, unless it has its own
    name = "inner film" if film.by_block[1].has_bonds else "film"
    text = f"the {name} is taken as bonded rigidly on both sides; tape makes its charge 5 to 15 times larger"
    return (Note("bond", f'{text}: give [probe.film.bond_to_base], name = "tape-50um", or "rigid" if it is'),)


def warn_of_read_bonds(scene: Scene) -> tuple[Note, ...]:
    """Return the warning of ``warn_of_bonds`` where readings are the charges; else none."""
    return _describe_bonds(scene) if scene.observable == "charge" else ()


def reads_film_states(scene: Scene) -> bool:
    """Return whether a scene reads charges that follow from the films' stress."""
    return scene.observable == "charge" and scene.models_charges


def compute_charge_fields(scene: Scene, films: FilmForces) -> JsonObject:
    """Return the fields of a ``Result`` that concern the charges, with their errors; none where there are no charges.

    Ratio and log-sensitivity are missing where a charge is below its own error.

    Parameters
    ----------
    scene
        With the films.
    films
        Film forces, with the films' charges.

    Raises
    ------
    Refusal
        The load drives the probe deeper than the tissue.
    """
    charges = films.find_charges(scene)
    if charges is None:
        return {}
    indentation = compute_indentation(scene, float(films.totals.sum()))
    totals, errors = charges.totals, charges.relative_errors
    # a given force sets the indentation by the stiffness, whose error adds
    at_load = errors + (films.stiffness_error if scene.load.force is not None else 0.0)
    per_force = np.divide(totals, films.totals, out=np.full(2, np.nan), where=films.totals != 0)
    fields: JsonObject = {}
    for name, k in (("inner", 0), ("outer", 1)):
        fields[f"charge_{name}"] = float(totals[k] * indentation)
        if errors[k] < 1 and films.relative_errors[k] < 1:
            fields[f"charge_{name}_error"] = float(at_load[k])
            fields[f"charge_per_force_{name}"] = float(per_force[k])
            fields[f"charge_per_force_{name}_error"] = float(errors[k] + films.relative_errors[k])
    return fields | compute_charge_ratio_fields(scene, films)


def compute_charge_ratio_fields(scene: Scene, films: FilmForces) -> JsonObject:
    """Return the fields ``RATIO_FIELDS`` of a ``Result``; all are None where there are no charges or one is below its error."""
    charges = films.find_charges(scene)
    if charges is None or not np.all(charges.relative_errors < 1):
        return dict.fromkeys(RATIO_FIELDS)
    areas = scene.probe.inner_area, scene.probe.outer_area
    ratio = float(charges.totals[0] / charges.totals[1] * areas[1] / areas[0])
    sensitivity_error = None if charges.log_sensitivity is None else charges.sensitivity_error
    values = (ratio, charges.ratio_error, charges.log_sensitivity, sensitivity_error)
    return dict(zip(RATIO_FIELDS, values, strict=True))


def explain_null_charges(name: str, scene: Scene, films: FilmForces) -> tuple[Note, ...]:
    """Return the warning that an evaluator, ``name``, has no charges of a scene's films, or no ratio of them; else none."""
    if scene.probe.film is None:
        return ()
    charges = films.find_charges(scene)
    if charges is None:
        return (Note("null", f"charges are null: {name} does not compute the stress in the films"),)
    unresolved = [film for film, error in zip(("inner", "outer"), charges.relative_errors, strict=True) if not error < 1]
    if unresolved:
        return (Note("null", f"charge_ratio and charge_log_sensitivity are null: charge_{unresolved[0]} is below its own error"),)
    return ()
