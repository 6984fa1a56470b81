"""Compute the fields of a result that concern the films' charges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from solver.results.film_forces import FilmForces, compute_indentation
from solver.results.warnings import Note


def find_charges(scene: Scene, films: FilmForces) -> FilmForces | None:
    """Return the films' charges in the form of film forces, Q_ij in C per m of displacement of base j.

    Where the scene gives psi1 or psi2, each is the force times the charge per force of the paper's eq. (12). Otherwise they are
    the evaluator's; None where it has none.
    """
    film = scene.probe.film
    if film is None or not film.uses_psi:
        return films.charges
    factors = np.array([block_film.charge_per_force for block_film in film.by_block])[:, None]
    derivative = None if films.modulus_derivative is None else factors * films.modulus_derivative
    bound = replace(films.bound, totals=np.abs(factors[:, 0]) * films.bound.totals, sum=None)
    return FilmForces(factors * films.forces, bound, derivative, films.sensitivity_error)


def warn_of_unknown_bonds(scene: Scene, films: FilmForces) -> tuple[Note, ...]:
    """Return a warning where charges follow from the stress of a film without bonds, which is taken as bonded rigidly."""
    film = scene.probe.film
    if film is None or film.uses_psi or films.charges is None or film.by_block[0].has_bonds:
        return ()  # the outer film has the bonds of the inner one, unless it has its own
    name = "inner film" if film.by_block[1].has_bonds else "film"
    text = f"the {name} is taken as bonded rigidly on both sides; tape makes its charge 5 to 15 times larger"
    return (Note("bond", f'{text}: give [probe.film.bond_to_base], name = "tape-50um", or "rigid" if it is'),)


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
    charges = find_charges(scene, films)
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
    if np.all(errors < 1):
        areas = scene.probe.inner_area, scene.probe.outer_area
        fields["charge_ratio"] = float(totals[0] / totals[1] * areas[1] / areas[0])
        fields["charge_ratio_error"] = charges.ratio_error
        fields["charge_log_sensitivity"] = charges.log_sensitivity
        fields["charge_log_sensitivity_error"] = None if charges.log_sensitivity is None else charges.sensitivity_error
    return fields
