"""Build the command line that repeats a recorded one: into another folder, as JSON, on unchanged input files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from geometry.common.errors import InputError, Words
from geometry.provenance.digest import file_digest

LEFT = ("plot", "vtu", "report", "force", "scheduler")  # not repeated: extra files, overwriting, clusters
OUTPUT = "output"
LIVE = ("device", "scope", "record")  # readings of a device cannot be repeated


def rerun_words(cli: click.Group, words: list[str], inputs: Mapping[str, str], beside: Path, output: Path) -> list[str]:
    """Return the words of the command line to run.

    Args:
        cli: the commands.
        words: recorded command line.
        inputs: SHA-256 of its input files, by name.
        file_folder: folder of the recorded file; input files are searched there if not in the working directory.
        output: replaces the value of ``--output``.

    Raises:
        InputError: there is no such command or option, or an input file is missing or has changed.
    """
    places = {name: str(_found(name, sha, beside)) for name, sha in inputs.items()}
    verb, rest = _verb(cli, list(words))
    context = click.Context(verb, info_name=words[0])
    try:
        options, _, order = verb.make_parser(context).parse_args(list(rest))
    except click.ClickException as fault:
        raise InputError("file", Words("its command"), f"one that this version knows ({fault.format_message()})") from None
    if any(options.get(name) for name in LIVE):
        raise InputError("file", Words(" ".join(words)), "a command that can be repeated: a reading of a device cannot")
    again = [*words[: len(words) - len(rest)]]
    for option in (one for one in verb.params if isinstance(one, click.Option) and one.name in options):
        again += _words(option, options[str(option.name)], places, output)
    if any(one.name == "as_json" for one in verb.params) and "--json" not in again:
        again.append("--json")
    named = [value for one in order if isinstance(one, click.Argument) for value in _listed(options.get(str(one.name)))]
    return [*again, "--", *(places.get(str(word), str(word)) for word in named)]


def _verb(cli: click.Group, words: list[str]) -> tuple[click.Command, list[str]]:
    """Find the command at the beginning of ``words``; return it and the remaining words."""
    command: click.Command = cli
    while isinstance(command, click.Group):
        name = words.pop(0) if words else ""
        found = command.commands.get(name)
        if found is None or name == "rerun":  # would repeat itself without end
            raise InputError(
                "file",
                Words(f"made by {name!r}"),
                f"made by one of {', '.join(one for one in command.commands if one != 'rerun')}",
            )
        command = found
    return command, words


def _words(option: click.Option, value: Any, places: Mapping[str, str], output: Path) -> list[str]:
    """Return the words of one option of the new command line."""
    name = max(option.opts, key=len)
    if option.name in LEFT:
        return []
    if option.is_flag:
        return [name] if value else []
    values = [str(output)] if option.name == OUTPUT else [_placed(str(one), places) for one in _listed(value)]
    return [word for one in values for word in (name, one)]


def _placed(text: str, places: Mapping[str, str]) -> str:
    """Replace the file name in an option's value, alone or before a comma, by the path where it exists now."""
    head, comma, tail = text.partition(",")
    return f"{places.get(head, head)}{comma}{tail}"


def _listed(value: Any) -> list[Any]:
    """Return the words of an option's value; click marks a missing value with an object of its own."""
    several = list(value) if isinstance(value, list | tuple) else [value]
    return [one for one in several if isinstance(one, str)]


def _found(name: str, sha: str, beside: Path) -> Path:
    """Return the path of the file with a name and content."""
    for folder in (Path(), beside, beside.parent):
        if file_digest(folder / name) == sha:
            return folder / name
    there = any((folder / name).is_file() for folder in (Path(), beside, beside.parent))
    trouble = "another content than it had" if there else "missing"
    raise InputError("input", name, f"the original input file ({trouble} here and in the folder of the file)")
