"""Output of the commands: JSON or a table on standard output, warnings on standard error, pictures; all with their provenance."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from geometry.common.errors import InputError, to_one_line
from geometry.common.files import check_writable_file
from geometry.provenance.block import build_provenance
from geometry.scenes.base_sizes import assume_sizes
from geometry.scenes.probe import format_mm
from probe_design.reporting.picture_files import check_format, save_figure
from probe_design.terminal.console import show_table, warn, write_message

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from geometry.common.json_types import JsonObject
    from geometry.scenes.probe import Probe
    from probe_design.reporting.table import Table


class Presentable(Protocol):
    """A result that can be printed as a table or as JSON."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user, one line each."""
        ...

    def as_dict(self) -> JsonObject:
        """Return the JSON object of the result."""
        ...


ResultT = TypeVar("ResultT", bound=Presentable)


def present(
    result: ResultT,
    table: Callable[[ResultT], Table],
    as_json: bool,
    picture: Path | None = None,
    *,
    lines: Callable[[ResultT], Iterable[str]] = lambda result: (),
    draw: Callable[[ResultT], Figure] | None = None,
) -> None:
    """Draw a result where a picture is requested; print it as one JSON object, or as a table with lines and warnings.

    Parameters
    ----------
    result
        To be printed.
    table
        Makes the table.
    as_json
        Whether to print JSON.
    picture
        File of the picture.
    lines
        Make the lines below the table.
    draw
        Draws the picture; default: ``probe_design.plot``.
    """
    if picture is not None:
        from probe_design.commands.plot import plot

        figure = plot(result) if draw is None else draw(result)  # type: ignore[arg-type]  # it refuses what has no picture
        save_figure(figure, picture)
    print_result(result.as_dict, lambda: [table(result)], as_json, lambda: lines(result))
    if not as_json:
        warn(result.warnings)
        if picture is not None:
            write_message(f"wrote {picture}")


def print_result(
    build_json: Callable[[], JsonObject],
    tables: Callable[[], Iterable[Table]],
    as_json: bool,
    lines: Callable[[], Iterable[str]] = lambda: (),
) -> None:
    """Print a result as one JSON object, or as tables with lines of text below; only what is printed is built.

    Parameters
    ----------
    build_json
        Builds the JSON object.
    tables
        Builds the tables.
    as_json
        Whether to print JSON.
    lines
        Builds the lines.
    """
    if as_json:
        print_json(build_json())
        return
    for table in tables():
        show_table(table)
    for line in lines():
        print(to_one_line(line))


def add_provenance(value: dict[str, object]) -> dict[str, object]:
    """Return a JSON object with a block of provenance, which is added if there is none."""
    name = value.get("evaluator")
    block = value.get("provenance") or build_provenance(evaluator=name if isinstance(name, str) else None)
    return value | {"provenance": block}


def print_json(value: dict[str, object]) -> None:
    """Print one JSON object; NaN and infinity raise ``ValueError``."""
    print(json.dumps(add_provenance(value), allow_nan=False))


def check_picture(picture: Path | None) -> Path | None:
    """Return the file of a picture, which can be written.

    Raises
    ------
    InputError
        The format is unknown, or the folder cannot be written.
    """
    if picture is not None:
        check_format(picture)
        check_writable_file(picture, "plot")
    return picture


def split_assignments(key: str, texts: Iterable[str], allowed: str) -> dict[str, str]:
    """Split texts such as "probe.gap = 10 um" into names and values.

    Raises
    ------
    InputError
        A text is no assignment; ``allowed`` describes one.
    """
    assignments = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError(key, text, allowed)
        assignments[name] = value
    return assignments


def report_assumed_sizes(probe: Probe) -> None:
    """Report the sizes of a probe that are assumed because the scene does not give them."""
    for key, size in assume_sizes(probe).items():
        write_message(f"assumed: {key} = {format_mm(size)}, which the scene does not give")
