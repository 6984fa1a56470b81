"""Uncertain numbers of films and bonds, which change the charges: thicknesses, moduli, insets, and the temperature of tape.

The modulus of a tape falls with the temperature, and its loss factor with it, by an assumed 7 % per kelvin: pressure-sensitive
adhesives are used in their glass transition, where both change by some 5 to 10 % per kelvin. With T the deviation from the
temperature at which the modulus holds, k = ``TAPE_COEFFICIENT_PER_K``, and all tapes at one temperature,

    ln E(T) = ln E - k T,   dy/dT = -k sum over tapes of dy / d ln E.   (TO.7)

The loss factor changes the ratio's phase alone, ``solver.phase``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from geometry.scenes.bonds import find_bond
from geometry.scenes.film import Bond
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_bonds, list_values
from geometry.workshop.tolerance import DEVIATION_PER_SD

TEMPERATURE_NAME = "film.temperature"
TAPE_COEFFICIENT_PER_K = 0.07  # assumed, of ln modulus and ln loss factor per kelvin
TEMPERATURE_SD_K = 2.0  # assumed: a room between calibration and use
MAX_TAPE_MODULUS_PA = 50e6  # stiffer bonds are glues below their glass transition, which the temperature hardly changes
FILM_PREFIX = "probe.film."
CATALOGUE_TOLERANCE_RELATIVE = 1e-9  # a modulus that differs more from the catalogue's is a measured one


@dataclass(frozen=True)
class UsualDeviation:
    """The usual standard deviation of a number, where nothing else is known.

    Attributes
    ----------
    kind
        As of ``uncertain_numbers.UncertainNumber``.
    compute_sd
        Returns the standard deviation, SI, from the drawn value.
    source
        Where it comes from.
    """

    kind: Literal["length", "modulus", "poisson_ratio", "charge"]
    compute_sd: Callable[[float], float]
    source: str


PIEZO_SOURCE = "the paper's Table 1 and the maker's typical value, {values} pC/N: half their distance"
FILM_DEVIATIONS = {
    "d31": UsualDeviation(
        "charge", lambda value: abs(value) * math.log(23 / 20) / 2 / DEVIATION_PER_SD, PIEZO_SOURCE.format(values="20 and 23")
    ),
    "d32": UsualDeviation("charge", lambda value: 0.2 * abs(value), "assumed: 20 % of d32, which the maker does not state"),
    "d33": UsualDeviation(
        "charge", lambda value: abs(value) * math.log(33 / 20) / 2 / DEVIATION_PER_SD, PIEZO_SOURCE.format(values="-20 and -33")
    ),
    "thickness": UsualDeviation("length", lambda value: 0.05 * value, "assumed: 5 % of the film's thickness"),
    "youngs_modulus": UsualDeviation(
        "modulus", lambda value: math.log(2) / 2 / DEVIATION_PER_SD * value, "makers state 2 to 4 GPa for PVDF: half that range"
    ),
    "poisson_ratio": UsualDeviation("poisson_ratio", lambda value: 0.03, "assumed: PVDF films are given as 0.2 to 0.4"),
    "electrode_inset": UsualDeviation("length", lambda value: 0.1e-3 / DEVIATION_PER_SD, "assumed: cut or printed to 0.1 mm"),
}
BOND_DEVIATIONS = {
    "thickness": UsualDeviation("length", lambda value: 0.1 * value, "assumed: 10 % of a bond's thickness"),
    "youngs_modulus": UsualDeviation("modulus", lambda value: 0.02 * value, "measured: 2 %"),
    "poisson_ratio": UsualDeviation("poisson_ratio", lambda value: 0.003, "assumed: 0.003"),
}


def list_film_deviations(scene: Scene) -> dict[str, tuple[float, UsualDeviation]]:
    """Return the drawn value, SI, and the usual deviation of every number of films and bonds, by name.

    Names are keys of the scene, except those of ``list_shared_moduli``.
    """
    bonds, shared = list_bonds(scene), list_shared_moduli(scene)
    names = {key: name for name, keys in shared.items() for key in keys}
    deviations: dict[str, tuple[float, UsualDeviation]] = {}
    for key, value in list_values(scene).items():
        owner, _, number = key.rpartition(".")
        if key.startswith(FILM_PREFIX) and value != 0.0:  # a d of 0 has no part in the charge
            deviation = find_bond_deviation(bonds[owner], number) if owner in bonds else FILM_DEVIATIONS[number]
            deviations[names.get(key, key)] = value, deviation
    return deviations


def list_shared_moduli(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the keys of the moduli that deviate together, by a name of their own: of several bonds of one unmeasured product."""
    keys: dict[str, list[str]] = {}
    for owner, bond in list_bonds(scene).items():
        if is_unmeasured(bond):
            keys.setdefault(f"film.{bond.name}.youngs_modulus", []).append(f"{owner}.youngs_modulus")
    return {name: tuple(owners) for name, owners in keys.items() if len(owners) > 1}


def is_unmeasured(bond: Bond) -> bool:
    """Return whether a bond's modulus is that of the catalogue."""
    if bond.name is None:
        return False
    listed = Bond.model_validate({"name": bond.name}).youngs_modulus
    if listed is None or bond.youngs_modulus is None:
        return False
    return abs(bond.youngs_modulus / listed - 1) <= CATALOGUE_TOLERANCE_RELATIVE


def find_bond_deviation(bond: Bond, key: str) -> UsualDeviation:
    """Return the usual deviation of a number of a bond."""
    if key != "youngs_modulus" or bond.name is None or not is_unmeasured(bond):
        return BOND_DEVIATIONS[key]
    entry = find_bond(bond.name)
    source = f"{bond.name}: a factor of e^{entry.log_sd:g} either way until it is measured"
    return UsualDeviation("modulus", lambda value: entry.log_sd * value, source)


def list_tape_moduli(scene: Scene) -> dict[str, float]:
    """Return the moduli of the bonds that are tapes, Pa, by key."""
    moduli = {f"{name}.youngs_modulus": bond.youngs_modulus for name, bond in list_bonds(scene).items()}
    return {name: modulus for name, modulus in moduli.items() if modulus is not None and modulus <= MAX_TAPE_MODULUS_PA}
