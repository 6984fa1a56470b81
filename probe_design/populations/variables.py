"""Define the numbers of the probe and its load that a design file allows to vary, and their bounds, steps or choices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from geometry.scenes.probe import LENGTH_QUANTITY, Frozen
from geometry.scenes.units import MODULUS_QUANTITY, Quantity
from probe_design.populations.ranges import FileEntry

MAX_CHOICES = 1000
FIXED_ENTRY: Literal["fixed"] = "fixed"
FORCE_QUANTITY = Quantity("force", "N", "mN", 1e-9, 1e9)
NUMBER_QUANTITY = Quantity("number", "dimensionless", "", 1e-4, 1e4)


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
        if not isinstance(entries, list | tuple) or not min_count <= len(entries) <= max_count:
            raise ValueError("not a list of two" if max_count == 2 else "not a list of values")
        required = units_required and self.quantity is not NUMBER_QUANTITY
        if self.quantity is NUMBER_QUANTITY and any(isinstance(entry, str) for entry in entries):
            raise ValueError("a text, not a number")
        return tuple(self.quantity.convert(entry, required) for entry in entries)


VariedLength = Annotated[DesignVariable, Varied(LENGTH_QUANTITY)]
VariedModulus = Annotated[DesignVariable, Varied(MODULUS_QUANTITY)]
VariedForce = Annotated[DesignVariable, Varied(FORCE_QUANTITY)]
VariedNumber = Annotated[DesignVariable, Varied(NUMBER_QUANTITY)]
Materials = Annotated[tuple[str, ...], Field(strict=False, max_length=100)]


class DesignVariables(Frozen):
    """What the search may change of the probe and its load; what is left out varies within what a workshop can make."""

    inner_radius: VariedLength = Field(
        default=DesignVariable(), description="of the inner block", examples=[{"bounds": ["1 mm", "6 mm"], "step": "0.1 mm"}]
    )
    area_ratio: VariedNumber = Field(
        default=DesignVariable(), description="A2/A1, inner over outer end area", examples=[[0.1, 4.0]]
    )
    gap: VariedLength = Field(
        default=DesignVariable(), description="between the blocks", examples=[{"choices": ["0.1 mm", "0.2 mm", "0.3 mm"]}]
    )
    height: VariedLength = Field(default=DesignVariable(), description="of both blocks", examples=[["2 mm", "10 mm"]])
    inner_height: VariedLength = Field(
        default=DesignVariable(),
        description="of the inner block, in place of height: with it or outer_height each block has its own, and the base a step",
        examples=[["2 mm", "10 mm"]],
    )
    outer_height: VariedLength = Field(
        default=DesignVariable(), description="of the outer block, likewise", examples=[["2 mm", "10 mm"]]
    )
    inner_modulus: VariedModulus = Field(default=DesignVariable(), description="of the inner block", examples=["fixed"])
    outer_modulus: VariedModulus = Field(default=DesignVariable(), description="of the outer block", examples=["fixed"])
    force: VariedForce = Field(
        default=DesignVariable(),
        description="on the probe, in place of the scene's: each design has the largest that its limits allow",
        examples=[{"choices": ["5 mN", "10 mN", "20 mN"]}],
    )
    materials: Materials = Field(
        default=(),
        description="names of `probe-design material list`: each block is of one of these, modulus and Poisson's ratio together",
        examples=[["dragon-skin-30", "ecoflex-00-30"]],
    )

    @property
    def given_heights(self) -> tuple[str, ...]:
        """Which of inner_height and outer_height are given."""
        return tuple(key for key in ("inner_height", "outer_height") if getattr(self, key) != DesignVariable())
