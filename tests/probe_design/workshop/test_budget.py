"""What the ratio leaves the dimensions, against another evaluator's finite differences and the rule of shares."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.workshop.package import build_writers
from geometry.workshop.tolerance import Budget
from probe_design.tolerancing.budget import compute_budget
from probe_design.workshop.ratio_budget import compute_ratio_budget
from solver import evaluate
from tests.support import paths

SCENE = read_scene(paths.SCENE)
RADII = {"inner_radius": 4.0, "hole_radius": 4.1, "outer_radius": math.sqrt(4.1**2 + 16 / 1.2)}
SIZES = {**RADII, "inner_height": 3.0, "outer_height": 3.0}  # mm


@pytest.fixture(scope="module")
def budget() -> Budget:
    return compute_ratio_budget(SCENE, 0.01)


def ratio(**sizes: float) -> float:
    """By the closed form, sizes in mm."""
    lengths = {name: size * 1e-3 for name, size in (SIZES | sizes).items()}
    lengths["gap"] = lengths.pop("hole_radius") - lengths["inner_radius"]
    probe = SCENE.probe.model_copy(update={**lengths, "area_ratio": None, "height": None})
    result_ratio = evaluate(SCENE.model_copy(update={"probe": probe}), "closed-form").ratio
    assert result_ratio is not None
    return result_ratio


@pytest.mark.parametrize("name", SIZES)
def test_sensitivities_are_those_of_one_size_alone(budget: Budget, name: str) -> None:
    """The hole's at a fixed inner radius and the other way round, which the gap's and the radius's in the scene are not."""
    low, high = (ratio(**{name: SIZES[name] * (1 + sign * 1e-4)}) for sign in (-1, 1))
    wanted = math.log(high / low) / 2e-4
    assert budget.sensitivities[name] == pytest.approx(wanted, rel=0.1, abs=0.05)  # levels differ by some percent


def test_all_that_is_held_stays_within_what_was_asked(budget: Budget) -> None:
    """As standard deviations, sqrt(3) below the deviations; the moduli and gains of the budget take the rest."""
    parts = [budget.sensitivities[name] * budget.deviations[name] / SIZES[name] / math.sqrt(3) for name in SIZES]
    assert 0.001 < math.sqrt(sum(part**2 for part in parts)) <= 0.01 * 1.001
    assert min(budget.deviations.values()) > 0


def test_a_scene_that_nobody_differentiates_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InputError("contact.interface", "unilateral", "bonded")

    monkeypatch.setattr("probe_design.workshop.ratio_budget.compute_budget", refuse)
    budget = compute_ratio_budget(SCENE, 0.01)
    assert budget.deviations == {}
    assert budget.remark.startswith("No dimension is bound by the ratio: contact.interface = ")


def test_round_edges_are_told_and_bound_as_sharp_ones(budget: Budget) -> None:
    round_edges = SCENE.model_copy(update={"contact": SCENE.contact.model_copy(update={"edge_radius": 1e-4})})
    edged = compute_ratio_budget(round_edges, 0.01)
    assert edged.deviations == pytest.approx(budget.deviations, rel=1e-9)
    assert "sharp lower edges" in edged.remark


def test_the_drawings_and_the_uncertainty_budget_agree(tmp_path: Path) -> None:
    """One computation: what the parts' drawings make of the ratio is what `tolerances` says, moduli and gains included."""
    tables = SCENE.model_dump(exclude_unset=True)
    tables["probe"]["outer"] = {"material": "ecoflex-00-50"}
    named = Scene.model_validate(tables)
    budget, tolerance_budget = compute_ratio_budget(named, 0.01), compute_budget(named, samples=64)
    build_writers(named.probe, 0.0, budget)["tolerances.csv"](tmp_path / "tolerances.csv")
    with (tmp_path / "tolerances.csv").open(encoding="utf-8") as file:
        parts = {row["quantity"]: float(row["ratio_percent"]) for row in csv.DictReader(file) if row["ratio_percent"]}
    assert math.hypot(*parts.values()) == pytest.approx(100 * tolerance_budget.outputs["ln_ratio"].sd, rel=5e-3)  # three digits
    largest = tolerance_budget.lines[0]
    assert largest.name == max(parts, key=parts.__getitem__) == "probe.outer.youngs_modulus"
    assert parts[largest.name] == pytest.approx(100 * largest.outputs["ln_ratio"].contribution, rel=5e-3)


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0, math.nan])
def test_impossible_ratios_are_refused(share: float) -> None:
    with pytest.raises(InputError, match=r"^tolerance = "):
        compute_ratio_budget(SCENE, share)
