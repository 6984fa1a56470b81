"""Convert between quantity strings with units, such as ``"5 mm"``, in files and SI floats inside the program."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from numbers import Real
from typing import TYPE_CHECKING, SupportsFloat, SupportsIndex

from pydantic import BeforeValidator, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from geometry.common.errors import InputError, Words

if TYPE_CHECKING:
    import pint
    from pint.facets.plain import PlainUnit
    from pydantic import GetCoreSchemaHandler

MM_PER_M = 1e3  # millimetres in a metre
PA_PER_KPA = 1e3
MODULUS_DIGITS = 4  # of a modulus: enough for values known to some per cent at best
_NUMBER_AND_UNIT = re.compile(r"\s*([+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|nan))\s*(.*?)\s*", re.S)
_UNIT_NAME_PATTERN = r"[A-Za-zµμ°]+(?:\s*(?:\*\*|\^)\s*-?[1-9])?"
# pint evaluates its argument, so only names joined by *, / and blanks with one-digit powers reach it; every blank has one
# place in the pattern, so that refusing takes linear time
_UNIT_PATTERN = re.compile(rf"{_UNIT_NAME_PATTERN}(?:(?:\s*[*/]\s*|\s+){_UNIT_NAME_PATTERN})*")
# what pint says of the units that scenes are written in, so that reading one does not wait for pint, which takes longer to
# import than all else together; a test asks pint
UNIT_FACTORS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "N": {"N": 1.0, "mN": 1e-3},
    "N/m": {"N/m": 1.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180},
    "C": {"C": 1.0, "nC": 1e-9, "pC": 1e-12},
    "C/N": {"C/N": 1.0, "pC/N": 1e-12},
    "V/N": {"V/N": 1.0, "mV/N": 1e-3},
    "F": {"F": 1.0, "nF": 1e-9, "pF": 1e-12},
    "ohm": {"ohm": 1.0, "Mohm": 1e6, "Gohm": 1e9},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "K": {"K": 1.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "byte": {"GB": 1e9, "MB": 1e6},
}


@dataclass(frozen=True)
class Quantity:
    """A physical quantity as a pydantic annotation: text with a unit in files, an SI float in Python.

    Parameters
    ----------
    name
        What it is, for messages ("length").
    si
        Its SI unit, as pint reads it.
    unit
        The unit in which it is written and shown.
    low, high
        The bounds, SI.
    bare
        The size, SI, above which a number that Python code gives without a unit has surely lost one.
    """

    name: str
    si: str
    unit: str
    low: float
    high: float
    bare: float = math.inf

    @property
    def allowed(self) -> str:
        """The range in words, in the unit in which it is shown."""
        low, high = (self._format_rounded(bound, 6) for bound in (self.low, self.high))
        article = "an" if self.name[0] in "aeiou" else "a"
        return f"{article} {self.name} with its unit, such as '5 {self.unit}', from {low} to {high}"

    def parse(self, text: str) -> float:
        """Return the SI value of ``text``; raise ``ValueError`` with the reason if it is not allowed."""
        match = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= 80 else None
        if match is None:
            raise ValueError("not a number with a unit")
        number, unit = match.groups()
        if not unit:
            raise ValueError("the unit is missing")
        return self.check(_multiply(number, _find_factor(unit, self.si)))

    def check(self, value: float) -> float:
        """Return ``value`` if it lies within the bounds; raise ``ValueError`` otherwise."""
        if not math.isfinite(value):
            raise ValueError("not a finite number")
        inside = min(max(value, self.low), self.high)
        if not math.isclose(value, inside, rel_tol=1e-12):  # so that a bound passes through a change of unit
            raise ValueError("out of range")
        return inside

    def convert(self, entry: object, units_required: bool) -> float:
        """Return the SI value of a text or, unless units are required, of a number; raise ``ValueError`` with the reason."""
        if isinstance(entry, str):
            return self.parse(entry)
        number = find_number(entry)
        if number is None:
            raise ValueError("not a quantity")
        if units_required:
            raise ValueError("the unit is missing")
        return self.check(number)

    def check_bare(self, entry: object) -> None:
        """Raise ``ValueError`` for a number of Python code so large that it must be meant in ``unit``, not in SI."""
        number = find_number(entry)
        if number is not None and self.bare < abs(number) < math.inf:
            meant = _multiply(repr(number), _find_factor(self.unit, self.si))
            raise ValueError(f"{number:g} {self.si}? did you mean {meant:g} or '{number:g} {self.unit}'")

    def read(self, key: str, entry: object, units_required: bool = True) -> float:
        """Return the SI value that is given for a key.

        Raises
        ------
        InputError
            It is no such quantity, or out of range.
        """
        try:
            return self.convert(entry, units_required)
        except (ValueError, OverflowError) as fault:
            raise InputError(key, entry, f"{self.allowed} ({fault})") from None

    def format_value(self, value: float) -> str:
        """Write an SI value so that reading it gives the same float again."""
        short = self._format_rounded(value, 12)
        return short if self.parse(short) == value else f"{value!r} {self.si}"

    def _format_rounded(self, value: float, digits: int) -> str:
        """Write an SI value in the unit in which it is shown."""
        if self.si == "Pa":
            return format_modulus(value, digits)
        return f"{convert_to_unit(value, self.si, self.unit):.{digits}g} {self.unit}"

    def _validate(self, value: object, info: ValidationInfo) -> float:
        """Return the SI value for pydantic; its context says whether units are required, and is None in Python code."""
        try:
            if info.context is None:
                self.check_bare(value)
            return self.convert(value, bool(info.context and info.context.get("units_required")))
        except (ValueError, OverflowError) as fault:
            raise PydanticCustomError(
                "quantity", "{allowed} ({reason})", {"allowed": self.allowed, "reason": str(fault)}
            ) from None

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Tell pydantic how to read and, as JSON, write the quantity."""
        write = core_schema.plain_serializer_function_ser_schema(self.format_value, when_used="json-unless-none")
        return core_schema.with_info_plain_validator_function(self._validate, serialization=write)


MODULUS_QUANTITY = Quantity("modulus", "Pa", "kPa", 1e-3, 1e13)
"""Young's modulus."""
SI_CONTEXT = {"units_required": False}
"""Context of pydantic for numbers that are known to be in SI units, as those of a scene that was read already."""
FREQUENCY_QUANTITY = Quantity("frequency", "Hz", "Hz", 1e-3, 1e5)
"""Frequency of a sinusoidal load."""
TIME_QUANTITY = Quantity("time", "s", "s", 1e-3, 1e7)
"""Limit of the time of one evaluation."""
MEMORY_QUANTITY = Quantity("memory", "byte", "GB", 1e8, 1e15)
"""Limit of the memory of one evaluation."""


def find_number(entry: object) -> float | None:
    """Return a real number, of Python or of numpy, as a float, infinite where it is too large; None for anything else."""
    if isinstance(entry, bool) or not isinstance(entry, Real):
        return None
    try:
        return float(entry)
    except OverflowError:
        return math.inf


def read_number(key: str, entry: object, allowed: str) -> float:
    """Return a number, also from a text; its range is checked by the caller.

    Raises
    ------
    InputError
        The entry is no number; ``allowed`` states in the message what is accepted.
    """
    if entry is None:
        raise InputError(key, Words("missing"), allowed)
    try:
        if isinstance(entry, str | SupportsFloat | SupportsIndex) and not isinstance(entry, bool):
            return float(entry)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(key, entry, allowed)


def read_fraction(key: str, entry: object, allowed: str) -> float:
    """Return a fraction from a number or a text such as ``"0.02"`` or ``"2 %"``; its range is checked by the caller.

    Raises
    ------
    InputError
        The entry is no fraction; ``allowed`` states in the message what is accepted.
    """
    text = entry.strip() if isinstance(entry, str) else entry
    if not isinstance(text, str) or not text.endswith("%"):
        return read_number(key, entry, allowed)
    with suppress(InputError, InvalidOperation):  # in decimals: "7 %" is the float 0.07, no neighbour of it
        read_number(key, text[:-1], allowed)
        return float(Decimal(text[:-1].strip()) / 100)
    raise InputError(key, entry, allowed)


def _from_percent(entry: object) -> object:
    """Convert "2 %" to 0.02; any other value is passed on to pydantic, which reports what the field allows."""
    if isinstance(entry, str) and entry.rstrip().endswith("%"):
        with suppress(InputError):
            return read_fraction("", entry, "a percentage")
    return entry


PERCENTAGE = BeforeValidator(_from_percent)  # of a field that is a fraction


def convert_to_unit(value: float, si: str, unit: str) -> float:
    """Convert an SI value to the unit in which it is shown."""
    return value / _find_factor(unit, si)


def format_modulus(value: float, digits: int = MODULUS_DIGITS) -> str:
    """Write a modulus or a pressure, Pa, in the largest of its units in which it is 1 or more."""
    size, unit = next(
        ((size, unit) for size, unit in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")) if abs(value) >= size), (1.0, "Pa")
    )
    return f"{value / size:.{digits}g} {unit}"


def _multiply(number: str, factor: float) -> float:
    """Return a number times a unit's factor, computed in decimals where the factor is 1/1000 or the like.

    So "3.53 mm" is exactly the float 0.00353; a product of floats may be a neighbour of it. A text that is 0 or infinite as a
    float is multiplied as a float, as its exponent may be too large for decimals.
    """
    divisor = round(1 / factor) if 1e-15 < factor < 1 else 1
    value = float(number)
    if divisor == 1 or value == 0.0 or not math.isfinite(value) or not math.isclose(divisor * factor, 1.0, rel_tol=1e-15):
        return value * factor
    return float(Decimal(number) / divisor)


def parse_measured(text: str) -> tuple[float, PlainUnit]:
    """Return the value in SI base units of a text such as ``'2 kPa/mm'``, and these; raises ``ValueError``."""
    match = _NUMBER_AND_UNIT.fullmatch(text) if len(text) <= 80 else None
    if match is None or not match[2]:
        raise ValueError("not a number with a unit")
    unit = find_base_unit(match[2])
    value = _multiply(match[1], _find_factor(match[2], str(unit)))
    if not math.isfinite(value):
        raise ValueError("not a finite number")
    return value, unit


@lru_cache(maxsize=256)
def find_base_unit(unit: str) -> PlainUnit:
    """Return pint's SI base units of a unit such as ``'Pa'``, for '' those of a pure number; raise ``ValueError`` for no unit."""
    import pint

    if unit and not _UNIT_PATTERN.fullmatch(unit):
        raise ValueError(f"{unit!r} is no unit")
    try:
        return _load_registry().Quantity(1.0, unit).to_base_units().units
    except (pint.PintError, ArithmeticError, AssertionError, AttributeError, TypeError, ValueError):
        raise ValueError(f"{unit!r} is no unit") from None


def _find_factor(unit: str, si: str) -> float:
    """Return the value of a unit in an SI unit; raise ``ValueError`` if it cannot be converted."""
    usual = UNIT_FACTORS.get(si, {}).get(unit)
    return find_factor_by_pint(unit, si) if usual is None else usual


@lru_cache(maxsize=256)
def find_factor_by_pint(unit: str, si: str) -> float:
    """Return the value of a unit in an SI unit; raise ``ValueError`` if it is no unit, or of another kind."""
    import pint

    if not _UNIT_PATTERN.fullmatch(unit):
        raise ValueError(f"{unit!r} is no unit")
    try:
        nothing, unit_in_base, si_in_base = (
            _load_registry().Quantity(value, name).to_root_units() for value, name in ((0.0, unit), (1.0, unit), (1.0, si))
        )
        # by units, not by dimensions, for which an angle, a count and a solid angle are all the same; and no factor turns
        # units into others whose zero is elsewhere: 0 degC is 273.15 K, 0 dB is 1
        if unit_in_base.units == si_in_base.units and nothing.magnitude == 0.0:
            return float(unit_in_base.magnitude / si_in_base.magnitude)
    except (pint.PintError, ArithmeticError, AssertionError, AttributeError, TypeError, ValueError):
        pass
    raise ValueError(f"{unit!r} is no unit that converts to {si}")


@lru_cache(maxsize=1)
def _load_registry() -> pint.UnitRegistry[float]:
    """Return pint's registry of units, made once."""
    import pint

    return pint.UnitRegistry()
