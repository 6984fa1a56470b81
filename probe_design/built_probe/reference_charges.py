"""Predict the films' charges under pins and rings, and the modulus of the bonds, which decides on all charges.

A film's charge is not d33 times the force on it: it depends on how its block is loaded, and on the bonds' modulus, of which a
drawing knows little. So every reference's charge is predicted, on a pin or a ring by ``solver.axisymmetric.pressed_block``, and a
calibration fits the modulus of the soft bonds (``Film.soft_limit``) besides one scale of d per film (``gain_fit``). That of glue
beside tape is a tolerance. With the charges Q over one unit c of
charge per force, and the load F,

    y_inner + y_outer = sigma F,    y = Q / c        (BP.11)

c cancels in all that a calibration determines; it makes y nearly a force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from geometry.cad.fixture import find_fixture_sizes
from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.percent import format_percent
from geometry.scenes.bonds import BOND_SIDES, find_bond
from geometry.scenes.film import Bond, Film
from geometry.scenes.probe import Material, Probe, format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M
from geometry.scenes.variables import PIEZO_KEYS, list_values
from probe_design.built_probe.bench import Reference, Workshop
from solver.axisymmetric.pressed_block import Load, PressedBlock, PressedCharge, press_block, press_once
from solver.results.film_charges import reads_film_states

FILM_KEYS = "probe.film."  # how the keys of films and bonds begin
UNNAMED_BOND_LOG_SD = 0.69  # of ln of the modulus of a bond that is given by numbers: that of tapes in the catalogue
INSET_SD = 1e-4  # m: how far an electrode's edge may be from where it is drawn
STEP = 0.02  # relative change of a number for a derivative: errors of the solver change it by about 1 %
MAX_PIN_STRAIN = 0.05  # mean strain of a block up to which linear elasticity predicts its film's charge under a pin or ring ...
PIN_STRAIN = 0.02  # with which a pin or ring is to be pressed: its charge is then within 3 %
PIN_CHANGE_PER_STRAIN = 1.5  # ... within this times the strain, relative: by contact, -0.08 to -0.8 on stuck faces
UNKNOWN_CONTACT: tuple[Load, Load] = ("frictionless", "stuck")


@dataclass(frozen=True)
class BondModulus:
    """The modulus of the soft bonds: ln of its factor on the scene's, and the standard deviation of that before a calibration.

    Attributes
    ----------
    log_factor, log_sd
        Of the soft bonds, which a calibration fits.
    log_sds
        Standard deviation of ln of every bond's modulus, by key; ``fitted`` are the keys of the soft ones.
    """

    log_factor: float
    log_sd: float
    log_sds: Mapping[str, float] = field(default_factory=dict)
    fitted: tuple[str, ...] = ()

    @classmethod
    def from_scene(cls, scene: Scene, log_factor: float) -> BondModulus:
        """Return the modulus of a scene's soft bonds times exp(``log_factor``)."""
        film = scene.probe.film
        assert film is not None
        log_sds = {
            f"{FILM_KEYS}{prefix}{side}.youngs_modulus": _find_log_sd(bond)
            for prefix, part in (("", film), ("outer.", film.outer))
            for side in BOND_SIDES
            if (bond := getattr(part, side, None)) is not None and not bond.is_rigid
        }
        return cls(log_factor, find_bond_log_sd(scene), log_sds, tuple(list_bond_keys(scene)))


@dataclass(frozen=True)
class LoadFactor:
    """sigma of eq. BP.11 on a reference.

    Attributes
    ----------
    log
        ln sigma.
    variance
        Of it, by the solver, the block's modulus and the contact.
    derivatives
        Of it with respect to the design's variables, per SI unit, shape (v,).
    bond_derivative
        Of it with respect to ln of the soft bonds' modulus.
    film_bond_derivatives
        Likewise of the logarithm of each film's charge, on a block of tissue; None on a pin or ring.
    load_derivative
        Of ln sigma with respect to the logarithm of the load.
    strain
        Of a pin or ring, the mean strain of the block per force, 1/N.
    """

    log: float
    variance: float
    derivatives: Floats
    bond_derivative: float
    film_bond_derivatives: tuple[float, float] | None = None
    load_derivative: float = 0.0
    strain: float = 0.0

    def strain_block(self, force: float, name: str) -> LoadFactor:
        """Return sigma on a pin or ring, ``name``, under a force, N, with the effect of finite strain counted as an error.

        Raises
        ------
        Refusal
            The force strains the block by more than is known.
        """
        strain = force * self.strain
        if strain > MAX_PIN_STRAIN:
            limit = f"up to {MAX_PIN_STRAIN / self.strain:.3g} N, which strains its block by {format_percent(MAX_PIN_STRAIN, 6)}"
            raise Refusal("load", Words(f"{force:.3g} N on the {name}"), f"{limit}; press more lightly, or on a wider end")
        return replace(self, variance=self.variance + (PIN_CHANGE_PER_STRAIN * strain) ** 2 / 3)


def compute_charge_units(scene: Scene) -> Floats:
    """Return the units of charge per force of inner and outer film, C/N, shape (2,).

    Where readings are charges, both are c, the films' mean under an even pressure. Otherwise each is that of its film by eq.
    (12), or of the default film if the scene has none.
    """
    film = scene.probe.film or Film()
    if not reads_film_states(scene):
        return np.array([block_film.charge_per_force for block_film in film.by_block])
    blocks = (build_pressed_block(scene.probe, k, "pressure", None) for k in (0, 1))
    return np.full(2, np.mean([_press_once(block).charge_per_force for block in blocks]))


def list_omitted_films(scene: Scene) -> list[str]:
    """List what gains leave out of films whose charges are not predicted: one line, or none where they are."""
    film = scene.probe.film
    if reads_film_states(scene):
        return []
    if film is None:
        reason = "as the scene has no [probe.film]"
    elif film.uses_psi:
        reason = "by psi1 and psi2 of the scene"
    else:
        reason = "as [probe.film] has no bonds" if scene.reading.observable is None else "by [reading] observable of the scene"
    return [
        f"a film's charge is taken as a multiple of its force, {reason}: of a bonded film it is none, and gains from pins or "
        "blocks leave an error of up to 40 % of the ratio; give the bonds in [probe.film], and read charges"
    ]


def build_pressed_block(probe: Probe, k: int, load: Load, pressed: tuple[float, float] | None) -> PressedBlock:
    """Return the inner (k = 0) or outer (1) block with its film, pressed on its lower face."""
    assert probe.film is not None
    block = (probe.inner, probe.outer)[k]
    material = Material(youngs_modulus=block.youngs_modulus, poisson_ratio=block.poisson_ratio)
    radii = ((0.0, probe.inner_radius), (probe.hole_radius, probe.tube_radius))[k]
    height = (probe.core_height, probe.tube_height)[k]
    film, limit = probe.film.by_block[k], probe.film.soft_limit
    to_block, to_base = ((bond.youngs_modulus or math.inf) <= limit for bond in film.bonds)
    return PressedBlock(*radii, height, material, film, load, pressed, (to_block, to_base))


def predict_pin(
    scene: Scene, reference: Reference, names: tuple[str, ...], unit: float, derivatives: Floats | None = None
) -> LoadFactor:
    """Predict sigma on a pin or a ring.

    Parameters
    ----------
    scene
        For its probe.
    reference
        The pin or ring.
    names
        Keys of the scene's numbers with respect to which to differentiate; a last variable, which does not matter, is added.
    unit
        Magnitude of the unit of charge per force, C/N.
    derivatives
        With respect to these, if they are known already.
    """
    k, contacts = ("inner", "outer").index(reference.on), UNKNOWN_CONTACT if reference.contact is None else (reference.contact,)
    pressed = find_pressed(scene.probe, reference)
    charges = [_press(build_pressed_block(scene.probe, k, contact, pressed)) for contact in contacts]
    logs = np.log([abs(charge.charge_per_force) / unit for charge in charges])
    # between no friction and none but sliding any friction is as likely; the solver's error is as likely within its bound
    variance = (np.ptp(logs) / 2) ** 2 / 3 + max(charge.charge_error for charge in charges) ** 2 / 3
    if derivatives is None:
        derivatives = np.array([_differentiate(scene, k, contacts[-1], pressed, name) for name in names])
    bond_derivative = float(np.mean([charge.bond_derivative for charge in charges]))
    strain = compute_pin_strain(scene.probe, reference)
    return LoadFactor(float(logs.mean()), float(variance), np.append(derivatives, 0.0), bond_derivative, strain=strain)


def compute_pin_strain(probe: Probe, reference: Reference) -> float:
    """Return the mean strain of a block per force of a pin or ring on it, 1/N."""
    block, face = {
        "inner": (probe.inner, (0.0, probe.inner_radius)),
        "outer": (probe.outer, (probe.hole_radius, probe.tube_radius)),
    }[reference.on]
    inner, outer = (
        min(max(radius, face[0]), face[1]) for radius in find_pressed(probe, reference)
    )  # what overhangs is not pressed
    return 1 / (math.pi * (outer**2 - inner**2) * block.youngs_modulus)


def find_pin_load(scene: Scene, reference: Reference) -> float:
    """Return the load, N, up to which a pin or ring is to be pressed: any where readings are forces, which it alone carries."""
    return PIN_STRAIN / compute_pin_strain(scene.probe, reference) if reads_film_states(scene) else math.inf


def compute_pin_charge(scene: Scene, reference: Reference) -> float:
    """Return the charge per force, C/N, of the film under a pin or ring; a contact that is not given is stuck."""
    k, pressed = ("inner", "outer").index(reference.on), find_pressed(scene.probe, reference)
    return _press(build_pressed_block(scene.probe, k, reference.contact or "stuck", pressed)).charge_per_force


def find_pressed(probe: Probe, reference: Reference) -> tuple[float, float]:
    """Return the radii of a pin's or ring's end, m: as the bench states, else those of the fixture, else of the whole face.

    Raises
    ------
    InputError
        The end that the bench states does not touch its block, or touches the other one, too.
    """
    is_pin = reference.on == "inner"
    inner, outer = (0.0, probe.inner_radius) if is_pin else (probe.hole_radius, probe.tube_radius)
    try:
        sizes = find_fixture_sizes(probe)
        inner, outer = np.array((0.0, sizes.pin) if is_pin else sizes.ring) / MM_PER_M
    except InputError:  # too narrow for the fixture: the whole face
        pass
    low = float(inner if reference.inner_radius is None else reference.inner_radius)
    high = float(outer if reference.outer_radius is None else reference.outer_radius)
    if is_pin:
        limits = {"inner_radius": (0.0, min(probe.inner_radius, high)), "outer_radius": (low, probe.hole_radius)}
    else:
        limits = {"inner_radius": (probe.inner_radius, min(probe.tube_radius, high))}
        limits["outer_radius"] = max(probe.hole_radius, low), math.inf
    for key, (min_radius, max_radius) in limits.items():
        value = getattr(reference, key)
        if value is not None and not (min_radius <= value < max_radius and (key == "inner_radius" or value > min_radius)):
            ends = f"from {format_mm(min_radius)}" + (f" to {format_mm(max_radius)}" if max_radius < math.inf else "")
            allowed = f"{ends}, so that the end touches the {reference.on} block and that alone"
            raise InputError(f"{reference.name}: {key}", format_mm(value), allowed)
    return low, high


def _differentiate(scene: Scene, k: int, contact: Load, pressed: tuple[float, float] | None, name: str) -> float:
    """Return the derivative of ln of the charge per force under a pin or ring with respect to a number of the scene."""
    value = list_values(scene)[name]
    step = STEP * (min(value, 0.5 - value) if name.endswith("poisson_ratio") else value)
    if step == 0:
        return 0.0
    below, above = (build_pressed_block(scene.replace({name: value + h}).probe, k, contact, pressed) for h in (-step, step))
    if below == above:
        return 0.0
    low, high = (_press_once(block).charge_per_force for block in (below, above))
    return math.log(high / low) / (2 * step)


@lru_cache(maxsize=256)
def _press(block: PressedBlock) -> PressedCharge:
    """Return the charge of a pressed block, cached."""
    return press_block(block)


@lru_cache(maxsize=256)
def _press_once(block: PressedBlock) -> PressedCharge:
    """Return the charge of a pressed block by one solution, cached."""
    return press_once(block)


def list_bond_keys(scene: Scene) -> list[str]:
    """List the keys of the soft bonds' moduli in a scene."""
    limit = 0.0 if scene.probe.film is None else scene.probe.film.soft_limit
    return [key for key, value in list_values(scene).items() if is_bond_modulus(key) and value <= limit]


def is_bond_modulus(key: str) -> bool:
    """Return whether a key of a scene is that of a bond's modulus."""
    return key.startswith(FILM_KEYS) and ".bond_to_" in key and key.endswith("youngs_modulus")


def scale_bonds(scene: Scene, log_factor: float) -> Scene:
    """Return a scene with the moduli of its soft bonds times exp(``log_factor``)."""
    if log_factor == 0:
        return scene
    values = list_values(scene)
    return scene.replace({key: values[key] * math.exp(log_factor) for key in list_bond_keys(scene)})


def find_bond_log_sd(scene: Scene) -> float:
    """Return the standard deviation of ln of the soft bonds' moduli before a calibration, the largest of all; 0 without bonds."""
    film = scene.probe.film
    if film is None:
        return 0.0
    bonds = [bond for part in film.by_block for bond in part.bonds if (bond.youngs_modulus or math.inf) <= film.soft_limit]
    return max(map(_find_log_sd, bonds), default=0.0)


def _find_log_sd(bond: Bond) -> float:
    """Return the standard deviation of ln of one bond's modulus."""
    return UNNAMED_BOND_LOG_SD if bond.name is None else find_bond(bond.name).log_sd


def find_film_tolerance(name: str, value: float, workshop: Workshop) -> float:
    """Return the standard deviation of a number of a film or bond but a bond's modulus, SI."""
    is_bond = ".bond_to_" in name
    if name.endswith(PIEZO_KEYS):
        return abs(value) * workshop.film_piezo
    if name.endswith("thickness"):
        return value * (workshop.bond_thickness if is_bond else workshop.film_thickness)
    if name.endswith("youngs_modulus"):
        return value * workshop.film_modulus
    if name.endswith("poisson_ratio"):
        return workshop.poisson_ratio if is_bond else workshop.film_poisson_ratio
    return INSET_SD  # the electrode's inset, the only other number
