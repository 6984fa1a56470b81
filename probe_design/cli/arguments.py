"""Options and arguments of the commands, and their conversion to numbers. Heavy imports are delayed until they are needed.

Each function raises ``InputError`` for a text that is not allowed.
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
    "--linear", is_flag=True, help="Use linear elasticity at any load; error_estimate counts the known effect of finite strain."
)
"""For commands that otherwise refuse loads beyond linear elasticity."""
any_probe_option = click.option("--any-probe", is_flag=True, help="Take readings and calibrations of other serial numbers, too.")
"""For commands that read a built probe."""
loads_option = click.option(
    "--loads",
    is_flag=True,
    help="Compute by contact the loads at which the gap closes and linear theory ends; takes seconds.",
)


force_option = click.option("--force", is_flag=True, help="Replace parts of another design in the folder.")
"""For commands that write parts."""


def _frequency(ctx: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    from geometry.scenes.units import FREQUENCY

    return None if text is None else FREQUENCY.read("frequency", text)


frequency_option = click.option(
    "--frequency",
    callback=_frequency,
    help='Frequency of the load, "5 Hz": compute the phase of the ratio by loss factors.',
)
"""For evaluate: a frequency in Hz, or None."""
F = TypeVar("F", bound=Callable[..., Any])


class NamedCommands(click.Group):
    """A group of commands. An unknown command is refused with the list of known ones."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find a command by its name, or raise a usage error that lists the known commands."""
        if args[0] in self.commands:
            return super().resolve_command(ctx, args)
        kind = "command" if ctx.parent is None else ctx.info_name
        from geometry.common.errors import one_of

        raise click.UsageError(f"{kind} = {args[0]!r}: allowed: {one_of(args[0], self.commands)}")


class FileName(click.Path):
    """The name of a file or folder in UTF-8, as libraries, records and pages cannot store any other."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path. An empty name is refused, as it would otherwise mean the current folder."""
        from geometry.common.errors import InputError

        key = "path" if param is None else max(param.opts, key=len).lstrip("-")
        try:
            value.encode()
        except UnicodeEncodeError:  # bytes that are not UTF-8, as Python represents them
            raise InputError(key, value, "the name of a file or folder, in UTF-8") from None
        if not value:
            raise InputError(key, value, "the name of a file or folder")
        return super().convert(value, param, ctx)


def completed(*words: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return the shell completion of an option with given words; the option itself refuses other words."""
    return lambda ctx, parameter, begun: [word for word in words if word.startswith(begun)]


FILE_NAME = FileName(path_type=Path)


def noise_option(command: F) -> F:
    """Add the option --noise, a text or None for the default. It has the same meaning for every command."""
    text = f"Relative standard deviation of one reading of the ratio.  [default: {NOISE:g}]"
    return click.option("--noise", help=text)(command)


def noise_of(text: str | None) -> float:
    """Return the noise of a ratio as a number, or the default."""
    return NOISE if text is None else checked_noise(fraction("noise", text, ALLOWED))


def limiting(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options ``--memory`` and ``--time``, the limits of each evaluation, to a command."""
    for name, default in (("time", "120 s"), ("memory", "2 GB")):
        text = f"{name.capitalize()} that one evaluation may take.  [default: {default}]"
        verb = click.option(f"--{name}", callback=_limited, expose_value=False, help=text)(verb)
    return verb


def _limited(ctx: click.Context, parameter: click.Parameter, text: str | None) -> None:
    """Set one limit while the command runs."""
    from geometry.common.resources import limited, limits

    if text is not None:
        ctx.with_resource(limited(with_limits(limits(), **{str(parameter.name): text})))


def with_limits(held: Limits, *, time: str | None = None, memory: str | None = None) -> Limits:
    """Return limits with time and memory replaced by given texts, such as ``"60 s"`` and ``"4 GB"``."""
    from dataclasses import replace

    from geometry.scenes.units import MEMORY, TIME

    if time is not None:
        held = replace(held, seconds=TIME.read("time", time))
    return held if memory is None else replace(held, memory=MEMORY.read("memory", memory))


def number(key: str, text: str, allowed: str) -> float:
    """Return a text as a number; the caller checks its range."""
    from geometry.scenes import units

    return units.number(key, text, allowed)


def fraction(key: str, text: str, allowed: str = "a number above 0 and below 1, such as 0.01 or 1 %") -> float:
    """Return a fraction such as ``"0.01"`` or ``"1 %"`` as a number; the caller checks its range."""
    from geometry.scenes import units

    return units.fraction(key, text, allowed)


def length(key: str, text: str) -> float:
    """Return a length such as ``"5 mm"`` in m."""
    from geometry.scenes.probe import LENGTH

    return LENGTH.read(key, text)


def position(key: str, text: str) -> float:
    """Return a position such as ``"-20 mm"`` in m."""
    from typing import get_args

    from geometry.scenes.probe import Position

    return float(get_args(Position)[1].read(key, text))


def modulus(key: str, text: str) -> float:
    """Return a modulus such as ``"1 kPa"`` in Pa."""
    from geometry.scenes.units import MODULUS

    return MODULUS.read(key, text)
