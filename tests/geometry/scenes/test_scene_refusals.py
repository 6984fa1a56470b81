"""What a scene file may not state: each refusal is one line that names the key, the value and what is allowed."""

from __future__ import annotations

import copy
import re
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import InputError, Scene, scene_from_dict, scene_from_toml

MATERIAL = {"youngs_modulus": "10 kPa", "poisson_ratio": 0.4}
BASE: dict[str, Any] = {
    "probe": {
        "inner_radius": "5 mm",
        "area_ratio": 3.7,
        "gap": "0.1 mm",
        "height": "5 mm",
        "inner": MATERIAL,
        "outer": MATERIAL,
        "base": {"rigid": True},
        "groove": {"width": "2 mm", "depth": "1 mm"},
        "film": {"thickness": "110 um"},
    },
    "tissue": {"shape": "cylinder", "radius": "45 mm", "depth": "60 mm", **MATERIAL},
    "inclusion": [{"diameter": "8 mm", "depth": "6 mm", **MATERIAL}],
    "contact": {"interface": "bonded"},
    "placement": {"x": "0 mm"},
    "load": {"indentation": "5 um"},
}
LENGTH = r"a length with its unit, such as '5 mm', from 1e-06 mm to 10000 mm"
NUMBER = r"a number from 0 to below 0.5"
REMOVED = object()
HUGE = 16**5000  # as TOML takes it in hexadecimal: more digits than Python writes


def edited(changes: dict[str, Any]) -> dict[str, Any]:
    """Return the tables with the values at dotted keys replaced, or removed."""
    tables = copy.deepcopy(BASE)
    for path, value in changes.items():
        *parents, last = path.split(".")
        table: Any = tables
        for key in parents:
            table = table[int(key)] if isinstance(table, list) else table.setdefault(key, {})
        if value is REMOVED:
            del table[last]
        else:
            table[int(last) if isinstance(table, list) else last] = value
    return tables


def refused(tables: dict[str, Any]) -> str:
    with pytest.raises(InputError) as fault:
        scene_from_dict(tables)
    assert str(fault.value).isprintable()
    assert fault.value.exit_code == 2
    return str(fault.value)


def test_base_is_accepted() -> None:
    assert isinstance(scene_from_dict(BASE), Scene)
    assert scene_from_toml(tomli_w.dumps(BASE)) == scene_from_dict(BASE)


CASES: list[tuple[str, object, str]] = [
    # quantities
    ("probe.gap", "5 kPa", f"probe.gap = '5 kPa': allowed: {LENGTH} ('kPa' is no unit that converts to m)"),
    ("probe.gap", "0.1", f"probe.gap = '0.1': allowed: {LENGTH} (the unit is missing)"),
    ("probe.gap", 0.1, f"probe.gap = 0.1: allowed: {LENGTH} (the unit is missing)"),
    ("probe.gap", 1, f"probe.gap = 1: allowed: {LENGTH} (the unit is missing)"),
    ("probe.gap", "-0.1 mm", f"probe.gap = '-0.1 mm': allowed: {LENGTH} (out of range)"),
    ("probe.gap", "0 mm", f"probe.gap = '0 mm': allowed: {LENGTH} (out of range)"),
    ("probe.gap", "1e-300 mm", f"probe.gap = '1e-300 mm': allowed: {LENGTH} (out of range)"),
    ("probe.height", "0 mm", f"probe.height = '0 mm': allowed: {LENGTH} (out of range)"),
    ("probe.height", "5 light_year", f"probe.height = '5 light_year': allowed: {LENGTH} ('light_year' is no unit)"),
    ("probe.inner_radius", "nan mm", f"probe.inner_radius = 'nan mm': allowed: {LENGTH} (not a finite number)"),
    ("probe.inner_radius", float("nan"), f"probe.inner_radius = nan: allowed: {LENGTH} (the unit is missing)"),
    ("probe.inner_radius", "inf mm", f"probe.inner_radius = 'inf mm': allowed: {LENGTH} (not a finite number)"),
    ("probe.inner_radius", True, f"probe.inner_radius = true: allowed: {LENGTH} (not a quantity)"),
    ("probe.inner_radius", ["5 mm"], f"probe.inner_radius = ['5 mm']: allowed: {LENGTH} (not a quantity)"),
    ("probe.inner_radius", HUGE, f"probe.inner_radius = <20001 bits>: allowed: {LENGTH} (the unit is missing)"),
    ("tissue.depth", "1 km", f"tissue.depth = '1 km': allowed: {LENGTH} (out of range)"),
    ("tissue.youngs_modulus", "-1 Pa", "tissue.youngs_modulus = '-1 Pa': allowed: a modulus with its unit"),
    ("tissue.youngs_modulus", "1e300 Pa", "tissue.youngs_modulus = '1e300 Pa': allowed: a modulus with its unit"),
    ("load.indentation", "-5 um", "load.indentation = '-5 um': allowed: an indentation with its unit, such as '5 mm', from 0"),
    ("placement.tilt", 3, "placement.tilt = 3: allowed: an angle with its unit, such as '5 deg', from -89 deg to 89 deg"),
    ("placement.tilt", "3", "placement.tilt = '3': allowed: an angle with its unit, such as '5 deg', from -89 deg to 89 deg"),
    ("placement.tilt", "90 deg", "placement.tilt = '90 deg': allowed: an angle with its unit"),
    ("inclusion.0.x", "20 m", "inclusion[0].x = '20 m': allowed: a position with its unit, such as '5 mm', from -10000 mm"),
    ("probe.film.d33", "20 pC", "probe.film.d33 = '20 pC': allowed: a charge per force with its unit, such as '5 pC/N'"),
    # numbers
    ("tissue.poisson_ratio", 0.5, f"tissue.poisson_ratio = 0.5: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", -0.1, f"tissue.poisson_ratio = -0.1: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", "0.3", f"tissue.poisson_ratio = '0.3': allowed: {NUMBER}"),
    ("tissue.poisson_ratio", True, f"tissue.poisson_ratio = true: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", float("nan"), f"tissue.poisson_ratio = nan: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", float("-inf"), f"tissue.poisson_ratio = -inf: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", {}, f"tissue.poisson_ratio = {{}}: allowed: {NUMBER}"),
    ("tissue.poisson_ratio", HUGE, f"tissue.poisson_ratio = <20001 bits>: allowed: {NUMBER}"),
    ("probe.inner.poisson_ratio", REMOVED, f"probe.inner.poisson_ratio = missing: allowed: {NUMBER}"),
    ("probe.area_ratio", 0, "probe.area_ratio = 0: allowed: a number from 1e-4 to 1e4"),
    ("probe.area_ratio", 10**400, "probe.area_ratio = 10000"),
    ("probe.film.psi1", 101, "probe.film.psi1 = 101: allowed: a number from -100 to 100"),
    ("contact.friction", -1, "contact.friction = -1: allowed: a number from 0 to 100"),
    # words
    ("contact.interface", "glued", "contact.interface = 'glued': allowed: 'bonded', 'frictionless' or 'unilateral'"),
    ("contact.interface", [], "contact.interface = []: allowed: 'bonded', 'frictionless' or 'unilateral'"),
    ("tissue.shape", "cube", "tissue.shape = 'cube': allowed: 'cylinder', 'block' or 'half-space'"),
    ("tissue.shape", REMOVED, "tissue.shape = missing: allowed: 'cylinder', 'block' or 'half-space'"),
    ("tissue.shape", HUGE, "tissue.shape = <20001 bits>: allowed: 'cylinder', 'block' or 'half-space'"),
    ("tissue.shape", ["block"], "tissue.shape = ['block']: allowed: 'cylinder', 'block' or 'half-space'"),
    ("probe.base.rigid", "yes", "probe.base.rigid = 'yes': allowed: true or false"),
    ("inclusion.0.target", 1, "inclusion[0].target = 1: allowed: true or false"),
    # tables
    ("probe", 5, "probe = 5: allowed: a table, [probe]"),
    ("probe", REMOVED, "probe = missing: allowed: a table, [probe]"),
    ("probe.inner", "rubber", "probe.inner = 'rubber': allowed: a table, [probe.inner]"),
    ("probe.groove", [], "probe.groove = []: allowed: a table, [probe.groove]"),
    ("tissue", 5, "tissue = 5: allowed: a table, [tissue]"),
    ("tissue", [], "tissue = []: allowed: a table, [tissue]"),
    ("load", REMOVED, "load = missing: allowed: a table, [load]"),
    ("load", "5 N", "load = '5 N': allowed: a table, [load]"),
    ("inclusion", MATERIAL, "inclusion = {'poisson_ratio': 0.4, 'youngs_modulus': '10 kPa'}: allowed: up to 1000 tables, eac"),
    ("inclusion", "one", "inclusion = 'one': allowed: up to 1000 tables, each headed [[inclusion]]"),
    ("inclusion.0", 1, "inclusion[0] = 1: allowed: up to 1000 tables, each headed [[inclusion]]"),
    ("inclusion", BASE["inclusion"] * 1001, "inclusion = [{'depth': '6 mm', 'diameter': '8 mm', 'poisson_ratio': 0.4"),
    # unknown keys
    ("prob", {}, "prob = {}: allowed: one of probe, tissue, inclusion, contact, placement, load"),
    ("probe.raduis", "5 mm", "probe.raduis = '5 mm': allowed: one of inner_radius, area_ratio, outer_radius, gap, height"),
    ("probe.größe", 1, "probe.größe = 1: allowed: one of inner_radius"),
    ("probe.inner.E", 1, "probe.inner.E = 1: allowed: one of youngs_modulus, poisson_ratio"),
    ("tissue.length", "1 mm", "tissue.length = '1 mm': allowed: one of youngs_modulus, poisson_ratio, loss_factor, material"),
    ("inclusion.0.radius", "1 mm", "inclusion[0].radius = '1 mm': allowed: one of youngs_modulus, poisson_ratio, loss"),
    ("probe.\x1b[31m\x07\u202e", HUGE, "probe.\\x1b[31m\\x07\\u202e = <20001 bits>: allowed: one of inner_radius"),
    ("probe.a\nb", 1, "probe.a b = 1: allowed: one of inner_radius"),
    ("probe." + "k" * 5000, 1, "probe.kkkkkkkk"),
    # one of several
    ("probe.outer_radius", "9 mm", "probe.area_ratio = 3.7 and outer_radius = 9 mm: allowed: exactly one of area_ratio and o"),
    ("probe.area_ratio", REMOVED, "probe.area_ratio = missing: allowed: exactly one of area_ratio and outer_radius"),
    ("probe.inner_height", "5 mm", "probe.height = 5 mm and inner_height = 5 mm: allowed: either height, or both inner_height"),
    ("probe.height", REMOVED, "probe.height = missing: allowed: either height, or both inner_height and outer_height"),
    ("load.force", "1 N", "load.force = 1 N and indentation = 5e-06 m: allowed: exactly one of force and indentation"),
    ("load.indentation", REMOVED, "load.force = missing: allowed: exactly one of force and indentation"),
    ("probe.base", {}, "probe.base.rigid = neither true nor elastic: allowed: rigid = true, or both youngs_modulus and poiss"),
    ("probe.base.youngs_modulus", "1 GPa", "probe.base.rigid = true beside moduli: allowed: either rigid = true, or"),
    ("contact.friction", 0.3, "contact.friction = 0.3: allowed: 0 unless interface = 'unilateral'"),
    ("inclusion.0.diameter", REMOVED, "inclusion[0].diameter = missing: allowed: exactly one of diameter, diameters and surf"),
    ("inclusion.0.surface", "a.stl", "inclusion[0].diameter = given beside surface: allowed: exactly one of diameter"),
    ("inclusion.0.surface", "", "inclusion[0].surface = '': allowed: the name of an STL or STEP file"),
    ("inclusion.0.surface", "a\x00b", "inclusion[0].surface = 'a\\x00b': allowed: the name of an STL or STEP file"),
    # triples
    ("inclusion.0.diameters", "8 mm", "inclusion[0].diameters = '8 mm': allowed: three lengths with their units, ['8 mm', "),
    ("inclusion.0.diameters", ["8 mm"] * 2, "inclusion[0].diameters[2] = missing: allowed: three lengths with their units"),
    ("inclusion.0.diameters", ["8 mm"] * 4, "inclusion[0].diameters = ['8 mm', '8 mm', '8 mm', '8 mm']: allowed: three lengt"),
    ("inclusion.0.diameters", ["8 mm", 8, "8 mm"], f"inclusion[0].diameters[1] = 8: allowed: {LENGTH} (the unit is missing)"),
    ("inclusion.0.orientation", [1, 2], "inclusion[0].orientation[2] = missing: allowed: three numbers from -360 to 360"),
    ("inclusion.0.orientation", ["1", 2, 3], "inclusion[0].orientation[0] = '1': allowed: three numbers from -360 to 360"),
    ("inclusion.0.orientation", [True, 2, 3], "inclusion[0].orientation[0] = true: allowed: three numbers from -360 to 360"),
    ("inclusion.0.orientation", [1, 2, 361], "inclusion[0].orientation[2] = 361: allowed: three numbers from -360 to 360"),
    # the probe's own sizes
    ("probe.groove.width", "10.2 mm", "probe.groove.width = 10.2 mm: allowed: below the outer block's hole diameter of 10.2"),
    ("contact.edge_radius", "-1 mm", "contact.edge_radius = '-1 mm': allowed: "),
    ("contact.edge_radius", 0.1, "contact.edge_radius = 0.1: allowed: "),
    ("contact.edge_radius", "4 mm", "contact.edge_radius = 4 mm: allowed: up to 0.24969 mm (0.4 of the blocks' radius"),
    ("contact.edge_radius", "1 um", "contact.edge_radius = 0.001 mm: allowed: 0, sharp, or 0.01 mm or more"),
    ("probe.groove.depth", "5 mm", "probe.groove.depth = 5 mm: allowed: below the outer block's height of 5 mm"),
]  # fmt: skip
"""Key, value, and how the message begins."""


@pytest.mark.parametrize(("key", "value", "message"), CASES, ids=range(len(CASES)))
def test_one_fault(key: str, value: object, message: str) -> None:
    fault = refused(edited({key: value}))
    assert fault.startswith(message)
    assert len(fault) < 600


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("force", "0.3 N", "; 'force' is a key of [load]"),
        ("layer", [], "; 'layer' is a key of [tissue]"),
        ("load.x", "2 mm", "; 'x' is a key of [inclusion] or [placement]"),
        ("noise", {}, "contact, placement, load, reading"),
    ],
)
def test_a_key_in_the_wrong_table_names_the_right_one(key: str, value: object, message: str) -> None:
    assert refused(edited({key: value})).endswith(message)


def test_outer_radius_within_the_hole() -> None:
    message = refused(edited({"probe.area_ratio": REMOVED, "probe.outer_radius": "5.1 mm"}))
    assert message == "probe.outer_radius = 5.1 mm: allowed: an outer radius, now 5.1 mm, above inner_radius + gap = 5.1 mm"


def test_two_targets() -> None:
    body = BASE["inclusion"][0] | {"target": True}
    message = refused(edited({"inclusion": [body, body | {"x": "20 mm"}]}))
    assert message == "inclusion[1].target = true: allowed: true for one inclusion (it is for inclusion[0])"


def test_an_unknown_key_is_told_before_what_it_left_missing() -> None:
    message = refused(edited({"probe.gap": REMOVED, "probe.gapp": "0.1 mm", "load": REMOVED}))
    assert message.startswith("probe.gapp = '0.1 mm': allowed: one of")


@pytest.mark.parametrize("key", ["probe.gap", "probe", "tissue", "inclusion", "extra", "probe.inner.extra"])
@pytest.mark.parametrize("kind", ["array", "table"])
def test_deep_nesting(key: str, kind: str) -> None:
    deep: Any = 1
    for _ in range(20_000):
        deep = [deep] if kind == "array" else {"a": deep}
    message = refused(edited({key: deep}))
    assert re.match(r"\S+ = [\[{].*\.\.\..*: allowed: |inclusion\[0\]", message) or message.startswith(key)


def test_deep_nesting_as_toml_has_it() -> None:
    text = "\n".join(["[" + ".".join("a" * 60) + "]", ".".join("b" * 60) + " = [1]"])
    with pytest.raises(InputError, match=r"^a = \{'a': .*\.\.\..*: allowed: one of probe, tissue"):
        scene_from_toml(text)


PATHS = [
    *(f"probe.{key}" for key in ("", "inner_radius", "area_ratio", "gap", "height", "inner", "base", "groove", "film", "new")),
    *("probe.inner.youngs_modulus", "probe.inner.poisson_ratio", "probe.base.rigid", "probe.groove.width", "probe.film.d31"),
    *("tissue.", "tissue.shape", "tissue.radius", "tissue.youngs_modulus", "inclusion.", "inclusion.0", "inclusion.0.diameter"),
    *("inclusion.0.diameters", "inclusion.0.orientation", "inclusion.0.surface", "inclusion.0.x", "inclusion.0.target"),
    *("contact.", "contact.interface", "contact.friction", "placement.", "placement.tilt", "load.", "load.force", "new."),
]
LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.builds(lambda: HUGE), st.floats(), st.text(max_size=20), st.dates(), st.times(),
    st.sampled_from(["5 mm", "1 kPa", "3 deg", "block", "half-space", "unilateral", "1e999 m", "0 N"]),
)  # fmt: skip
VALUES = st.recursive(
    LEAVES, lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=8), x, max_size=3), max_leaves=8
)


@given(st.dictionaries(st.sampled_from([path.rstrip(".") for path in PATHS]), VALUES, min_size=1, max_size=3))
@settings(max_examples=600)
def test_any_value_anywhere_is_taken_or_refused_in_one_line(changes: dict[str, Any]) -> None:
    try:
        tables = edited(changes)
    except (AttributeError, TypeError, ValueError, IndexError, KeyError):  # one change took the table that the next needs
        return
    fault = _fault(tables)
    assert fault is None or re.search(r"^.+ = .+: allowed: .+", fault)
    assert fault is None or fault.isprintable()


def _fault(tables: dict[str, Any]) -> str | None:
    try:
        scene_from_dict(tables)
    except InputError as fault:
        return str(fault)
    return None
