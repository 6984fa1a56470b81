"""Write ``commands.md``, every command with its options and Python keywords, from the requests."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

from pydantic.fields import FieldInfo

import probe_design
from probe_design.commands.fields import LimitedRequest
from probe_design.commands.names import COMMANDS
from probe_design.commands.request import Request, describe_allowed, find_option, find_types, format_default, list_fields

PAGE = Path(__file__).parent / "reference" / "commands.md"
HEAD = """\
# Commands

`probe-design COMMAND --help` prints the same. A quantity is a text with its unit, `"5 mm"`, `"1 kPa"`; fractions may be
percentages. `--json` prints one JSON object on standard output, everything else goes to standard error. The exit code is 0 if all
is well, 1 after a failure or a negative result, 2 for bad input. Options without a value are flags.

In Python, `probe_design` has functions of the same names (`press` for `load`), whose keywords are marked in the tables
(numbers then in SI units); arrays stand in place of `--from`, `--to` and the like, see `help(probe_design.scan)`.

This page is what `python docs/make_commands.py` finds in the requests: run it after every change of theirs.
"""
FUNCTIONS = {"load": "press"}  # of another name than their commands
SHARED_HEAD = "`--memory` and `--time` where scenes are evaluated; `sweep` has its own.\n"


def page() -> str:
    """Return the page."""
    lines = [HEAD, "## Options of all commands", "", SHARED_HEAD, *_table("", list_fields(LimitedRequest))]
    group = ""
    for name, command in COMMANDS.items():
        if command.group and command.group != group:
            group = command.group
            lines += [f"## {group}", ""]
        if command.request:
            lines += _section(name, command.load_request())
    return "\n".join(lines)


def _section(name: str, request: type[Request]) -> Iterator[str]:
    arguments = [_format_argument(key, field) for key, field in list_fields(request).items() if find_option(field).is_argument]
    yield from (f"### `{' '.join((name, *filter(None, arguments)))}`", "")
    for paragraph in inspect.cleandoc(request.__doc__ or "").split("\n\n"):
        yield from (
            ("```text", paragraph.removeprefix("\b\n"), "```", "") if paragraph.startswith("\b") else (_join_lines(paragraph), "")
        )
    general = list_fields(LimitedRequest if issubclass(request, LimitedRequest) else Request)
    yield from _table(name, {key: field for key, field in list_fields(request).items() if key not in general})


def _table(command: str, fields: dict[str, FieldInfo]) -> Iterator[str]:
    rows = [_format_row(command, key, field) for key, field in fields.items() if not find_option(field).is_argument]
    if rows:
        yield from ("| option | what it may be | left out | meaning |", "|---|---|---|---|", *rows, "")


def _format_argument(key: str, field: FieldInfo) -> str:
    metavar = find_option(field).metavar
    return metavar if metavar is not None else key.upper() if field.is_required() else f"[{key.upper()}]"


def _format_row(command: str, key: str, field: FieldInfo) -> str:
    option = find_option(field)
    names = option.names.split("/") if option.names else [f"--{key.replace('_', '-')}"]
    name = FUNCTIONS.get(command, command)
    function = getattr(probe_design, name) if name in probe_design.__all__ else None
    keyword = f"<br>`{key}=`" if function is not None and key in inspect.signature(function).parameters else ""
    left_out = "required" if field.is_required() else format_default(field) or "-"
    allowed = "-" if bool in find_types(field) else _join_lines(describe_allowed(field))
    return f"| `{', '.join(names)}`{keyword} | {allowed} | {left_out} | {_join_lines(option.help)} |"


def _join_lines(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
