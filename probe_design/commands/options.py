"""Generate the click command of a request: options and arguments with their types, defaults and help."""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click
from click.core import ParameterSource
from pydantic.fields import FieldInfo

from geometry.common.errors import InputError, ObsoleteKeyWarning
from geometry.common.json_types import JsonObject
from geometry.common.resources import use_limits
from probe_design.commands.request import Request, find_option, find_range, find_types, format_default, list_fields

RECORDED_SETTINGS = ("evaluator", "accuracy", "seed")  # options with an entry of their own in a block of provenance


class FileName(click.Path):
    """The name of a file or folder in UTF-8, as libraries, records and pages cannot store any other."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path of a file's name.

        An empty name is refused, as it would otherwise mean the current folder, and so is a name that is not UTF-8.
        """
        key = "path" if param is None else get_label(param)
        try:
            value.encode()
        except UnicodeEncodeError:  # bytes that are not UTF-8, as Python represents them
            raise InputError(key, value, "the name of a file or folder, in UTF-8") from None
        if not value:
            raise InputError(key, value, "the name of a file or folder")
        return super().convert(value, param, ctx)


class WholeLineCommand(click.Command):
    """A command whose help has no line beyond the width of the terminal, examples and tables included."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help text, preformatted paragraphs included, which click would leave as they are."""
        with formatter.indentation():
            width = formatter.width - formatter.current_indent
            for paragraph in inspect.cleandoc(self.help or "").split("\n\n"):
                formatter.write_paragraph()
                if paragraph.startswith("\b\n"):
                    whole = re.sub(r"\n {6,}", " ", paragraph)  # what a column continues on a line of its own
                    lines = (part for line in whole.splitlines()[1:] for part in wrap_line(line, width))
                    paragraph = "\n".join(("\b", *lines))
                formatter.write_text(paragraph)


def wrap_line(line: str, width: int) -> list[str]:
    """Return a preformatted line as lines of at most ``width`` characters.

    Parts in quotes stay whole. A command continues after a backslash, what stands in a column below the beginning of that column.
    """
    if len(line) <= width:
        return [line]
    ending = " \\" if line.startswith("probe-design ") else ""
    column = re.match(r" *\S+(?: \S+)* {2,}(?=\S)", line)
    indent = " " * (column.end() if column is not None and not ending else 4)
    whole = re.sub(r'"[^"]*"', lambda quoted: quoted.group().replace(" ", "\0"), line)
    parts = textwrap.wrap(whole, width - len(ending), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return [part.replace("\0", " ") + ending for part in parts[:-1]] + [parts[-1].replace("\0", " ")]


def build_command(name: str, request: type[Request], summary: str) -> click.Command:
    """Return the command of a request, which checks the options, records the command line, and runs the request."""

    def run(**_: object) -> None:
        """Build the request from the options given on the command line, and run it."""
        context = click.get_current_context()
        given = {
            key: value
            for key, value in context.params.items()
            if context.get_parameter_source(key) not in (ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)
        }
        labels = {str(parameter.name): get_label(parameter) for parameter in context.command.params}
        with print_obsolete_keys():
            run_request(request.build(given, labels))

    parameters = [build_parameter(key, field) for key, field in list_fields(request).items()]
    return WholeLineCommand(name, callback=run, params=parameters, help=request.__doc__, short_help=summary)


@contextmanager
def print_obsolete_keys() -> Iterator[None]:
    """Write each ``ObsoleteKeyWarning`` as one line to standard error, once, in place of Python's own text with a path."""
    from probe_design.terminal.console import warn

    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        """Write a warning that Python would show; see ``warnings.showwarning``."""
        if not issubclass(category, ObsoleteKeyWarning):
            show_other(message, category, *place, **more)
        elif str(message) not in shown:
            shown.add(str(message))
            warn([str(message)])

    with warnings.catch_warnings():
        warnings.simplefilter("always", ObsoleteKeyWarning)
        show_other, warnings.showwarning = warnings.showwarning, show
        yield


def run_request(request: Request) -> None:
    """Run a request under its limits; the provenance of all its output records the command line."""
    from geometry.provenance.block import record_command
    from probe_design.terminal.console import use_quiet

    scene = getattr(request, "scene", None)
    settings = {name: getattr(request, name) for name in RECORDED_SETTINGS if getattr(request, name, None) is not None}
    with (
        record_command(sys.argv[1:], scene if isinstance(scene, Path) else None, **settings),
        use_limits(request.limits),
        use_quiet(request.quiet),
    ):
        request.run()


def get_label(parameter: click.Parameter) -> str:
    """Return the name of a parameter for messages: the longest one, without dashes."""
    return max(parameter.opts, key=len).lstrip("-")


def build_parameter(name: str, field: FieldInfo) -> click.Parameter:
    """Return the option or argument of a field. Texts with units stay texts, which the request reads."""
    option, types = find_option(field), find_types(field)
    is_multiple = any(get_origin(part) is tuple for part in (field.annotation, *get_args(field.annotation)))
    default = format_default(field)
    if option.is_argument:
        return click.Argument(
            [name],
            type=_choose_type(types, field),
            required=field.is_required(),
            nargs=-1 if is_multiple else 1,
            metavar=option.metavar,
        )
    names = option.names.split("/") if option.names else [f"--{name.replace('_', '-')}"]
    if bool in types:
        return click.Option([*names, name], is_flag=True, help=option.help)
    has_default = bool(default) and not option.left_out
    # an option that is required has no default, not even None
    default_options: JsonObject = {"default": default, "show_default": True} if has_default else {}
    return click.Option(
        [*names, name],
        type=_choose_type(types, field),
        multiple=is_multiple,
        required=field.is_required(),
        **default_options,
        metavar=option.metavar,
        shell_complete=_complete_words(option.words) if option.words else None,
        help=option.help if has_default or not default else f"{option.help}  [default: {default}]",
    )


def _choose_type(types: list[Any], field: FieldInfo) -> click.ParamType[Any]:
    """Return click's type for the text of a field on the command line, by the field's types and notes."""
    for part in types:
        if get_origin(part) is Literal:
            return click.Choice(get_args(part))
    if int in types:
        return click.IntRange(*find_range(field))
    return FileName(path_type=Path) if Path in types else click.STRING


def _complete_words(words: tuple[str, ...]) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return the function that completes the begin of one of ``words``, in the form in which click calls it."""
    return lambda context, parameter, prefix: [word for word in words if word.startswith(prefix)]
