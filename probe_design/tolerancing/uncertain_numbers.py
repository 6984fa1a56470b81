"""Uncertain numbers of a built probe: lengths, moduli and Poisson's ratios of its blocks, gains of its films, and their stacks.

With eta standard normal, x0 (nu0) the drawn value, t its standard deviation and a = ln(2 nu0 / (1 - 2 nu0)), each number is
distributed so that no draw is impossible and its first order is t eta:

    x = x0 e^(t eta / x0)  of lengths, moduli, gains and d;   nu = 1 / (2 + 2 e^(-a - s eta)),  s = t / (nu0 (1 - 2 nu0))   (TO.1)

The temperature of tapes, which counts from the one at which their moduli hold, is t eta.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from geometry.common.errors import InputError, describe_choices
from geometry.common.json_types import JsonMapping
from geometry.common.percent import format_percent
from geometry.scenes.catalogue import find_material
from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.units import Quantity, read_fraction
from geometry.scenes.variables import list_values
from geometry.workshop.tolerance import BLOCK_LENGTHS, find_length_sd, find_length_tolerance, format_deviation
from probe_design.built_probe.bench import Bench, Channels, Workshop
from probe_design.tolerancing.film_numbers import (
    TAPE_COEFFICIENT_PER_K,
    TEMPERATURE_NAME,
    TEMPERATURE_SD_K,
    list_film_deviations,
    list_tape_moduli,
)
from solver.results.film_charges import reads_film_states

Kind = Literal["length", "modulus", "poisson_ratio", "gain", "temperature", "charge"]
GAIN_NAMES = ("film.inner.gain", "film.outer.gain")
RADIUS_KEY, GAP_KEY = "probe.inner_radius", "probe.gap"
TEMPERATURE_QUANTITY = Quantity("temperature deviation", "K", "K", 0.0, 30.0)
MAX_LOG_SD = 2.0  # standard deviation of a logarithm, at most
ALLOWED_RELATIVE_SD = f"a relative standard deviation from 0 to {MAX_LOG_SD:g}, such as 0.02 or 2 %"
ALLOWED_POISSON_SD = "a standard deviation from 0 to 0.1, such as 0.003"


@dataclass(frozen=True)
class UncertainNumber:
    """A number of the probe that varies between built probes.

    Attributes
    ----------
    name
        Its key in the scene file; for the gain of a film one of ``GAIN_NAMES``, for the temperature of tapes
        ``TEMPERATURE_NAME``; else see ``film_numbers.list_shared_moduli``.
    kind
        Length, modulus, Poisson's ratio, gain, temperature, or charge per force (d31, d32, d33).
    value
        As drawn, SI; 1 for a gain, 0 for a temperature.
    sd
        Standard deviation of the built value, SI; for a modulus E that of ln E, times E.
    source
        Where the standard deviation comes from.
    """

    name: str
    kind: Kind
    value: float
    sd: float
    source: str

    def draw(self, eta: Any) -> Any:
        """Return the value at standard normal ``eta``, eq. TO.1; real or complex, any shape."""
        if self.kind == "temperature":
            return self.sd * eta
        if self.kind != "poisson_ratio" and self.value != 0.0:
            return self.value * np.exp(self.sd / self.value * eta)
        if self.sd == 0.0 or self.value == 0.0:
            return self.value + 0.0 * eta  # of eta's shape
        odds = math.log(2 * self.value / (1 - 2 * self.value))
        return 0.5 / (1 + np.exp(-odds - self.sd / (self.value * (1 - 2 * self.value)) * eta))


def list_uncertain_numbers(
    scene: Scene, bench: Bench | None = None, materials: Mapping[str, str] | None = None, given: JsonMapping | None = None
) -> tuple[UncertainNumber, ...]:
    """Return the uncertain numbers of a scene's probe, which is given by its outer radius.

    Lengths vary by the tolerance of their block's process (``geometry/workshop/processes.toml``), the gap by that of the hole's
    radius. A modulus from the catalogue varies as the catalogue states, any other as a measured one. Films and bonds, as in
    ``film_numbers``, count where the scene reads charges, which change with them.

    Parameters
    ----------
    scene
        See ``probe_design.built_probe.block_predictions.express_by_outer_radius``.
    bench
        Its ``[channels]`` give the gains, its ``[workshop]`` lengths and measured numbers; by default as above.
    materials
        Names in the catalogue of the materials of the blocks "inner" and "outer", for the scatter of their moduli.
    given
        Standard deviations by name, which replace the above: text with a unit, "5 %", or SI numbers; relative for moduli and
        gains.

    Raises
    ------
    InputError
        There is no such block, material or name, or a given value is no standard deviation.
    """
    workshop, channels = (Workshop(), Channels()) if bench is None else (bench.workshop, bench.channels)
    origin = "built-in bench" if bench is None else "bench"
    numbers = {name: _build_number(scene, name, value, workshop, origin) for name, value in _list_block_values(scene).items()}
    if bench is None:
        numbers |= {name: _apply_process(scene, number) for name, number in numbers.items() if name in BLOCK_LENGTHS}
    numbers |= {name: UncertainNumber(name, "gain", 1.0, channels.gain, f"{origin}, [channels] gain") for name in GAIN_NAMES}
    # of each block whose modulus comes from the catalogue and is not measured
    catalogue_entries = {"inner": scene.probe.inner.unmeasured_entry, "outer": scene.probe.outer.unmeasured_entry}
    named_materials = {block: material.name for block, material in catalogue_entries.items() if material is not None}
    for block, material_name in (named_materials | dict(materials or {})).items():
        number = _apply_material(numbers, block, material_name)
        numbers[number.name] = number
    numbers |= _build_film_numbers(scene) if reads_film_states(scene) else {}
    for name, entry in (given or {}).items():
        if name not in numbers:
            raise InputError("tolerance", name, describe_choices(name, numbers))
        numbers[name] = replace(numbers[name], sd=_read_sd(numbers[name], entry), source="given")
    return tuple(numbers.values())


def _build_film_numbers(scene: Scene) -> dict[str, UncertainNumber]:
    """Return the uncertain numbers of films and bonds by name, and the temperature of tapes where there are some."""
    numbers = {
        name: UncertainNumber(name, deviation.kind, value, deviation.compute_sd(value), deviation.source)
        for name, (value, deviation) in list_film_deviations(scene).items()
    }
    if not list_tape_moduli(scene):
        return numbers
    source = (
        f"assumed: {TEMPERATURE_SD_K:g} K; a tape's modulus falls by {format_percent(TAPE_COEFFICIENT_PER_K, 6)} per K (assumed)"
    )
    return numbers | {TEMPERATURE_NAME: UncertainNumber(TEMPERATURE_NAME, "temperature", 0.0, TEMPERATURE_SD_K, source)}


def _list_block_values(scene: Scene) -> dict[str, float]:
    """Return the numbers of the blocks by name, SI, without those of the base, which hardly matter, and of films and bonds."""
    others = ("probe.film.", "probe.base.", "probe.area_ratio")
    return {
        name: value for name, value in list_values(scene).items() if name.startswith("probe.") and not name.startswith(others)
    }


def _build_number(scene: Scene, name: str, value: float, workshop: Workshop, origin: str) -> UncertainNumber:
    """Build the uncertain number ``name`` with the standard deviation of the bench's ``[workshop]``.

    ``value`` is the drawn one, SI; ``origin`` names the bench in the source.
    """
    kinds: dict[str, Kind] = {"youngs_modulus": "modulus", "poisson_ratio": "poisson_ratio"}
    kind = kinds.get(name.rpartition(".")[2], "length")
    if kind == "length" and workshop.length is None:
        return UncertainNumber(name, kind, value, find_length_sd(scene.probe, name), f"{origin}: tightest of the block's process")
    sds = {"modulus": workshop.modulus * value, "poisson_ratio": workshop.poisson_ratio, "length": workshop.length or 0.0}
    return UncertainNumber(name, kind, value, sds[kind], f"{origin}, [workshop] {kind}")


def _apply_process(scene: Scene, number: UncertainNumber) -> UncertainNumber:
    """Return a length with the usual tolerance of its block's process."""
    tolerance = find_length_tolerance(scene.probe, number.name)
    deviation = f"\N{PLUS-MINUS SIGN}{format_deviation(tolerance.usual.deviation)} mm of the {tolerance.measured_as}"
    sd = tolerance.convert_to_sd(tolerance.usual.deviation)
    return replace(number, sd=sd, source=f"{tolerance.process}, {tolerance.usual.source}: {deviation}")


def _apply_material(numbers: Mapping[str, UncertainNumber], block: str, material_name: str) -> UncertainNumber:
    """Return a block's modulus with the standard deviation of a material in the catalogue."""
    number = numbers.get(f"probe.{block}.youngs_modulus")
    if number is None:
        raise InputError("material", f"{block}={material_name}", "inner=NAME or outer=NAME, of a block")
    material = find_material(material_name)
    if material.kind == "film" or not material.admits(number.value):
        modulus = f"{material.name} has {material.youngs_modulus:.4g} Pa"
        allowed = f"a material of about {number.value:.4g} Pa, as the block; {modulus}"
        raise InputError("material", f"{block}={material_name}", allowed)
    return replace(number, sd=material.log_sd * number.value, source=f"{material.name}: {material.tolerance}")


def _read_sd(number: UncertainNumber, entry: object) -> float:
    """Return a given standard deviation in SI units, checked; ``entry`` is relative for moduli and gains."""
    key = f"tolerance.{number.name}"
    if number.kind == "temperature":
        return TEMPERATURE_QUANTITY.read(key, entry, units_required=isinstance(entry, str)) if entry not in (0, "0") else 0.0
    if number.kind == "length":
        sd = LENGTH_QUANTITY.read(key, entry, units_required=isinstance(entry, str)) if entry not in (0, "0") else 0.0
        if sd > MAX_LOG_SD * number.value:
            raise InputError(key, entry, f"a length up to {MAX_LOG_SD:g} times the drawn one, {number.value:.4g} m")
        return sd
    allowed, max_sd = (ALLOWED_POISSON_SD, 0.1) if number.kind == "poisson_ratio" else (ALLOWED_RELATIVE_SD, MAX_LOG_SD)
    sd = read_fraction(key, entry, allowed)
    if not 0 <= sd <= max_sd:
        raise InputError(key, entry, allowed)
    return sd if number.kind == "poisson_ratio" else sd * abs(number.value)
