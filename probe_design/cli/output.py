"""What a verb leaves: JSON or a table on standard output, warnings on standard error, a picture; imports wait until then."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    from rich.table import Table


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


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; NaN and infinity are a defect."""
    print(json.dumps(value, allow_nan=False))


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
