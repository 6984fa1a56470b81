"""Output of the commands: JSON or a table on standard output, warnings on standard error, pictures; all with their provenance.

Imports are delayed until there is something to write.
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
    from geometry.scenes.probe import Probe
    from probe_design.reporting.table import Table

RECORDED_SETTINGS = ("evaluator", "accuracy", "seed")  # options with an entry of their own in a block of provenance


class Presentable(Protocol):
    """A result that can be printed as a table or as JSON."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user, one line each."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of the result."""
        ...


ResultT = TypeVar("ResultT", bound=Presentable)


def present(
    result: ResultT,
    table: Callable[[ResultT], Table],
    as_json: bool,
    picture: Path | None = None,
    lines: Callable[[ResultT], Iterable[str]] = lambda result: (),
) -> None:
    """Print a result as one JSON object, or as a table with lines of text and warnings.

    Args:
        result: to be printed.
        table: makes the table.
        as_json: whether to print JSON.
        picture: file of a picture that has been drawn already, to be named in a message.
        lines: make the lines below the table.
    """
    from geometry.common.errors import to_one_line
    from probe_design.terminal.console import show_table, warn, write_message

    if as_json:
        print_json(result.as_dict())
        return
    show_table(table(result))
    for line in lines(result):
        print(to_one_line(line))
    warn(result.warnings)
    if picture is not None:
        write_message(f"wrote {picture}")


def add_provenance(value: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON object with a block of provenance, which is added if there is none."""
    from geometry.provenance.block import build_provenance

    name = value.get("evaluator")
    block = value.get("provenance") or build_provenance(evaluator=name if isinstance(name, str) else None)
    return value | {"provenance": block}


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; NaN and infinity raise ``ValueError``."""
    print(json.dumps(add_provenance(value), allow_nan=False))


def check_picture(picture: Path | None) -> None:
    """Refuse a picture that could not be written, before the computation rather than after it.

    Raises:
        InputError: the format is unknown, or the folder cannot be written.
    """
    from geometry.common.files import check_writable_file
    from probe_design.reporting.picture_files import check_format

    if picture is not None:
        check_format(picture)
        check_writable_file(picture, "plot")


def record_command_line(command: click.Command) -> click.Command:
    """Make a command, or all commands of a group, record the command line in their results."""
    if isinstance(command, click.Group):
        for subcommand in command.commands.values():
            record_command_line(subcommand)
    elif command.callback is not None:
        command.callback = _wrap_callback(command.callback)
    return command


def _wrap_callback(run: Any) -> Any:
    """Return a callback that records the command line, the scene file and some options while it runs."""

    @functools.wraps(run)
    def run_recorded(*values: Any, **options: Any) -> Any:
        from geometry.provenance.block import record_command

        scene = options.get("scene")
        settings = {name: _parse_number(options[name]) for name in RECORDED_SETTINGS if options.get(name) is not None}
        with record_command(sys.argv[1:], scene if isinstance(scene, Path) else None, **settings):
            return run(*values, **options)

    return run_recorded


def _parse_number(value: Any) -> Any:
    """Return a text as a number if it is one, else unchanged."""
    try:
        return value if isinstance(value, int) else float(value)
    except ValueError:
        return value


def report_assumed_sizes(probe: Probe) -> None:
    """Report the sizes of a probe that are assumed because the scene does not give them."""
    from geometry.scenes.base_sizes import assumed_sizes
    from geometry.scenes.probe import format_mm
    from probe_design.terminal.console import write_message

    for key, size in assumed_sizes(probe).items():
        write_message(f"assumed: {key} = {format_mm(size)}, which the scene does not give")
