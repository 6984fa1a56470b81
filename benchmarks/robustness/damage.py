"""Damage valid files: tables with other values, keys and nesting; bytes cut, overwritten, doubled or re-encoded."""

from __future__ import annotations

import copy
import datetime
import math
import random
import re
from typing import Any

Random = random.Random
NUMBERS = (0, -1, 3, 255, 2**31, 2**63, 2**70, 10**400, 1e308, -1e308, 5e-324, float("nan"), float("inf"), -0.0, True)
TEXTS = (
    "", "5 mm", "1 kPa", "-1 mm", "0 mm", "nan mm", "inf Pa", "1e999 m", "0.1 mm^0", "0e99999999999999999999 mm", "1e-320 m", "5",
    "5 furlong", "1 mm\x1b[31m", "\udce9", "x" * 5000, "solid", "block", "half-space", "tissue", "unilateral", "log",
    "probe.gap", "../../x", "é 蘑菇",
)  # fmt: skip
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
RUNS = (b"[", b"{", b"(", b'{"a":', b"a=[", b"a.", b"-", b"#1=", b"\0", b"9")


def value(draw: Random) -> Any:
    """Any value that a table can have, seldom one that is allowed."""
    kind = draw.choice(["number", "text", "near", "date", "nested", "list"])
    if kind == "number":
        return draw.choice(NUMBERS)
    if kind == "text":
        return draw.choice(TEXTS)
    if kind == "near":
        return f"{10 ** draw.uniform(-9, 9):.3g} {draw.choice(['mm', 'm', 'um', 'kPa', 'Pa', 'GPa', 'N', 'deg', 'mm kPa'])}"
    if kind == "date":
        return datetime.date(2020, 2, 29)
    if kind == "nested":
        return build_nested(draw.random() < 0.5, draw.choice([1, 2, 5, 40]))
    return [value(draw) for _ in range(draw.randint(0, 3))]


def build_nested(lists: bool, depth: int) -> Any:
    """Return lists in lists, or tables in tables."""
    deep: Any = 1
    for _ in range(depth):
        deep = [deep] if lists else {"a": deep}
    return deep


def mutate(tables: Any, draw: Random) -> Any:
    """Return a copy with one to three changes anywhere: another value, a key lost, added or doubled."""
    tables = copy.deepcopy(tables)
    for _ in range(draw.randint(1, 3)):
        place = draw.choice(_places(tables))
        keys = sorted(place) if isinstance(place, dict) else list(range(len(place)))
        key, kind = draw.choice(keys) if keys else None, draw.choice(["other", "other", "other", "lost", "added", "doubled"])
        if key is None or kind == "added":
            _add(place, draw)
        elif kind == "lost":
            del place[key]
        else:
            place[key] = _another(place[key], draw) if kind == "other" else [place[key]] * draw.choice([2, 50])
    return tables


def _another(old: Any, draw: Random) -> Any:
    """Mostly the same quantity, larger or smaller, which a model may take; else anything."""
    number = NUMBER.match(old) if isinstance(old, str) else None
    if number is None or draw.random() < 0.3:
        return old * math.exp(draw.gauss(0, 1)) if isinstance(old, float) and draw.random() < 0.7 else value(draw)
    return f"{float(number[0]) * math.exp(draw.gauss(0, 1.5)):.4g}{old[number.end() :]}"


def _add(place: Any, draw: Random) -> None:
    if isinstance(place, list):
        place.append(value(draw))
    else:
        place[draw.choice(["a", "", "x.y", "é", "youngs_modulus", "surface"])] = value(draw)


def _places(data: Any) -> list[Any]:
    """All tables and lists."""
    if not isinstance(data, dict | list):
        return []
    parts = data.values() if isinstance(data, dict) else data
    return [data, *(place for part in parts for place in _places(part))]


def garble(content: bytes, draw: Random) -> bytes:
    """Bytes cut, overwritten in places, doubled, in another encoding, with long runs, or any at all."""
    kind, offset = (
        draw.choice(["cut", "other", "other", "flip", "doubled", "utf-16", "run", "any"]),
        draw.randint(0, len(content)),
    )
    if kind == "cut":
        return content[:offset]
    if kind == "other":
        return content[:offset] + draw.randbytes(draw.randint(0, 20)) + content[offset + draw.randint(0, 20) :]
    if kind == "flip":
        return (
            content[:offset]
            + bytes(byte ^ (1 << draw.randint(0, 7)) for byte in content[offset : offset + 1])
            + content[offset + 1 :]
        )
    if kind == "doubled":
        return content + content
    if kind == "utf-16":
        return content.decode("latin-1").encode("utf-16")
    if kind == "run":
        return content[:offset] + draw.choice(RUNS) * draw.choice([30, 3000]) + content[offset:]
    return draw.randbytes(draw.randint(0, 300))
