"""The command line that made a file, to be run again: into another folder, as JSON, on files that are the same."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from geometry.common.errors import InputError, Words
from geometry.provenance.digest import file_digest

LEFT = ("plot", "vtu", "report", "force", "scheduler")  # options for files that are not compared, and for who computes
OUTPUT = "output"
LIVE = ("device", "scope", "record")  # of what is read from a device, which no command repeats


def rerun_words(cli: click.Group, words: list[str], inputs: Mapping[str, str], beside: Path, output: Path) -> list[str]:
    """Return the words to run.

    Args:
        cli: the verbs.
        words: that made the file.
        inputs: SHA-256 of the files that they name.
        beside: folder of the file that was made; those named are looked for here if not where the program runs.
        output: takes the place of what ``--output`` named.

    Raises:
        InputError: no such verb or option, or a file that is missing or has changed.
    """
    places = {name: str(_found(name, sha, beside)) for name, sha in inputs.items()}
    verb, rest = _verb(cli, list(words))
    context = click.Context(verb, info_name=words[0])
    try:
        options, _, order = verb.make_parser(context).parse_args(list(rest))
    except click.ClickException as fault:
        raise InputError("file", Words("its command"), f"one that this version knows ({fault.format_message()})") from None
    if any(options.get(name) for name in LIVE):
        raise InputError("file", Words(" ".join(words)), "what can be repeated: a reading of a device is not")
    again = [*words[: len(words) - len(rest)]]
    for option in (one for one in verb.params if isinstance(one, click.Option) and one.name in options):
        again += _words(option, options[str(option.name)], places, output)
    if any(one.name == "as_json" for one in verb.params) and "--json" not in again:
        again.append("--json")
    named = [value for one in order if isinstance(one, click.Argument) for value in _listed(options.get(str(one.name)))]
    return [*again, "--", *(places.get(str(word), str(word)) for word in named)]


def _verb(cli: click.Group, words: list[str]) -> tuple[click.Command, list[str]]:
    """The command that words begin with, and what follows."""
    command: click.Command = cli
    while isinstance(command, click.Group):
        name = words.pop(0) if words else ""
        found = command.commands.get(name)
        if found is None or name == "rerun":  # of itself there would be no end
            raise InputError(
                "file",
                Words(f"made by {name!r}"),
                f"made by one of {', '.join(one for one in command.commands if one != 'rerun')}",
            )
        command = found
    return command, words


def _words(option: click.Option, value: Any, places: Mapping[str, str], output: Path) -> list[str]:
    name = max(option.opts, key=len)
    if option.name in LEFT:
        return []
    if option.is_flag:
        return [name] if value else []
    values = [str(output)] if option.name == OUTPUT else [_placed(str(one), places) for one in _listed(value)]
    return [word for one in values for word in (name, one)]


def _placed(text: str, places: Mapping[str, str]) -> str:
    """An option's value with the file that it names, alone or before a comma, where that is found."""
    head, comma, tail = text.partition(",")
    return f"{places.get(head, head)}{comma}{tail}"


def _listed(value: Any) -> list[Any]:
    """The words of a value; click has a mark of its own for none."""
    several = list(value) if isinstance(value, list | tuple) else [value]
    return [one for one in several if isinstance(one, str)]


def _found(name: str, sha: str, beside: Path) -> Path:
    """The file of that name and content."""
    for folder in (Path(), beside, beside.parent):
        if file_digest(folder / name) == sha:
            return folder / name
    there = any((folder / name).is_file() for folder in (Path(), beside, beside.parent))
    trouble = "another content than it had" if there else "missing"
    raise InputError("input", name, f"the file that was asked about ({trouble} here and beside the file)")
