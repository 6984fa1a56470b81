"""Hold numbers of built-in data with their sources, and format both as TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from textwrap import wrap

MAX_LINE_CHARACTERS = 118  # characters of a line


@dataclass(frozen=True)
class Number:
    """A number of a tissue or a material.

    Attributes
    ----------
    value
        As a scene file has it, with its unit.
    source
        The publication, or "assumed" and why.
    scatter
        Between people or samples, as published; empty for what is assumed.
    """

    value: str | float
    source: str
    scatter: str = ""

    @property
    def description(self) -> str:
        """Scatter and source in one line."""
        return f"{self.scatter}; {self.source}" if self.scatter else self.source


def format_comment(text: str) -> list[str]:
    """Return a text as lines of comment."""
    return [f"# {line}" for line in wrap(text, MAX_LINE_CHARACTERS, break_on_hyphens=False, break_long_words=False)]


def format_toml(numbers: Mapping[str, Number]) -> list[str]:
    """Return each number as a key of a TOML table below a comment with its source."""
    lines: list[str] = []
    for key, number in numbers.items():
        lines += format_comment(number.description)
        lines.append(f'{key} = "{number.value}"' if isinstance(number.value, str) else f"{key} = {number.value}")
    return lines
