"""Text from the command line as numbers; heavy imports wait until they are needed.

Each function raises ``InputError``, one line, for what is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def limiting(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb the options ``--memory`` and ``--time``: what every answer that it asks for may take."""
    for name, default in (("time", "120 s"), ("memory", "2 GB")):
        text = f"{name.capitalize()} that an answer may take.  [default: {default}]"
        verb = click.option(f"--{name}", callback=_limited, expose_value=False, help=text)(verb)
    return verb


def _limited(ctx: click.Context, parameter: click.Parameter, text: str | None) -> None:
    """Set one limit for the verb."""
    if text is None:
        return
    from dataclasses import replace

    from geometry.common.limits import limited, limits
    from geometry.scenes.units import Quantity

    if parameter.name == "memory":
        chosen = replace(limits(), memory=Quantity("memory", "byte", "GB", 1e8, 1e15).read("memory", text))
    else:
        chosen = replace(limits(), seconds=Quantity("time", "s", "s", 1.0, 1e7).read("time", text))
    ctx.with_resource(limited(chosen))


def number(key: str, text: str, allowed: str = "a number above 0 and below 1, such as 0.01") -> float:
    """Read a number; whether it is in range is for those to say who use it."""
    from geometry.scenes import units

    return units.number(key, text, allowed)


def length(key: str, text: str) -> float:
    """Read a length such as ``"5 mm"``, in m."""
    from geometry.scenes.probe import LENGTH

    return LENGTH.read(key, text)


def position(key: str, text: str) -> float:
    """Read a position such as ``"-20 mm"``, in m."""
    from typing import get_args

    from geometry.scenes.probe import Position

    return float(get_args(Position)[1].read(key, text))


def modulus(key: str, text: str) -> float:
    """Read a modulus such as ``"1 kPa"``, in Pa."""
    from geometry.scenes.probe import MODULUS

    return MODULUS.read(key, text)
