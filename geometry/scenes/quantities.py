"""Annotated types of the numbers in a scene: their units, their ranges, and the frozen models that hold them."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from geometry.common.errors import InputError
from geometry.scenes.units import MODULUS_QUANTITY, Quantity

LENGTH_QUANTITY = Quantity("length", "m", "mm", 1e-9, 10.0, bare=1.0)
Length = Annotated[float, LENGTH_QUANTITY]
PartLength = Annotated[float, replace(LENGTH_QUANTITY, bare=0.2)]
THICKNESS_QUANTITY = replace(LENGTH_QUANTITY, low=0.0, bare=0.2)
Thickness = Annotated[float, THICKNESS_QUANTITY]
POSITION_QUANTITY = Quantity("position", "m", "mm", -10.0, 10.0, bare=1.0)
Position = Annotated[float, POSITION_QUANTITY]
Modulus = Annotated[float, MODULUS_QUANTITY]
CHARGE_QUANTITY = Quantity("charge per force", "C/N", "pC/N", -1e-8, 1e-8)
ChargePerForce = Annotated[float, CHARGE_QUANTITY]
POISSON_RATIO_TEXT, NUMBER_TEXT = "a number from 0 to below 0.5", "a number from -100 to 100"
PoissonRatio = Annotated[float, Field(ge=0.0, lt=0.5, description=POISSON_RATIO_TEXT)]
LossFactor = Annotated[float, Field(ge=0.0, le=1.0, description="tan delta, a number from 0 to 1")]
Number = Annotated[float, Field(ge=-100.0, le=100.0, description=NUMBER_TEXT)]
MaterialName = Annotated[str, Field(min_length=1, max_length=100)]


class Frozen(BaseModel):
    """A frozen model: unknown keys, NaN, infinity and silent conversions are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse to change a field, with what to do instead."""
        if name in type(self).model_fields:
            raise InputError(name, value, "no change in place; scene.replace({'probe.gap': '0.2 mm'}) returns a changed scene")
        super().__setattr__(name, value)


def build_quiet_field(default: object) -> Any:
    """Return a field that is not written to files where it has its default."""
    return Field(default=default, exclude_if=lambda value: value == default)


def build_optional_field(description: str | None = None) -> Any:
    """Return a field that may be left out, and then is not written to files; the description says what is allowed."""
    return Field(default=None, description=description, exclude_if=lambda value: value is None)
