"""Rounded designs: every size a multiple of the step, limits held, costs stated; steps that leave nothing are refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from geometry.common.errors import InputError
from geometry.scenes.probe import Base, Groove
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene, scene_from_toml, scene_to_toml
from geometry.scenes.scene_tables import Contact
from probe_design.commands.main import cli
from probe_design.workshop.rounding import add_cost, round_sizes
from solver import evaluate
from tests.support.paths import SCENE

EXAMPLE = read_scene(SCENE)
STEP = 1e-4


def scene(edge: float = 0.0, **sizes: object) -> Scene:
    """The example with other sizes of the probe; ``edge`` is that of its round edges."""
    probe = {**EXAMPLE.probe.model_dump(exclude_unset=True), **sizes}
    probe = {key: value for key, value in probe.items() if value is not None}
    tables = {**EXAMPLE.model_dump(exclude_unset=True), "probe": probe}
    return Scene.model_validate({**tables, "contact": Contact(edge_radius=edge)})


def odd() -> Scene:
    return scene(inner_radius=3.972e-3, gap=0.134e-3, height=3.049e-3, groove=Groove(width=1.04e-3, depth=0.96e-3))


def test_sizes_are_multiples_of_the_step() -> None:
    probe = round_sizes(odd(), STEP).scene.probe
    assert (probe.inner_radius, probe.gap, probe.height) == (4e-3, 1e-4, 3e-3)
    assert probe.groove == Groove(width=1e-3, depth=1e-3)
    assert probe.area_ratio is None
    tube = math.sqrt(4.106**2 + 3.972**2 / 1.2)  # Ro^2 = hole^2 + r2^2 / (A2/A1), mm
    assert probe.outer_radius == pytest.approx(round(tube, 1) * 1e-3, rel=1e-12)
    assert probe.base.thickness == pytest.approx(round(0.3 * tube, 1) * 1e-3, rel=1e-12)


def test_what_changed_is_told_and_nothing_else() -> None:
    changes = {change.key: (change.before, change.after) for change in round_sizes(odd(), STEP).changes}
    assert changes["probe.gap"] == (0.134e-3, 1e-4)
    assert {"probe.inner_radius", "probe.outer_radius", "probe.height", "probe.groove.width"} <= changes.keys()
    repeated = round_sizes(round_sizes(odd(), STEP).scene, STEP)
    assert repeated.changes == ()


def test_the_rounded_scene_is_a_file() -> None:
    new = round_sizes(odd(), STEP).scene
    assert scene_from_toml(scene_to_toml(new)) == new


@pytest.mark.parametrize(("wall", "min_wall"), [(0.52e-3, 0.5e-3), (0.23e-3, 0.23e-3), (0.501e-3, 0.5e-3)])
def test_the_wall_keeps_its_limit(wall: float, min_wall: float) -> None:
    """By nearest multiples it would come out thinner."""
    probe = round_sizes(scene(inner_radius=4.05e-3, gap=0.15e-3, area_ratio=None, outer_radius=4.2e-3 + wall), STEP).scene.probe
    assert probe.tube_radius - probe.hole_radius >= min_wall * (1 - 1e-9)


@given(
    radius=st.floats(0.3e-3, 9e-3), gap=st.floats(0.5e-4, 1e-3), wall=st.floats(0.06e-3, 3e-3), height=st.floats(0.4e-3, 9e-3),
    depth=st.floats(0.3, 0.9), step=st.sampled_from([1e-5, 2e-5, 5e-5, 1e-4]),
)  # fmt: skip
def test_any_design_stays_one(radius: float, gap: float, wall: float, height: float, depth: float, step: float) -> None:
    cut, outer = Groove(width=radius, depth=depth * height), radius + gap + wall
    start = scene(inner_radius=radius, gap=gap, area_ratio=None, outer_radius=outer, height=height, groove=cut)
    probe = round_sizes(start, step).scene.probe
    assert probe.groove is not None
    for size in (probe.inner_radius, probe.gap, probe.tube_radius, probe.core_height, probe.groove.width, probe.groove.depth):
        assert size / step == pytest.approx(round(size / step), abs=1e-6)
        assert size > 0
    assert abs(probe.inner_radius - radius) <= step / 2 * (1 + 1e-9)
    assert abs(probe.gap - gap) <= step / 2 * (1 + 1e-9)
    assert probe.tube_radius - probe.hole_radius >= min(wall, 0.5e-3) * (1 - 1e-6)


@pytest.mark.parametrize(
    ("step", "sizes", "reason"),
    [
        (1e-3, {}, r"step = 1 mm: allowed: at most 0\.2 mm: probe\.gap is 0\.1 mm"),
        (1e-4, {"gap": 4e-5}, r"at most 0\.08 mm: probe\.gap is 0\.04 mm"),
        (
            1e-4,
            {"height": 1.2e-4, "groove": Groove(width=1e-3, depth=1e-4)},
            r"a step below 0\.1 mm, so that probe\.groove\.depth",
        ),
        (0.0, {}, r"^step = "),
        (math.nan, {}, r"^step = "),
    ],
)
def test_steps_that_leave_nothing_are_refused(step: float, sizes: dict[str, object], reason: str) -> None:
    with pytest.raises(InputError, match=reason) as fault:
        round_sizes(scene(**sizes), step)
    assert fault.value.exit_code == 2


def test_a_flange_stays_wider_than_the_tube_and_a_groove_above_the_round_edges() -> None:
    flange = Base(rigid=True, flange_radius=5.53e-3, step_height=1.04e-3)
    probe = round_sizes(scene(0.4e-3, base=flange, groove=Groove(width=1e-3, depth=2.56e-3)), STEP).scene.probe
    assert probe.base.flange_radius is not None
    assert probe.base.flange_radius >= probe.tube_radius
    assert probe.groove is not None
    assert probe.groove.depth < 2.6e-3


@pytest.mark.slow
def test_the_cost_is_what_the_evaluator_says_of_both() -> None:
    start = scene(inner_radius=3.972e-3, gap=0.134e-3, height=3.049e-3)
    cost = add_cost(round_sizes(start, STEP), start)
    for built, reading in ((start, cost.before), (round_sizes(start, STEP).scene, cost.after)):
        direct = evaluate(built, "axisymmetric", 1e-3)
        assert reading is not None
        assert reading.ratio == pytest.approx(direct.ratio, rel=2e-3)
        assert reading.log_sensitivity == pytest.approx(direct.log_sensitivity, rel=1e-2)


def test_a_step_that_is_refused_leaves_no_files(tmp_path: Path) -> None:
    ended = CliRunner().invoke(cli, ["export", str(SCENE), "-o", str(tmp_path), "--step", "2 mm"])
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception) == "step = 2 mm: allowed: at most 0.2 mm: probe.gap is 0.1 mm"
    assert list(tmp_path.iterdir()) == []
