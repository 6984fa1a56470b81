"""Build the command line that repeats a recorded one: into another folder, as JSON, on unchanged input files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from geometry.common.errors import InputError, Words
from geometry.provenance.digest import compute_file_digest

IGNORED_OPTIONS = ("plot", "vtu", "report", "force", "scheduler")  # not repeated: extra files, overwriting, clusters
OUTPUT_OPTION = "output"
DEVICE_OPTIONS = ("device", "scope", "record")  # readings of a device cannot be repeated


def build_rerun_words(
    cli: click.Group, words: list[str], inputs: Mapping[str, str], file_folder: Path, output: Path
) -> list[str]:
    """Return the words of the command line to run.

    Parameters
    ----------
    cli
        The commands.
    words
        Recorded command line.
    inputs
        SHA-256 of its input files, by name.
    file_folder
        Folder of the recorded file; input files are searched there if not in the working directory.
    output
        Replaces the value of ``--output``.

    Raises
    ------
    InputError
        There is no such command or option, or an input file is missing or has changed.
    """
    places = {name: str(_find_input(name, sha, file_folder)) for name, sha in inputs.items()}
    command, arguments = _find_command(cli, list(words))
    context = click.Context(command, info_name=words[0])
    try:
        options, _, order = command.make_parser(context).parse_args(list(arguments))
    except click.ClickException as fault:
        raise InputError("file", Words("its command"), f"one that this version knows ({fault.format_message()})") from None
    if any(options.get(name) for name in DEVICE_OPTIONS):
        raise InputError("file", Words(" ".join(words)), "a command that can be repeated: a reading of a device cannot")
    new_words = [*words[: len(words) - len(arguments)]]
    for option in (
        parameter for parameter in command.params if isinstance(parameter, click.Option) and parameter.name in options
    ):
        new_words += _build_option_words(option, options[str(option.name)], places, output)
    if any(parameter.name == "as_json" for parameter in command.params) and "--json" not in new_words:
        new_words.append("--json")
    positional = [
        value
        for parameter in order
        if isinstance(parameter, click.Argument)
        for value in _list_words(options.get(str(parameter.name)))
    ]
    return [*new_words, "--", *(places.get(str(word), str(word)) for word in positional)]


def _find_command(cli: click.Group, words: list[str]) -> tuple[click.Command, list[str]]:
    """Find the command at the beginning of ``words``; return it and the remaining words."""
    command: click.Command = cli
    while isinstance(command, click.Group):
        name, context = words.pop(0) if words else "", click.Context(command)
        subcommand = command.get_command(context, name)
        if subcommand is None or name == "rerun":  # would repeat itself without end
            raise InputError(
                "file",
                Words(f"made by {name!r}"),
                f"made by one of {', '.join(choice for choice in command.list_commands(context) if choice != 'rerun')}",
            )
        command = subcommand
    return command, words


def _build_option_words(option: click.Option, value: object, places: Mapping[str, str], output: Path) -> list[str]:
    """Return the words of one option of the new command line."""
    name = max(option.opts, key=len)
    if option.name in IGNORED_OPTIONS:
        return []
    if option.is_flag:
        return [name] if value else []
    values = [str(output)] if option.name == OUTPUT_OPTION else [_replace_path(str(text), places) for text in _list_words(value)]
    return [word for text in values for word in (name, text)]


def _replace_path(text: str, places: Mapping[str, str]) -> str:
    """Replace the file name in an option's value, alone or before a comma, by the path where it exists now."""
    head, comma, tail = text.partition(",")
    return f"{places.get(head, head)}{comma}{tail}"


def _list_words(value: object) -> list[Any]:
    """Return the words of an option's value; click marks a missing value with an object of its own."""
    words = list(value) if isinstance(value, list | tuple) else [value]
    return [word for word in words if isinstance(word, str)]


def _find_input(name: str, sha: str, file_folder: Path) -> Path:
    """Return the path of the file with a name and content."""
    for folder in (Path(), file_folder, file_folder.parent):
        if compute_file_digest(folder / name) == sha:
            return folder / name
    exists = any((folder / name).is_file() for folder in (Path(), file_folder, file_folder.parent))
    trouble = "another content than it had" if exists else "missing"
    raise InputError("input", name, f"the original input file ({trouble} here and in the folder of the file)")
