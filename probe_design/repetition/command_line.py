"""Build the command line that repeats a recorded one: into another folder, as JSON, on unchanged input files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from geometry.common.errors import InputError, Words
from geometry.provenance.block import compute_file_digest

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
        The group of all commands.
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
        options, _, _ = command.make_parser(context).parse_args(list(arguments))
    except click.ClickException as fault:
        raise InputError("file", Words("its command"), f"one that this version knows ({fault.format_message()})") from None
    if any(options.get(name) for name in DEVICE_OPTIONS):
        raise InputError("file", Words(" ".join(words)), "a command that can be repeated: a reading of a device cannot")
    # the name of the command; options and arguments are added to it
    new_words, positional = words[: len(words) - len(arguments)], list[str]()
    for parameter in command.params:
        value = options.get(str(parameter.name))
        texts = [text for text in (value if isinstance(value, list | tuple) else [value]) if isinstance(text, str)]
        if isinstance(parameter, click.Argument):
            positional += [places.get(text, text) for text in texts]
        elif isinstance(parameter, click.Option) and parameter.name in options and parameter.name not in IGNORED_OPTIONS:
            name = max(parameter.opts, key=len)  # the long form, such as --output
            if parameter.is_flag:
                new_words += [name] if value else []
            elif parameter.name == OUTPUT_OPTION:
                new_words += [name, str(output)]
            else:
                new_words += [word for text in texts for word in (name, _replace_path(text, places))]
    if any(parameter.name == "as_json" for parameter in command.params) and "--json" not in new_words:
        new_words.append("--json")
    return [*new_words, "--", *positional]


def _find_command(cli: click.Group, words: list[str]) -> tuple[click.Command, list[str]]:
    """Find the command at the beginning of ``words``; return it and the remaining words."""
    command: click.Command = cli
    while isinstance(command, click.Group):
        name, context = words.pop(0) if words else "", click.Context(command)
        subcommand = command.get_command(context, name)
        if subcommand is None or name == "rerun":  # would repeat itself without end
            choices = ", ".join(choice for choice in command.list_commands(context) if choice != "rerun")
            raise InputError("file", Words(f"made by {name!r}"), f"made by one of {choices}")
        command = subcommand
    return command, words


def _replace_path(text: str, places: Mapping[str, str]) -> str:
    """Replace the file name in an option's value, alone or before a comma, by the path where it exists now."""
    head, comma, tail = text.partition(",")
    return f"{places.get(head, head)}{comma}{tail}"


def _find_input(name: str, sha: str, file_folder: Path) -> Path:
    """Return the path of the input file with a name and the SHA-256 ``sha``; raise ``InputError`` if there is none."""
    paths = [folder / name for folder in (Path(), file_folder, file_folder.parent)]
    for path in paths:
        if compute_file_digest(path) == sha:
            return path
    trouble = "another content than it had" if any(path.is_file() for path in paths) else "missing"
    raise InputError("input", name, f"the original input file ({trouble} here and in the folder of the file)")
