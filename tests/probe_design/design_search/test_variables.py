"""The limits of designs: what a workshop can make, none hanging on another, all printed, the active ones marked."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import InputError, read_scene
from probe_design.data.builtin import read_builtin_scene
from probe_design.design_search.closed_search import screen
from probe_design.design_search.variables import ProbeSizes
from tests.support.paths import SCENE
from tests.support.program import run
from tests.support.scenes import nodule
from tests.support.searches import build_space


def test_rounding_keeps_the_limit() -> None:
    space = build_space(read_builtin_scene(), 8.013e-3)
    made = space.build_scene(np.array([3.5266e-3, 0.24353, 1.004e-4, 1.6028e-3, 98765.0, 12345.0])).probe
    assert (made.inner_radius, made.gap, made.height) == (3.53e-3, 1e-4, 1.6e-3)
    assert made.tube_radius <= 8.013e-3
    assert made.tube_radius * 1e5 == pytest.approx(round(made.tube_radius * 1e5), abs=1e-9)
    assert (made.inner.youngs_modulus, made.outer.youngs_modulus) == (98800.0, 12300.0)


def test_rounding_thins_no_wall_of_the_least_thickness() -> None:
    space = build_space(read_scene(SCENE), 8e-3)
    inner, gap, outer = 4.596e-3, 0.5e-3, 5.5965e-3
    design = np.array([inner, inner**2 / (outer**2 - (inner + gap) ** 2), gap, 1.63e-3, 1e6, 6.85e5])
    assert space.admits(design)
    made = space.build_scene(design).probe
    assert (made.inner_radius, made.tube_radius) == (4.59e-3, 5.59e-3)
    assert made.tube_radius - made.hole_radius >= space.wall * (1 - 1e-9)


def test_a_tighter_limit_takes_designs_away_and_brings_none() -> None:
    """Bounds, what is screened, and the search itself, on a small probe over a shallow nodule."""
    start = nodule()
    wide = build_space(start, 12e-3)
    for limit in (1.101e-3, 2.5e-3, 4e-3, 6.3e-3):
        tight = build_space(start, limit)
        assert np.all(tight.low == wide.low)
        assert np.all(tight.high[1:] == wide.high[1:])
        assert tight.wall == wide.wall
        screened = {tuple(design) for design in screen(tight, 512).T}
        within = [design for design in screen(wide, 512).T if ProbeSizes.from_vector(design).outer_radius <= limit]
        assert screened == set(map(tuple, within))
        assert all(np.all((tight.low <= design) & (np.array(design) <= tight.high)) for design in screened)


def test_limits_say_which_are_active() -> None:
    scene = read_builtin_scene()
    space = build_space(scene, 8e-3)
    x = np.array([3.5e-3, 0.25, 0.1e-3, 1.25e-3, 1e6, 5e5])
    made = space.build_scene(x)
    limits = {limit.name: limit for limit in space.list_limits(made)}
    assert {name for name, limit in limits.items() if limit.active} == {"least gap", "least height", "largest inner_modulus"}
    assert limits["least height"].value == pytest.approx(1.25e-3)  # the groove's depth is 1 mm
    assert limits["largest outer_radius"].value == 8e-3
    assert limits["least outer_modulus"].value == 100.0  # the start's own
    assert len(limits) == 13


def test_help_and_table_print_the_limits() -> None:
    text = run("optimize", "--help").stdout
    space = build_space(read_scene(SCENE))
    for words in ("0.5 mm or more", "0.05 to 20", "0.1 mm to 0.5 mm", "1 mm to 20 mm", "10 kPa to 1 MPa"):
        assert words in text
    assert space.low == pytest.approx([0.5e-3, 0.05, 0.1e-3, 1e-3, 10e3, 10e3])
    assert space.high[1:] == pytest.approx([20, 0.5e-3, 20e-3, 1e6, 1e6])
    assert space.wall == 0.5e-3


def test_no_room_is_refused() -> None:
    with pytest.raises(InputError, match="outer_radius"):
        build_space(read_builtin_scene(), 1e-3)
