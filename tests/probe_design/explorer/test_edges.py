"""Dragging an edge of a block moves this edge alone; a design that another scene states is taken over."""

from __future__ import annotations

import math

import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene_file import read_scene
from probe_design.explorer.edges import HEIGHTS, RADII, find_edge_changes, list_edges
from probe_design.explorer.session import Session
from tests.support.paths import ROOT

EXAMPLE = read_scene(ROOT / "examples" / "scene.toml")


@pytest.mark.parametrize("name", [*RADII, *HEIGHTS])
def test_an_edge_follows_the_pointer_and_the_others_stay(name: str) -> None:
    session = Session(EXAMPLE)
    before = list_edges(EXAMPLE)
    x, depth = before[name][0] + 0.04, before[name][1] - 0.3
    session.change(find_edge_changes(session.scene, name, x, depth))
    after = list_edges(session.scene)
    for other, line in before.items():
        expected = list(line)
        if other == name and name in RADII:
            expected[0] = x
        if name in HEIGHTS:  # the example's blocks have one height
            expected[1], expected[3] = depth, -depth if other in RADII else 0.0
        elif other in HEIGHTS:  # tops reach from edge to edge
            continue
        assert after[other] == pytest.approx(expected, abs=1e-4)


def test_edges_are_refused_beyond_the_next_one() -> None:
    for name, x in (("inner", 100.0), ("hole", 0.0), ("outer", 0.1), ("elsewhere", 1.0), ("inner", math.nan)):
        with pytest.raises(InputError):
            find_edge_changes(EXAMPLE, name, x, 0.0)


def test_a_scene_by_other_keys_is_adopted() -> None:
    inner, outer = 1.2 * EXAMPLE.probe.inner_radius, 1.1 * EXAMPLE.probe.tube_radius
    probe = EXAMPLE.probe.model_copy(update={"inner_radius": inner, "area_ratio": None, "outer_radius": outer})
    session = Session(EXAMPLE)
    assert session.adopt(EXAMPLE.model_copy(update={"probe": probe})) == []
    assert (session.scene.probe.inner_radius, session.scene.probe.tube_radius) == pytest.approx((inner, outer), rel=1e-5)
    stiff = probe.model_copy(update={"inner": probe.inner.model_copy(update={"poisson_ratio": 0.3})})
    assert session.adopt(EXAMPLE.model_copy(update={"probe": stiff})) == ["probe.inner.poisson_ratio"]
    assert session.undo()
    assert session.undo()
    assert session.scene == EXAMPLE
