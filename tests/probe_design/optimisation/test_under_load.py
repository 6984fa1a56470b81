"""Designs under more load than linear elasticity answers for, against references with finite strain and contact."""

from __future__ import annotations

import json
import math

import pytest

from geometry import Load, Scene
from probe_design.optimisation.candidate import Candidate, candidate
from probe_design.optimisation.loaded_candidate import asks_for_contact, under_load
from probe_design.optimisation.objective import Noise
from tests.support.load_paths import FOLDER, scene_of

NOISE = Noise()
EXPECTED = json.loads((FOLDER / "expected.json").read_text())


def loaded(name: str, force: float) -> tuple[Candidate, Candidate]:
    """A reference's probe under a force, judged linearly as far as that goes and by contact."""
    scene = scene_of(name).model_copy(update={"load": Load(force=force)})
    one = candidate(Scene.model_validate(scene), NOISE, "axisymmetric")
    return one, under_load(one, NOISE)


def sd(row: dict[str, float], scene: Scene) -> float:
    """PHYSICS.md, section 2: sqrt(v_inner + v_outer) / S, v = g^2 + (q0 / Q)^2, Q = 20 pC/N times the film's force."""
    share = row["ratio"] * scene.probe.inner_area / (row["ratio"] * scene.probe.inner_area + scene.probe.outer_area)
    gain = 0.05**2  # of the ratio, both channels together
    charges = [20e-12 * row["force"] * part for part in (share, 1 - share)]
    return math.sqrt(gain + sum((0.01e-12 / charge) ** 2 for charge in charges)) / row["log_sensitivity"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "k"), [("example", 3), ("equal-blocks-6kpa", 3)])
def test_contact_judges_what_linear_elasticity_does_not_answer_for(name: str, k: int) -> None:
    row = EXPECTED[name]["rows"][k]
    linear, found = loaded(name, row["force"])
    assert linear.pressing.by != "scene"
    assert found.judged.evaluator == "contact"
    assert (found.pressing.by, found.pressing.force) == ("scene", row["force"])
    unsure = row["log_sensitivity_unc"] / row["log_sensitivity"] + 0.01
    assert found.least * (1 - unsure) <= sd(row, found.scene) <= found.most * (1 + unsure)
    assert found.beats(linear)  # pressing harder tells more


@pytest.mark.slow
def test_beyond_closure_the_gap_is_kept_open() -> None:
    closure, unsure = (EXPECTED["paper"][key] for key in ("gap_closure_force", "gap_closure_force_unc"))
    linear, found = loaded("paper", 1.5 * closure)
    assert found.pressing.by == "gap closure"
    assert found.pressing.load.force == found.pressing.force
    assert linear.pressing.force < found.pressing.force < closure
    assert found.pressing.force == pytest.approx(0.9 * closure, rel=0.05 + unsure / closure)


def test_a_small_load_asks_for_no_contact() -> None:
    one, same = loaded("example", 0.01)
    assert not asks_for_contact(one)
    assert same is one
