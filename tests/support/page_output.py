"""Commands of a page with the output that it shows, and whether a command still prints that."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import zip_longest

import pytest

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
TIME = re.compile(r"\d+(\.\d+)? s\b")


@dataclass(frozen=True)
class Line:
    """A command of a page, and the lines of its output that the page shows, in their order."""

    command: str
    shown: tuple[str, ...] = ()


def read_lines(page: str) -> list[Line]:
    lines: list[Line] = []
    for language, block in re.findall(r"```(bash|console)\n(.*?)```", page, re.S):
        if language == "bash":
            lines += map(Line, block.splitlines())
        else:
            commands = re.findall(r"^\$ (.+)\n((?:(?!\$ ).*\n)*)", block, re.M)
            lines += [Line(command, tuple(filter(str.strip, shown.splitlines()))) for command, shown in commands]
    return lines


def find_missing(line: Line, printed: str) -> str | None:
    """Return the first line that the page shows and the command does not print, in the page's order; None if there is none."""
    rows = iter(printed.splitlines())
    return next((shown for shown in line.shown if not any(is_alike(shown, row) for row in rows)), None)


def is_alike(shown: str, printed: str) -> bool:
    """Return whether two lines have the same words, and numbers that differ by at most 5 %, or 0.02 where they are small."""
    lines = [TIME.sub("", line) for line in (shown, printed)]
    if not all(x == y for x, y in zip_longest(*(NUMBER.sub("#", line).split() for line in lines))):
        return False
    numbers = [[float(text) for text in NUMBER.findall(line)] for line in lines]
    return numbers[1] == pytest.approx(numbers[0], rel=0.05, abs=0.02)
