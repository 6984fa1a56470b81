"""Options and arguments of the commands, and their conversion to numbers. Heavy imports are delayed until they are needed.

Each function raises ``InputError`` for a text that is not allowed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from probe_design.data.noise import ALLOWED_NOISE, DEFAULT_NOISE, check_noise

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


def _read_frequency(ctx: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    from geometry.scenes.units import FREQUENCY_QUANTITY

    return None if text is None else FREQUENCY_QUANTITY.read("frequency", text)


frequency_option = click.option(
    "--frequency",
    callback=_read_frequency,
    help='Frequency of the load, "5 Hz": compute the phase of the ratio by loss factors.',
)
"""For evaluate: a frequency in Hz, or None."""
CommandT = TypeVar("CommandT", bound=Callable[..., Any])


class NamedCommands(click.Group):
    """A group of commands. An unknown command is refused with the list of known ones."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find a command by its name, or raise a usage error that lists the known commands."""
        if args[0] in self.commands:
            return super().resolve_command(ctx, args)
        kind = "command" if ctx.parent is None else ctx.info_name
        from geometry.common.errors import describe_choices

        raise click.UsageError(f"{kind} = {args[0]!r}: allowed: {describe_choices(args[0], self.commands)}")


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


def complete_words(*words: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return the shell completion of an option with given words; the option itself refuses other words."""
    return lambda ctx, parameter, prefix: [word for word in words if word.startswith(prefix)]


FILE_NAME = FileName(path_type=Path)


def add_noise_option(command: CommandT) -> CommandT:
    """Add the option --noise, a text or None for the default. It has the same meaning for every command."""
    text = f"Relative standard deviation of one reading of the ratio.  [default: {DEFAULT_NOISE:g}]"
    return click.option("--noise", help=text)(command)


def read_noise(text: str | None) -> float:
    """Return the noise of a ratio as a number, or the default."""
    return DEFAULT_NOISE if text is None else check_noise(read_fraction("noise", text, ALLOWED_NOISE))


def add_limit_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options ``--memory`` and ``--time``, the limits of each evaluation, to a command."""
    for name, default in (("time", "120 s"), ("memory", "2 GB")):
        text = f"{name.capitalize()} that one evaluation may take.  [default: {default}]"
        command = click.option(f"--{name}", callback=_set_limit, expose_value=False, help=text)(command)
    return command


def _set_limit(ctx: click.Context, parameter: click.Parameter, text: str | None) -> None:
    """Set one limit while the command runs."""
    from geometry.common.resources import get_limits, use_limits

    if text is not None:
        ctx.with_resource(use_limits(replace_limits(get_limits(), **{str(parameter.name): text})))


def replace_limits(limits: Limits, *, time: str | None = None, memory: str | None = None) -> Limits:
    """Return limits with time and memory replaced by given texts, such as ``"60 s"`` and ``"4 GB"``."""
    from dataclasses import replace

    from geometry.scenes.units import MEMORY_QUANTITY, TIME_QUANTITY

    if time is not None:
        limits = replace(limits, seconds=TIME_QUANTITY.read("time", time))
    return limits if memory is None else replace(limits, memory=MEMORY_QUANTITY.read("memory", memory))


def read_number(key: str, text: str, allowed: str) -> float:
    """Return a text as a number; the caller checks its range."""
    from geometry.scenes import units

    return units.read_number(key, text, allowed)


def read_fraction(key: str, text: str, allowed: str = "a number above 0 and below 1, such as 0.01 or 1 %") -> float:
    """Return a fraction such as ``"0.01"`` or ``"1 %"`` as a number; the caller checks its range."""
    from geometry.scenes import units

    return units.read_fraction(key, text, allowed)


def read_length(key: str, text: str) -> float:
    """Return a length such as ``"5 mm"`` in m."""
    from geometry.scenes.probe import LENGTH_QUANTITY

    return LENGTH_QUANTITY.read(key, text)


def read_position(key: str, text: str) -> float:
    """Return a position such as ``"-20 mm"`` in m."""
    from typing import get_args

    from geometry.scenes.probe import Position

    return float(get_args(Position)[1].read(key, text))


def read_modulus(key: str, text: str) -> float:
    """Return a modulus such as ``"1 kPa"`` in Pa."""
    from geometry.scenes.units import MODULUS_QUANTITY

    return MODULUS_QUANTITY.read(key, text)
