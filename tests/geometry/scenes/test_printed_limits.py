"""What a refusal says is allowed is allowed: the limit that it prints, fed back, is taken."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry import InputError, scene_from_dict
from geometry.scenes import probe as probes
from geometry.scenes import scene as scenes
from geometry.scenes.base_sizes import find_base_sizes
from geometry.scenes.units import Quantity

MATERIAL = {"youngs_modulus": "10 kPa", "poisson_ratio": 0.4}
SPHERE = {"diameter": "8 mm", "depth": "9 mm", **MATERIAL}
PATTERN = re.compile(r"(above|below|less than|at least)[^0-9]*?(?:inner_radius \+ gap = )?([0-9.e+-]+) mm")
BEYOND = 1e-8  # relative; what is above or below a limit is not the limit itself, and a wall has some thickness
SIDES = {"above": 1 + BEYOND, "below": 1 - BEYOND, "less than": 1 - BEYOND, "at least": 1.0}
LENGTHS = st.floats(0.1, 9.0)  # mm, of any digits


def tables(radius: float, gap: float, ratio: float) -> dict[str, Any]:
    probe = {"inner_radius": f"{radius!r} mm", "gap": f"{gap!r} mm", "area_ratio": ratio, "height": "5 mm"}
    tissue = {"shape": "cylinder", "radius": "200 mm", "depth": "60 mm", **MATERIAL}
    return {"probe": probe | {"inner": MATERIAL, "outer": MATERIAL}, "tissue": tissue, "load": {"force": "0.1 N"}}


def block(data: dict[str, Any]) -> None:
    data["tissue"] = {"shape": "block", "length": "300 mm", "breadth": "200 mm", "depth": "60 mm", **MATERIAL}


def with_sphere(data: dict[str, Any]) -> None:
    data["inclusion"] = [dict(SPHERE)]


def with_ellipsoid(data: dict[str, Any]) -> None:
    body = {"diameters": ["8 mm", "5.3 mm", "3.1 mm"], "orientation": [20, 33.3, 47], "depth": "9 mm", **MATERIAL}
    data["inclusion"] = [body]


def with_groove(data: dict[str, Any]) -> None:
    data["probe"]["groove"] = {"width": "0.1 um", "depth": "1 um"}


def with_outer_radius(data: dict[str, Any]) -> None:
    del data["probe"]["area_ratio"]


def nothing(data: dict[str, Any]) -> None:
    pass


Case = tuple[Callable[[dict[str, Any]], None], str, str]
CASES: dict[str, Case] = {  # what is added to the scene, a key, and a value that is refused
    "narrow cylinder": (nothing, "tissue.radius", "1e-3 mm"),
    "a wide gap": (nothing, "probe.gap", "300 mm"),
    "short block": (block, "tissue.length", "1e-3 mm"),
    "beside a cylinder": (nothing, "placement.x", "199.9999999 mm"),
    "beside a block": (block, "placement.y", "99.9999999 mm"),
    "out of the surface": (with_sphere, "inclusion.0.depth", "1 mm"),
    "an ellipsoid out of the surface": (with_ellipsoid, "inclusion.0.depth", "1 um"),
    "out of the bottom": (with_sphere, "inclusion.0.depth", "60 mm"),
    "an ellipsoid out of the bottom": (with_ellipsoid, "inclusion.0.depth", "60 mm"),
    "a wide groove": (with_groove, "probe.groove.width", "5000 mm"),
    "a deep groove": (with_groove, "probe.groove.depth", "5000 mm"),
    "no wall": (with_outer_radius, "probe.outer_radius", "1e-3 mm"),
    "a narrow flange": (nothing, "probe.base.flange_radius", "1e-3 mm"),
}


def put(data: dict[str, Any], key: str, value: str) -> dict[str, Any]:
    new = copy.deepcopy(data)
    place: Any = new
    *path, last = key.split(".")
    for part in path:
        place = place[int(part)] if isinstance(place, list) else place.setdefault(part, {"rigid": True} if part == "base" else {})
    place[last] = value
    return new


def read(data: dict[str, Any]) -> None:
    find_base_sizes(scene_from_dict(data).probe)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
@given(radius=LENGTHS, gap=LENGTHS, ratio=st.floats(0.05, 20))
def test_the_printed_length_is_taken(case: Case, radius: float, gap: float, ratio: float) -> None:
    change, key, value = case
    data = tables(radius, gap, ratio)
    change(data)
    with pytest.raises(InputError) as fault:
        read(put(data, key, value))
    match = PATTERN.search(fault.value.allowed)
    assert match is not None, fault.value
    allowed = float(match[2]) * SIDES[match[1]]
    read(put(data, key, f"{allowed!r} mm"))


QUANTITIES = {
    id(note): note
    for module in (probes, scenes)
    for kind in vars(module).values()
    for note in (kind, *get_args(kind))
    if isinstance(note, Quantity)
}


@pytest.mark.parametrize("quantity", QUANTITIES.values(), ids=lambda item: item.name)
def test_the_ends_of_a_printed_range_are_taken(quantity: Quantity) -> None:
    match = re.search(r"from (.+) to (.+)$", quantity.allowed)
    assert match is not None
    assert [quantity.parse(text) for text in match.groups()] == [quantity.low, quantity.high]
