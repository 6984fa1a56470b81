"""The design loop: the search, a gain that a second model sees, files that read back."""

from __future__ import annotations

import csv
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from geometry import Load, read_scene, scene_to_toml
from probe_design.data.builtin import read_builtin_scene
from probe_design.design_search.choices import iterate_distinct, search_combinations
from probe_design.design_search.closed_search import screen
from probe_design.design_search.tumour_objective import FiniteElementObjective, Noise
from probe_design.design_search.tumour_study import MIN_LOG_DISTANCE, TumourStudy
from probe_design.design_search.variables import ProbeSizes, read_vector
from probe_design.design_search.verification import verify_tumour_design
from tests.support.paths import REFERENCE
from tests.support.program import Ended, run
from tests.support.references import named
from tests.support.scenes import nodule
from tests.support.slow import slow_unless

NOISE = Noise()


def test_builtin_scene_has_the_papers_numbers() -> None:
    scene = read_builtin_scene()
    probe = scene.probe
    assert (probe.outer.youngs_modulus, probe.inner.youngs_modulus) == (1e2, 1e5)  # E_1, E_2, section 2.1
    assert (probe.outer.poisson_ratio, probe.inner.poisson_ratio) == (0.48, 0.40)
    assert (probe.area_ratio, probe.gap) == (3.7, pytest.approx(1e-4))
    assert (probe.groove.width, probe.groove.depth, probe.film.thickness) == pytest.approx((2e-3, 1e-3, 110e-6))
    assert (scene.tissue.youngs_modulus, scene.tissue.poisson_ratio, scene.tissue.depth) == pytest.approx((1e3, 0.40, 0.06))
    assert (scene.inclusion[0].youngs_modulus, scene.inclusion[0].poisson_ratio) == (1e5, 0.45)
    text = resources.files("probe_design.data").joinpath("builtin.toml").read_text(encoding="utf-8")
    assert all("# (" in line or "# ..." in line for line in text.splitlines() if " = " in line)


def test_search_cost_is_the_closed_forms_objective() -> None:
    scene = named("axisymmetric", "nearly-incompressible").scene
    study = TumourStudy.from_scene(scene)
    design = np.array([3.5e-3, 0.5, 0.2e-3, 5e-3, 3e5, 2e4])  # far from the tissue's sides, as the scene's probe is
    made = study.search_space.build_scene(design)
    assert made is not None
    objective = float(np.exp(-study.objective.evaluate_designs(design[:, None], study.search_space.start_poisson)[0]))
    verified = verify_tumour_design(made, NOISE, "axisymmetric")
    assert objective == pytest.approx(verified.formula_value, rel=2e-3)  # lengths were rounded


def test_gradients_are_those_of_differences() -> None:
    """By formulas and by finite elements, where the load limits the force and where linear elasticity does."""
    scene = named("axisymmetric", "nearly-incompressible").scene
    for force in (1e-4, 10.0):
        study = TumourStudy.from_scene(scene.model_copy(update={"load": Load(force=force)}))
        space, poisson = study.search_space, study.search_space.start_poisson
        design = read_vector(scene, space.names) * np.array([1.0, 1.1, 1.0, 0.9, 1.1, 0.9])
        elements = FiniteElementObjective(study.objective, space, scene, "axisymmetric")
        for objective, step, accuracy in ((study.objective, 1e-4, 1e-4), (elements, 1e-3, 0.01)):
            derivatives = objective.gradient(design, poisson, list(range(len(design))))[1][0]
            for k, derivative in enumerate(derivatives):
                ends = [design * np.exp(sign * step * (np.arange(len(design)) == k)) for sign in (1, -1)]
                upper, lower = (objective.gradient(end, poisson, [k])[0][0] for end in ends)
                assert derivative == pytest.approx(
                    (upper - lower) / (2 * step), rel=accuracy, abs=accuracy * np.abs(derivatives).max()
                )


def test_search_stays_in_bounds_and_finds_better_than_it_screened() -> None:
    study = TumourStudy.from_scene(named("axisymmetric", "nearly-incompressible").scene, 8e-3, starts=2)
    space, poisson = study.search_space, study.search_space.start_poisson
    search = search_combinations(study.objective, study.search_space, lambda done, total: None)
    designs = np.array([choice.design for choice in search.choices]).T
    values = study.objective.evaluate_designs(designs, poisson)
    assert np.all(np.diff(values) <= 0)
    assert values[0] > study.objective.evaluate_designs(screen(space, 512), poisson).max()
    assert np.all(ProbeSizes.from_vector(designs).outer_radius <= 8e-3 * (1 + 1e-6))
    assert np.all((space.low * 0.999 <= designs.T) & (space.high * 1.001 >= designs.T))
    scenes = [scene for _, scene in iterate_distinct(search.choices, study.search_space, MIN_LOG_DISTANCE)]
    distinct = [np.log(read_vector(scene)) for scene in scenes[:10]]
    assert min(np.max(np.abs(distinct[i] - distinct[j])) for i in range(len(distinct)) for j in range(i)) > 0.05


@pytest.fixture(scope="module")
def improved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ended]:
    """A nodule's optimum under a load for linear elasticity: the folder, and what the program printed."""
    folder = tmp_path_factory.mktemp("optimum")
    (folder / "light.toml").write_text(scene_to_toml(nodule().replace({"load.force": 3e-4})), encoding="utf-8")
    output = folder / "out"
    return output, run("optimize", folder / "light.toml", "-o", output, "--starts", "2", "--outer-radius", "8 mm", "--json")


@pytest.mark.slow
def test_optimize_from_the_command_line(improved: tuple[Path, Ended]) -> None:
    output, ended = improved
    assert ended.returncode == 0, ended.stderr
    report = json.loads(ended.stdout)
    assert report["status"] == "improved"
    assert report["objective"] < 0.7 * report["baseline_objective"]
    assert sorted(Path(file).name for file in report["files"]) == sorted(path.name for path in output.iterdir())
    design = read_scene(output / "design.toml")
    assert verify_tumour_design(design, NOISE, report["evaluator"]).value == pytest.approx(report["objective"], rel=1e-9)
    rows = list(csv.DictReader((output / "candidates.csv").read_text().splitlines()))
    assert 8 <= len(rows) <= 14  # the start, ten verified designs and refinements of the best three, merged
    verified = [float(row["objective"]) for row in rows]
    assert verified[0] == pytest.approx(report["baseline_objective"], rel=1e-4)
    assert verified[1:] == sorted(verified[1:])
    assert "in place of" in (output / "report.html").read_text()
    assert not [path for path in output.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_no_gain_is_said_and_exits_1(improved: tuple[Path, Ended], tmp_path: Path) -> None:
    first, _ = improved  # nothing within its own radius is better
    limit = f"{read_scene(first / 'design.toml').probe.tube_radius} m"
    ended = run("optimize", first / "design.toml", "-o", tmp_path / "second", "--starts", "2", "--outer-radius", limit, "--json")
    assert ended.returncode == 1
    report = json.loads(ended.stdout)
    assert report["status"] == "no-gain"
    assert report["objective"] == report["baseline_objective"]


@pytest.mark.parametrize(
    ("folder", "name", "verifier"),
    slow_unless(
        lambda case: case[0] == "axisymmetric",
        [("axisymmetric", "shallow", "axisymmetric"), ("solid", "flank", "equivalent-inclusion")],
    ),
)
def test_refinement_gains_by_the_verifying_evaluator(folder: str, name: str, verifier: str) -> None:
    scene = named(folder, name).scene
    study = TumourStudy.from_scene(scene, evaluator=verifier)
    refined = study.refine_scene(scene)
    assert refined is not None
    assert study.verify(refined).value < 0.95 * study.verify(scene).value


def test_only_finite_elements_verify(tmp_path: Path) -> None:
    scene = REFERENCE / "solid" / "flank.toml"
    for verifier, word in (("closed-form", "one of axisymmetric, equivalent-inclusion"), ("axisymmetric", "axis")):
        ended = run("optimize", scene, "-o", tmp_path / "out", "--evaluator", verifier)
        assert ended.returncode == 2
        assert word in ended.stderr
        assert ended.stderr.count("\n") <= 3  # progress, and one line
