"""Write ``design-file.md``, every key of a design file, from the models that read it."""

from __future__ import annotations

from collections.abc import Iterator
from inspect import getdoc
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from probe_design.populations.design_file import DESIGN_SECTIONS, Design
from probe_design.populations.tables import LayerRanges
from probe_design.populations.template import format_toml

PAGE = Path(__file__).parent / "reference" / "design-file.md"
HEAD = """\
# The design file

A TOML file of what `probe-design optimize DESIGN.toml -o DIR` designs a probe for: tumours, readings, noise, limits.
`probe-design optimize --template` prints one with every key, which runs as it is. Each key may be left out; quantities are texts
with their units. How tumours are drawn and what detected and resolved mean: [population.md](../guides/population.md);
how the search goes: [design-search.md](../guides/design-search.md).

`scene = "scene.toml"`, beside the design file, or a whole scene as `[scene]` tables ([scene-file.md](scene-file.md)): its probe
is the start.

This page is what `python docs/make_design_keys.py` finds in the models: run it after every change of theirs.
"""


def page() -> str:
    """Return the page."""
    tables = [(f"[{name}]", _model(name)) for name in DESIGN_SECTIONS]
    tables.insert(1, ("[[population.layer]]", LayerRanges))
    return "\n".join((HEAD, *(line for heading, model in tables for line in _table(heading, model))))


def _model(name: str) -> type[BaseModel]:
    model = Design.model_fields[name].annotation
    assert isinstance(model, type)
    assert issubclass(model, BaseModel)
    return model


def _table(heading: str, model: type[BaseModel]) -> Iterator[str]:
    yield from (f"## `{heading}`", "", _words((getdoc(model) or "").partition("\n\nAttributes\n")[0]).strip(), "")
    yield from ("| key | meaning | example | left out |", "|---|---|---|---|")
    written: dict[str, Any] = model().model_dump(mode="json", exclude_none=True)
    for key, field in model.model_fields.items():
        if key != "layer":
            cells = _words(field.description or ""), _example(field, written.get(key)), _default(key, field, written)
            yield f"| `{key}` | {' | '.join(cells)} |"
    yield ""


def _example(field: FieldInfo, default: Any) -> str:
    value = field.examples[0] if field.examples else default
    return "" if value in (None, [], {}) else f"`{format_toml(value)}`"


def _default(key: str, field: FieldInfo, written: dict[str, Any]) -> str:
    value = written.get(key)
    if value in (None, [], {}):
        return "-"
    return f"`{format_toml(field.examples[0] if key == 'positions' and field.examples else value)}`"


def _words(text: str) -> str:
    return " ".join(text.split()).replace("``", "`").replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
