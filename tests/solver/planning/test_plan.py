"""The plan, audited: what it leaves out is put back, and the ratio must move by less than it promised."""

from __future__ import annotations

import json
import math
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from geometry import Inclusion, Load, Scene, read_scene
from geometry.common.errors import Refusal
from geometry.scenes.film import Film
from geometry.scenes.probe import Base, Groove
from geometry.scenes.scene_tables import Contact
from probe_design.commands.main import cli
from solver import Decision, evaluate, evaluator, plan
from solver.axisymmetric.converged_forces import compute_converged_forces
from solver.planning.coarse_model import CoarseModel
from solver.planning.plan import Plan
from solver.planning.plan import build_plan as estimate
from solver.planning.strains import compute_cover_factor
from solver.results.film_forces import FilmForces
from solver.results.result import MAX_EFFECT
from solver.solid.domain import remove_asymmetry
from tests.support.load_paths import added_by_blocks
from tests.support.paths import REFERENCE
from tests.support.references import expected, named
from tests.support.slow import slow_unless

SCENE = read_scene(REFERENCE / "solid" / "flank.toml")


def decision(scene_plan: Plan, feature: str) -> Decision:
    return next(candidate for candidate in scene_plan.decisions if candidate.feature == feature)


def with_probe(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"probe": scene.probe.model_copy(update=changes)})


FOLDERS = ["axisymmetric", "extra", "extreme", "half-space", "layers", "off-axis", "solid"]


@pytest.mark.parametrize("folder", slow_unless(lambda folder: not folder.startswith("extr") and folder != "off-axis", FOLDERS))
def test_every_reference_scene_has_a_plan(folder: str) -> None:
    """Under no load: some sliding faces over thin or nearly cancelling films allow less than their scene's load."""
    for reference in expected(folder):
        scene_plan = plan(reference.scene.model_copy(update={"load": Load(force=0.0)}))
        round_ = reference.scene.probe.groove is None
        if scene_plan.evaluator == "solid" and round_:  # no cheaper one reaches the accuracy
            assert (evaluator("equivalent-inclusion").evaluate(reference.scene).error_estimate or 1) > scene_plan.allowed, (
                reference.name
            )
        else:
            assert (scene_plan.evaluator in ("axisymmetric", "equivalent-inclusion", "contact")) == round_, reference.name
        numbers = [(d.effect, d.effect_on_stresses, d.effect_on_stiffness) for d in scene_plan.decisions]
        assert np.all(np.isfinite(np.array(numbers, dtype=float))), reference.name


class TestInclusions:
    """What is put back here is computed by reflections, at a fraction of the accuracy that the plan was made for."""

    @staticmethod
    def scene(seed: int) -> Scene:
        """A target under the probe, and five tumours drawn anywhere, some far and small, some near and large."""
        rng = np.random.default_rng(seed)
        bodies = [SCENE.inclusion[0].model_copy(update={"target": True})]
        while len(bodies) < 6:
            diameter = float(np.exp(rng.uniform(np.log(1e-3), np.log(8e-3))))
            x, y = rng.uniform(-30e-3, 30e-3, 2)
            depth = float(rng.uniform(0.8, 4) * diameter + 2e-3)
            body = Inclusion(diameter=diameter, depth=depth, x=x, y=y, youngs_modulus=3e4, poisson_ratio=0.45)
            if all(math.dist((x, y, depth), (b.x, b.y, b.depth)) > 0.7 * (diameter + (b.diameter or 0)) for b in bodies):
                bodies.append(body)
        return SCENE.model_copy(update={"inclusion": tuple(bodies)})

    @pytest.mark.parametrize("seed", slow_unless((3).__gt__, range(8)))
    def test_the_ratio_moves_by_less_than_promised(self, seed: int) -> None:
        scene = self.scene(seed)
        scene_plan = plan(scene, 0.03)
        inclusion_evaluator = evaluator("equivalent-inclusion")
        whole, part = inclusion_evaluator.evaluate(scene, 0.002), inclusion_evaluator.evaluate(scene_plan.scene, 0.002)
        moved = [abs(math.log(getattr(whole, key) / getattr(part, key))) for key in ("ratio", "stiffness", "stress_outer")]
        assert max(moved) <= scene_plan.left_out <= 0.1 * 0.03
        assert part.log_sensitivity == pytest.approx(whole.log_sensitivity, rel=0.1 * 5 * 0.03)
        assert len(scene_plan.scene.inclusion) < 6 or max(moved) == 0

    def test_some_are_left_out_and_some_are_not(self) -> None:
        kept = [len(plan(self.scene(seed), 0.03).scene.inclusion) for seed in range(8)]
        assert min(kept) < 6
        assert max(kept) > 1

    def test_the_target_stays_the_target(self) -> None:
        scene = self.scene(0)
        scene_plan = plan(scene, 0.5)
        assert [body.target for body in scene_plan.scene.inclusion].count(True) == 1
        assert scene_plan.scene.inclusion[scene_plan.scene.target or 0].diameter == SCENE.inclusion[0].diameter
        result = evaluate(scene, accuracy=0.5)
        assert result.log_sensitivity is not None

    def test_without_a_target_there_is_no_log_sensitivity_however_many_are_left(self) -> None:
        bodies = [body.model_copy(update={"target": False}) for body in self.scene(0).inclusion]
        scene = SCENE.model_copy(update={"inclusion": tuple(bodies)})
        assert len(plan(scene, 0.5).scene.inclusion) < 2
        result = evaluate(scene, accuracy=0.5)
        assert result.log_sensitivity is None
        assert sum("log_sensitivity is null: several inclusions" in line for line in result.warnings) == 1

    def test_what_is_left_out_is_in_the_error(self) -> None:
        reference = named("solid", "two-tumours-on-large-tumour")
        scene_plan = plan(reference.scene)
        assert not decision(scene_plan, "inclusion[1]").modelled
        result = evaluate(reference.scene)
        alone = evaluate(scene_plan.scene, "axisymmetric", scene_plan.accuracy)
        assert result.error_estimate is not None
        assert alone.error_estimate is not None
        indentation = reference.scene.load.indentation
        assert indentation is not None
        x = indentation * (1 / reference.scene.probe.tube_radius + added_by_blocks(reference.scene.probe, result, indentation))
        assert result.error_estimate - alone.error_estimate == pytest.approx(
            scene_plan.left_out + 0.1 * compute_cover_factor(reference.scene.inclusion) * x, rel=0.02
        )
        assert result.ratio == pytest.approx(reference.ratio, rel=result.error_estimate + reference.uncertainty)


class TestDetails:
    """Films and base against the layered mesh, groove and sides against 3D of an independent code."""

    @staticmethod
    @cache
    def bare() -> FilmForces:
        """Of the probe without films, under a rigid base."""
        return compute_converged_forces(remove_asymmetry(SCENE), 1e-5).films[0]

    @pytest.mark.slow
    @pytest.mark.parametrize("stiff", [3e8, 3e9])
    def test_layers(self, stiff: float) -> None:
        layered = with_probe(SCENE, film=Film(youngs_modulus=stiff, psi1=0.0), base=Base(youngs_modulus=stiff, poisson_ratio=0.3))
        scene = remove_asymmetry(layered)
        scene_plan = plan(scene, 0.05)
        changes = compute_converged_forces(scene, 1e-5).films[0], self.bare()
        logs = [math.log(films.totals[0] / films.totals[1]) for films in changes]
        promised = decision(scene_plan, "film compliance"), decision(scene_plan, "elastic base")
        assert not any(layer_decision.modelled for layer_decision in promised)
        assert 0 < abs(logs[0] - logs[1]) <= sum(layer_decision.effect for layer_decision in promised)
        totals = [films.totals.sum() for films in changes]
        assert abs(totals[0] / totals[1] - 1) <= sum(layer_decision.effect_on_stiffness or 0 for layer_decision in promised)

    @pytest.mark.parametrize("name", ["groove-on-axis", "groove-over-tumour"])
    def test_groove(self, name: str) -> None:
        reference = named("solid", name)
        ratio_without = evaluate(with_probe(reference.scene, groove=None), accuracy=0.003)
        assert ratio_without.ratio
        moved = abs(math.log(reference.ratio / ratio_without.ratio))
        assert 0.003 < moved <= decision(plan(reference.scene), "groove").effect

    def test_a_groove_that_does_not_matter_is_left_out(self) -> None:
        small = with_probe(SCENE, groove=Groove(width=2e-4, depth=5e-5))
        assert plan(small, 0.05).evaluator == "equivalent-inclusion"
        assert not decision(plan(small, 0.05), "groove").modelled
        assert plan(small, 0.003).evaluator != "solid" or decision(plan(small, 0.003), "groove").modelled

    @pytest.mark.slow
    def test_sides(self) -> None:
        reference = named("solid", "two-tumours-between")
        bare = reference.scene.model_copy(update={"inclusion": ()})
        result = evaluate(bare, "axisymmetric", 1e-4)
        ratio_without = json.loads((REFERENCE / "solid" / "expected.json").read_text())["flank"]["ratio_without"]
        assert result.ratio
        promised = decision(plan(bare), "sides that are not round").effect
        assert abs(math.log(result.ratio / ratio_without)) <= promised + decision(plan(bare), "far edges").effect + 8e-4

    @pytest.mark.parametrize("reference", expected("half-space"), ids=lambda reference: reference.name)
    def test_the_half_space_ends_far_enough_away(self, reference: object) -> None:
        scene = reference.scene  # type: ignore[attr-defined]
        far_decision = next(d for d in plan(scene).decisions if d.feature.startswith("the tissue beyond"))
        assert not far_decision.modelled
        assert far_decision.effect < 1e-5


class TestBeyondLinearElasticity:
    @pytest.mark.slow
    def test_nothing_here_is_called_below_tolerance(self) -> None:
        for feature in ("gap contact", "lift-off", "finite strain"):
            decision_found = decision(plan(SCENE.model_copy(update={"load": Load(force=1e-6)})), feature)
            assert not decision_found.modelled
            assert decision_found.reason.startswith("no evaluator" if feature == "lift-off" else "no linear evaluator")
        refusal = plan(SCENE.model_copy(update={"load": Load(force=1e3)})).refusal
        assert refusal is not None
        assert refusal.key == "load.force"

    def test_the_gap_closes_where_tall_columns_widen(self) -> None:
        """Far from its ends a column of strain e widens by nu e r, and so does the hole of a tube."""
        inner = SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e4, "poisson_ratio": 0.4})
        outer = SCENE.probe.outer.model_copy(update={"youngs_modulus": 1e5, "poisson_ratio": 0.3})
        sizes = {"inner_radius": 2e-3, "gap": 1e-4, "area_ratio": 0.5, "height": 60e-3}
        scene = with_probe(SCENE, inner=inner, outer=outer, **sizes)
        rough, probe = CoarseModel.from_scene(scene), scene.probe
        strains = rough.forces.sum(axis=1) / [probe.inner_area * 1e4, probe.outer_area * 1e5]
        z, closing = rough.gap_profile.heights.ravel(), rough.gap_profile.nearing.ravel()
        widened = 0.4 * strains[0] * probe.inner_radius - 0.3 * strains[1] * probe.hole_radius
        assert np.interp(30e-3, z, closing) == pytest.approx(widened, rel=0.03)
        assert rough.wall_approach >= closing.max()

    def test_walls_that_may_meet_are_told(self) -> None:
        soft = with_probe(SCENE, inner=SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e4}))
        closing = CoarseModel.from_scene(soft).closure_force
        lower, upper = (
            decision(plan(soft.model_copy(update={"load": Load(force=times * closing)})), "gap contact") for times in (0.04, 0.06)
        )
        assert lower.effect == 0
        assert upper.effect == MAX_EFFECT  # nothing is known

    def test_a_rigid_punch_pulls_nowhere_and_a_bulging_one_does(self) -> None:
        """Under a frictionless rigid punch pressure is positive everywhere (Boussinesq); soft blocks' rims lose it."""
        rigid = SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e9})
        scene = with_probe(SCENE, inner=rigid, outer=rigid).model_copy(update={"contact": Contact(interface="frictionless")})
        assert CoarseModel.from_scene(scene).pulled_share == 0
        assert CoarseModel.from_scene(named("axisymmetric", "shallow").scene).pulled_share > 0.005

    def test_a_scene_that_no_evaluator_takes_still_has_a_plan(self) -> None:
        scene = SCENE.model_copy(update={"contact": Contact(interface="unilateral", friction=0.2)})
        scene_plan = plan(scene)
        assert scene_plan.evaluator is None
        assert decision(scene_plan, "lift-off").reason.startswith("no evaluator")
        with pytest.raises(Refusal, match="unilateral"):
            evaluate(scene)


class TestAuto:
    @pytest.mark.parametrize("name", ["published-materials", "shallow"])
    def test_follows_the_plan(self, name: str) -> None:
        scene = named("axisymmetric", name).scene
        result, scene_plan = evaluate(scene), plan(scene)
        assert result.evaluator == scene_plan.evaluator
        assert [decision.feature for decision in result.plan] == [decision.feature for decision in scene_plan.decisions]

    def test_tilt_and_grooves_that_matter_ask_for_three_dimensions(self) -> None:
        assert plan(named("solid", "groove-on-axis").scene).evaluator == "solid"
        placement = SCENE.placement.model_copy(update={"tilt": 0.02})
        estimated = estimate(SCENE.model_copy(update={"placement": placement}), 0.01)  # of which solid may not reach a hundredth
        assert estimated.evaluator == "solid"
        assert decision(estimated, "third dimension").modelled


def test_command() -> None:
    path = str(REFERENCE / "solid" / "groove-on-axis.toml")
    run = CliRunner().invoke(cli, ["plan", path, "--json"])
    output = json.loads(run.stdout)
    assert output["evaluator"] == "solid"
    assert {"feature", "modelled", "effect", "tolerance", "reason"} <= set(output["plan"][0])
    table = CliRunner().invoke(cli, ["plan", path])
    assert "groove: modelled" in table.stdout
    assert CliRunner().invoke(cli, ["plan", path, "--accuracy", "2"], standalone_mode=False).exception is not None
