"""Read the entries of a design file: how a quantity is distributed in a population, and how a number of the probe may vary."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import GetCoreSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from geometry.common.arrays import Floats
from geometry.scenes.units import Quantity

MAX_VALUES = 1000
MAX_CHOICES = 1000
FIXED_ENTRY: Literal["fixed"] = "fixed"
NUMBER_QUANTITY = Quantity("number", "dimensionless", "", 1e-4, 1e4)


@dataclass(frozen=True)
class Range:
    """The values that a quantity takes in a population.

    Attributes
    ----------
    values
        Equally likely values of a list, or both ends of a range.
    continuous
        Whether it is a range.
    log
        Whether the logarithm is uniformly distributed, and has the standard deviation; otherwise the value itself.
    """

    values: tuple[float, ...]
    continuous: bool = False
    log: bool = True

    @property
    def is_single(self) -> bool:
        """Whether there is a single value."""
        return min(self.values) == max(self.values)

    @property
    def deviation(self) -> float:
        """Standard deviation of the values, or of their logarithms if ``log``."""
        scaled = np.log(self.values) if self.log else np.array(self.values)
        return float(np.ptp(scaled) / math.sqrt(12)) if self.continuous else float(np.std(scaled))

    @property
    def middle(self) -> float:
        """Mean; geometric if ``log``."""
        return float(np.exp(np.mean(np.log(self.values)))) if self.log else float(np.mean(self.values))

    def compute_quantiles(self, fractions: Floats) -> Floats:
        """Return the values below which given fractions (0 to 1) of the population lie; any shape."""
        if not self.continuous:
            # the minimum is for a fraction of exactly 1
            return np.asarray(np.array(self.values)[np.minimum((fractions * len(self.values)).astype(int), len(self.values) - 1)])
        low, high = self.values
        return np.asarray(low * (high / low) ** fractions if self.log else low + (high - low) * fractions, dtype=float)


Entry = TypeVar("Entry")


class FileEntry(ABC, Generic[Entry]):
    """A type of entry of a design file, as a pydantic annotation: how it is read, written, and described in a refusal."""

    @property
    @abstractmethod
    def allowed(self) -> str:
        """Description of the allowed entries, for messages."""

    @abstractmethod
    def read(self, entry: object, units_required: bool) -> Entry:
        """Return the value that an entry states; raise ``ValueError`` with the reason if it states none."""

    @abstractmethod
    def encode(self, value: Entry) -> Any:
        """Return a value as an entry of a design file, which ``read`` reads back: a text with a unit, a number, or a list."""

    def _validate(self, entry: object, info: ValidationInfo) -> Entry:
        """Return the value of an entry, or raise the error that pydantic reports."""
        try:
            return self.read(entry, bool(info.context and info.context.get("units_required")))
        except (ValueError, OverflowError) as fault:
            raise PydanticCustomError(
                "quantity", "{allowed} ({reason})", {"allowed": self.allowed, "reason": str(fault)}
            ) from None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the pydantic schema that reads an entry and writes it as JSON."""
        write = core_schema.plain_serializer_function_ser_schema(self.encode, when_used="json-unless-none")
        return core_schema.with_info_plain_validator_function(self._validate, serialization=write)


@dataclass(frozen=True)
class Ranged(FileEntry[Range]):
    """A ``Range`` as a pydantic annotation.

    One text is one value. A list of two is a range from one to the other. A list of another length, or ``{values = [...]}`` of
    any length, is a list of values.

    Parameters
    ----------
    quantity
        Quantity of each value.
    log
        See ``Range``.
    """

    quantity: Quantity
    log: bool = True

    @property
    def allowed(self) -> str:
        """Description of the allowed entries, for messages."""
        return (
            f"{self.quantity.allowed}; a range of two, the lower first; a list of three or more, or {{ values = [...] }}, "
            f"of at most {MAX_VALUES}"
        )

    def read(self, entry: object, units_required: bool) -> Range:
        """Return the range that an entry states; raise ``ValueError`` with the reason if it states none."""
        if isinstance(entry, Range):
            return entry
        listed = isinstance(entry, Mapping)
        if isinstance(entry, Mapping):
            if set(entry) != {"values"}:
                raise ValueError("a table with other keys than values")
            entry = entry["values"]
        elif not isinstance(entry, list | tuple):
            entry = [entry]
        if not isinstance(entry, list | tuple) or not 1 <= len(entry) <= MAX_VALUES:
            raise ValueError("not a list of values")
        values = tuple(self.quantity.convert(text, units_required) for text in entry)
        continuous = len(values) == 2 and not listed
        if continuous and values[0] > values[1]:
            raise ValueError("the higher end comes first")
        return Range(values, continuous and values[0] < values[1], self.log)

    def encode(self, value: Range) -> Any:
        """Return a value as an entry of a design file, which ``read`` reads back: a text with a unit, a number, or a list."""
        texts = [self.quantity.format_value(number) for number in value.values]
        return {"values": texts} if len(texts) == 2 and not value.continuous else texts


@dataclass(frozen=True)
class DesignVariable:
    """The allowed variation of one number of the probe or its load, SI.

    Attributes
    ----------
    low, high
        Bounds; None if they follow from the start and the workshop.
    step
        Values are multiples of it; None: multiples of the search's step.
    choices
        The only values, increasing; empty if there are bounds.
    fixed
        Whether the scene's value stays.
    """

    low: float | None = None
    high: float | None = None
    step: float | None = None
    choices: tuple[float, ...] = ()
    fixed: bool = False


@dataclass(frozen=True)
class Varied(FileEntry[DesignVariable]):
    """A ``DesignVariable`` as a pydantic annotation: ``"fixed"``, ``[low, high]``, or a table of bounds, step and choices.

    Parameters
    ----------
    quantity
        Quantity of the values; ``NUMBER_QUANTITY`` has no unit.
    """

    quantity: Quantity

    @property
    def allowed(self) -> str:
        """Description of the allowed entries, for messages."""
        number_text = "a number from 0.0001 to 10000" if self.quantity is NUMBER_QUANTITY else self.quantity.allowed
        return f"'fixed', [low, high], or a table of bounds = [low, high] and step, or of choices; each {number_text}"

    def read(self, entry: object, units_required: bool) -> DesignVariable:
        """Return the variable that an entry states; raise ``ValueError`` with the reason if it states none."""
        if isinstance(entry, DesignVariable):
            return entry
        if entry == FIXED_ENTRY:
            return DesignVariable(fixed=True)
        table = entry if isinstance(entry, Mapping) else {"bounds": entry}
        unknown = set(table) - {"bounds", "step", "choices"}
        if unknown:
            raise ValueError(f"no key {min(unknown, key=str)}")
        if "choices" in table:
            if len(table) > 1:
                raise ValueError("choices beside bounds or step")
            return DesignVariable(choices=tuple(sorted(set(self._read_values(table["choices"], 1, MAX_CHOICES, units_required)))))
        low, high = self._read_values(table["bounds"], 2, 2, units_required) if "bounds" in table else (None, None)
        if low is not None and high is not None and not low < high:
            raise ValueError("the lower bound is not below the higher")
        step = self._read_values([table["step"]], 1, 1, units_required)[0] if "step" in table else None
        return DesignVariable(low, high, step)

    def encode(self, value: DesignVariable) -> Any:
        """Return the entry of a file that states the value."""

        def format_number(number: float) -> Any:
            """Return a number itself if it has no unit, else as text with its unit."""
            return number if self.quantity is NUMBER_QUANTITY else self.quantity.format_value(number)

        if value.fixed:
            return FIXED_ENTRY
        if value.choices:
            return {"choices": [format_number(number) for number in value.choices]}
        bounds = (
            {} if value.low is None or value.high is None else {"bounds": [format_number(value.low), format_number(value.high)]}
        )
        return bounds | ({} if value.step is None else {"step": format_number(value.step)})

    def _read_values(self, entries: object, min_count: int, max_count: int, units_required: bool) -> tuple[float, ...]:
        """Return the numbers, SI, of a list of ``min_count`` to ``max_count`` entries; raise ``ValueError`` if it is none."""
        if not isinstance(entries, list | tuple) or not min_count <= len(entries) <= max_count:
            raise ValueError("not a list of two" if max_count == 2 else "not a list of values")
        # numbers without a unit, such as an area ratio, never need one
        required = units_required and self.quantity is not NUMBER_QUANTITY
        if self.quantity is NUMBER_QUANTITY and any(isinstance(entry, str) for entry in entries):
            raise ValueError("a text, not a number")
        return tuple(self.quantity.convert(entry, required) for entry in entries)
