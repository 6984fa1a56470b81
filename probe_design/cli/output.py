"""What a verb leaves: JSON or a table on standard output, warnings on standard error, a picture, and in each where it is from.

Imports wait until there is something to leave.
"""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

if TYPE_CHECKING:
    from rich.table import Table

    from geometry.scenes.probe import Probe

SETTINGS = ("evaluator", "accuracy", "seed")  # that a block of provenance tells by themselves


class Presentable(Protocol):
    """A result of the toolkit."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user has to know, one line each."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Return its JSON object."""
        ...


R = TypeVar("R", bound=Presentable)


def present(
    result: R,
    table: Callable[[R], Table],
    as_json: bool,
    picture: Path | None = None,
    lines: Callable[[R], Iterable[str]] = lambda result: (),
) -> None:
    """Print a result as one JSON object, or for a person as a table, some lines and its warnings.

    Args:
        result: what was computed.
        table: makes the table.
        as_json: whether JSON is asked for.
        picture: what has been drawn already, to be named.
        lines: what stands below the table.
    """
    from geometry.common.errors import one_line
    from probe_design.terminal.console import message, show, warn

    if as_json:
        print_json(result.as_dict())
        return
    show(table(result))
    for line in lines(result):
        print(one_line(line))
    warn(result.warnings)
    if picture is not None:
        message(f"wrote {picture}")


def with_provenance(value: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON object with the block that tells where it comes from, if it has none."""
    from geometry.provenance.block import provenance

    name = value.get("evaluator")
    own = value.get("provenance") or provenance(evaluator=name if isinstance(name, str) else None)
    return value | {"provenance": own}


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; NaN and infinity are a defect."""
    print(json.dumps(with_provenance(value), allow_nan=False))


def check_picture(picture: Path | None) -> None:
    """Refuse a picture that could not be written: what would fail after the work fails before it.

    Raises:
        InputError: no such format, or its folder cannot be written.
    """
    from geometry.common.files import check_writable_file
    from probe_design.pictures.formats import check_format

    if picture is not None:
        check_format(picture)
        check_writable_file(picture, "plot")


def noted(verb: click.Command) -> click.Command:
    """Let a verb, or all that a group of them has, tell of the command line in what it makes."""
    if isinstance(verb, click.Group):
        for one in verb.commands.values():
            noted(one)
    elif verb.callback is not None:
        verb.callback = _telling(verb.callback)
    return verb


def _telling(run: Any) -> Any:
    @functools.wraps(run)
    def telling(*values: Any, **options: Any) -> Any:
        from geometry.provenance.block import command

        scene = options.get("scene")
        asked = {name: _plain(options[name]) for name in SETTINGS if options.get(name) is not None}
        with command(sys.argv[1:], scene if isinstance(scene, Path) else None, **asked):
            return run(*values, **options)

    return telling


def _plain(value: Any) -> Any:
    """A number, where a text is one."""
    try:
        return value if isinstance(value, int) else float(value)
    except ValueError:
        return value


def tell_assumed(probe: Probe) -> None:
    """Say of which sizes a workshop should know that nobody has given them."""
    from geometry.scenes.base_sizes import assumed_sizes
    from geometry.scenes.probe import mm
    from probe_design.terminal.console import message

    for key, size in assumed_sizes(probe).items():
        message(f"assumed: {key} = {mm(size)}, which the scene does not give")
