"""Files that are nearly right: tables with other values, keys and depths, and texts cut, garbled or in another encoding."""

from __future__ import annotations

import copy
import datetime
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

Dump = Callable[[Any], str]


def nested(kind: str, depth: int) -> Any:
    """Lists in lists, or tables in tables."""
    deep: Any = 1
    for _ in range(depth):
        deep = [deep] if kind == "list" else {"a": deep}
    return deep


LEAVES: st.SearchStrategy[Any] = st.one_of(
    st.booleans(),
    st.sampled_from([0, -1, 3, 255, 2**31, 2**63, 2**70, 10**400]),
    st.floats(),
    st.sampled_from([1e308, -1e308, 5e-324, float("nan"), float("inf")]),
    st.text(max_size=12),
    st.sampled_from(["", "5 mm", "1 kPa", "nan mm", "1e999 m", "5", "\x1b[31m", "x" * 5000, "solid", "block", "tissue", "log"]),
    st.just(datetime.date(2020, 2, 30 - 1)),
    st.builds(nested, st.sampled_from(["list", "table"]), st.sampled_from([1, 2, 3, 4, 5, 40])),
)
VALUES = st.one_of(LEAVES, st.lists(LEAVES, max_size=4), st.dictionaries(st.text("abcxyz_.", min_size=1), LEAVES, max_size=3))


@st.composite
def mutated(draw: st.DrawFn, data: Any, values: st.SearchStrategy[Any] = VALUES) -> Any:
    """A copy of tables with one to three changes anywhere: another value, a key lost, added, doubled or moved."""
    data = copy.deepcopy(data)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(_places(data)))
        kind = draw(st.sampled_from(["replace", "replace", "delete", "add", "repeat"]))
        if isinstance(place, dict):
            key = draw(st.sampled_from(sorted(place))) if place else "new"
            if kind == "delete":
                place.pop(key, None)
            elif kind == "add":
                place[draw(st.text("abcxyz_", min_size=1, max_size=8))] = draw(values)
            else:
                place[key] = draw(values) if kind == "replace" else [place.get(key, 1)] * 2
        elif kind == "delete" and place:
            del place[draw(st.integers(0, len(place) - 1))]
        elif kind == "replace" and place:
            place[draw(st.integers(0, len(place) - 1))] = draw(values)
        else:
            place.append(place[0] if kind == "repeat" and place else draw(values))
    return data


def _places(data: Any) -> list[Any]:
    """All tables and lists."""
    if not isinstance(data, dict | list):
        return []
    parts = data.values() if isinstance(data, dict) else data
    return [data, *(place for part in parts for place in _places(part))]


@st.composite
def garbled(draw: st.DrawFn, content: bytes) -> bytes:
    """Bytes of a file that was cut, overwritten in places, doubled or written in another encoding."""
    kind = draw(st.sampled_from(["cut", "overwritten", "overwritten", "doubled", "utf-16", "deep", "any"]))
    position = draw(st.integers(0, len(content)))
    if kind == "cut":
        return content[:position]
    if kind == "overwritten":
        return content[:position] + draw(st.binary(max_size=20)) + content[position + draw(st.integers(0, 20)) :]
    if kind == "doubled":
        return content + content
    if kind == "utf-16":
        return content.decode("latin-1").encode("utf-16")
    if kind == "deep":
        return (
            content[:position]
            + draw(st.sampled_from([b"[", b"{", b"(", b'{"a":', b"a=[", b"a.", b"-"])) * 3000
            + content[position:]
        )
    return draw(st.binary(max_size=300))
