"""Build a report as one HTML file that needs no network and fits a phone.

A command makes ``Chapter``s of the parts below and calls ``build_page``; the template escapes texts. The page contains the JSON
object of the result with its provenance, so that ``probe-design rerun`` can repeat it.
"""

from __future__ import annotations

import base64
import io
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import escape_unprintable
from geometry.common.json_types import JsonObject
from geometry.provenance.texts import format_html_script
from probe_design.reporting.table import Table

if TYPE_CHECKING:
    from jinja2 import Template
    from matplotlib.figure import Figure


_CONTROL_CHARACTERS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")  # in names: a terminal that shows the page would obey them


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Code:
    """Preformatted text, such as a scene file."""

    text: str
    kind: str = "code"


@dataclass(frozen=True)
class Items:
    """A list; with ``links`` each item is a link to a file in the folder of the page."""

    items: tuple[str, ...]
    links: bool = False
    kind: str = "items"


@dataclass(frozen=True)
class Picture:
    """A picture embedded in the page.

    Attributes
    ----------
    source
        A ``data:`` URL.
    alt
        Description of what it shows.
    """

    source: str
    alt: str
    kind: str = "picture"

    @classmethod
    def from_figure(cls, figure: Figure, alt: str) -> Picture:
        """Convert a matplotlib figure to a picture."""
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110)
        return cls._from_png(buffer.getvalue(), alt)

    @classmethod
    def from_file(cls, path: Path, alt: str) -> Picture:
        """Read a .png file as a picture."""
        return cls._from_png(path.read_bytes(), alt)

    @classmethod
    def _from_png(cls, content: bytes, alt: str) -> Picture:
        """Convert the bytes of a .png file to a picture."""
        return cls(f"data:image/png;base64,{base64.b64encode(content).decode()}", alt)


@dataclass(frozen=True)
class TurningView:
    """Bodies that a reader can rotate, each with ``colour``, ``vertices`` (n, 3) and ``triangles`` (m, 3); see ``bodies.py``."""

    bodies: tuple[dict[str, object], ...]
    alt: str
    kind: str = "view"

    @property
    def content(self) -> str:
        """The bodies as JSON."""
        return json.dumps(self.bodies, separators=(",", ":"))


Part = Text | Code | Items | Table | Picture | TurningView


@dataclass(frozen=True)
class Chapter:
    """A heading with the parts below it."""

    title: str
    parts: tuple[Part, ...]


def build_page(
    title: str, headline: str, sections: Sequence[Chapter], json_object: JsonObject, *, is_positive: bool = True
) -> str:
    """Build the report as HTML.

    Parameters
    ----------
    title
        Title of the page.
    headline
        The result in a sentence.
    sections
        Chapters of the page, in their order.
    json_object
        The JSON object that the command prints, with its ``provenance``, which is the last table of the page.
    is_positive
        Whether the result is positive: the banner of the headline is green, otherwise amber.
    """
    block = json_object["provenance"]
    text: str = _load_template().render(
        title=title,
        headline=headline,
        good=is_positive,
        sections=[*sections, Chapter("Provenance", (_build_provenance_table(block),))],
        answer=format_html_script("answer", json_object),
        script=resources.files("probe_design.data").joinpath("report.js").read_text(encoding="utf-8"),
    )
    return _CONTROL_CHARACTERS.sub(lambda code: escape_unprintable(code[0]), text)


def _build_provenance_table(block: JsonObject) -> Table:
    """Build the table of provenance from its JSON object: command, versions, input files and so on, without empty entries."""
    entries = {**block, "dependencies": [f"{name} {version}" for name, version in block["dependencies"].items()]}
    command = block["command"]
    entries["command"] = None if command is None else shlex.join(["probe-design", *command])
    entries["inputs"] = [f"{name} {sha[:12]}" for name, sha in block["inputs"].items()]
    texts = {name: ", ".join(value) if isinstance(value, list) else value for name, value in entries.items()}
    return Table(("", "provenance"), tuple((name, str(value)) for name, value in texts.items() if value not in (None, "")))


@lru_cache(maxsize=1)
def _load_template() -> Template:
    """Load the template of the page; it escapes all texts."""
    from jinja2 import Environment, StrictUndefined

    text = resources.files("probe_design.data").joinpath("report.html.in").read_text(encoding="utf-8")
    return Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True).from_string(text)
