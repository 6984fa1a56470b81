"""Text from the command line as numbers; heavy imports wait until they are needed.

Each function raises ``InputError``, one line, for what is none.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from probe_design.data.noise import ALLOWED, NOISE, checked_noise

if TYPE_CHECKING:
    from geometry.common.resources import Limits

linear_option = click.option(
    "--linear", is_flag=True, help="Answer loads beyond linear elasticity too, what is known of the effect counted in the error."
)
"""Of the verbs that refuse such loads without it."""
any_probe_option = click.option("--any-probe", is_flag=True, help="Take readings and calibrations of other serial numbers, too.")
"""Of the verbs that read the built probe."""
loads_option = click.option(
    "--loads", is_flag=True, help="Tell by level contact at which load the gap closes and linear theory ends; some seconds more."
)


force_option = click.option("--force", is_flag=True, help="Replace parts of another design that the folder holds.")
"""Of the verbs that write parts."""


def _frequency(ctx: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    from geometry.scenes.units import FREQUENCY

    return None if text is None else FREQUENCY.read("frequency", text)


frequency_option = click.option(
    "--frequency", callback=_frequency, help='Of a sinusoidal load, "5 Hz": tell the phase of the ratio by the loss factors.'
)
"""Of evaluate; Hz, or None."""
F = TypeVar("F", bound=Callable[..., Any])


class NamedCommands(click.Group):
    """Commands; one that does not exist is refused with those that do."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Look a command up."""
        if args[0] in self.commands:
            return super().resolve_command(ctx, args)
        kind = "verb" if ctx.parent is None else ctx.info_name
        from geometry.common.errors import one_of

        raise click.UsageError(f"{kind} = {args[0]!r}: allowed: {one_of(args[0], self.commands)}")


class FileName(click.Path):
    """The name of a file or folder, which is text: libraries, records and pages can hold no other."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; an empty name is none, not the folder that the program runs in."""
        from geometry.common.errors import InputError

        key = "path" if param is None else max(param.opts, key=len).lstrip("-")
        try:
            value.encode()
        except UnicodeEncodeError:  # what Python makes of bytes that are no UTF-8
            raise InputError(key, value, "the name of a file or folder, in UTF-8") from None
        if not value:
            raise InputError(key, value, "the name of a file or folder")
        return super().convert(value, param, ctx)


def completed(*words: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return what a shell asks for the words that an option may have; the option itself refuses others with more to say."""
    return lambda ctx, parameter, begun: [word for word in words if word.startswith(begun)]


FILE_NAME = FileName(path_type=Path)


def noise_option(command: F) -> F:
    """Add the option --noise, which means the same to every verb that has it; a text, or None for the default."""
    text = f"Relative standard deviation of one reading of the ratio.  [default: {NOISE:g}]"
    return click.option("--noise", help=text)(command)


def noise_of(text: str | None) -> float:
    """Read the noise of a ratio; the default where there is none."""
    return NOISE if text is None else checked_noise(fraction("noise", text, ALLOWED))


def limiting(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb the options ``--memory`` and ``--time``: what every answer that it asks for may take."""
    for name, default in (("time", "120 s"), ("memory", "2 GB")):
        text = f"{name.capitalize()} that an answer may take.  [default: {default}]"
        verb = click.option(f"--{name}", callback=_limited, expose_value=False, help=text)(verb)
    return verb


def _limited(ctx: click.Context, parameter: click.Parameter, text: str | None) -> None:
    """Set one limit for the verb."""
    from geometry.common.resources import limited, limits

    if text is not None:
        ctx.with_resource(limited(with_limits(limits(), **{str(parameter.name): text})))


def with_limits(held: Limits, *, time: str | None = None, memory: str | None = None) -> Limits:
    """Return limits with others in place of those that are given, such as ``"60 s"`` and ``"4 GB"``."""
    from dataclasses import replace

    from geometry.scenes.units import MEMORY, TIME

    if time is not None:
        held = replace(held, seconds=TIME.read("time", time))
    return held if memory is None else replace(held, memory=MEMORY.read("memory", memory))


def number(key: str, text: str, allowed: str) -> float:
    """Read a number; whether it is in range is for those to say who use it."""
    from geometry.scenes import units

    return units.number(key, text, allowed)


def fraction(key: str, text: str, allowed: str = "a number above 0 and below 1, such as 0.01 or 1 %") -> float:
    """Read a fraction such as ``"0.01"`` or ``"1 %"``; whether it is in range is for those to say who use it."""
    from geometry.scenes import units

    return units.fraction(key, text, allowed)


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
    from geometry.scenes.units import MODULUS

    return MODULUS.read(key, text)
