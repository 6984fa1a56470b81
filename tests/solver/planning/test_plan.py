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
from geometry.scenes.probe import Base, Film, Groove
from geometry.scenes.scene import Contact
from probe_design.cli.main import cli
from solver import Decision, evaluate, evaluator, plan
from solver.axisymmetric.converged_forces import converged_forces
from solver.planning.coarse_model import CoarseModel
from solver.planning.plan import Plan
from solver.planning.plan import plan as estimate
from solver.planning.strains import cover_factor
from solver.results.film_forces import FilmForces
from solver.results.result import LARGEST
from solver.solid.domain import plain
from tests.support.load_paths import added_by_blocks
from tests.support.paths import REFERENCE
from tests.support.references import expected, named
from tests.support.slow import slow_unless

SCENE = read_scene(REFERENCE / "solid" / "flank.toml")


def decision(of: Plan, feature: str) -> Decision:
    return next(one for one in of.decisions if one.feature == feature)


def with_probe(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"probe": scene.probe.model_copy(update=changes)})


FOLDERS = ["axisymmetric", "extra", "extreme", "half-space", "layers", "off-axis", "solid"]


@pytest.mark.parametrize("folder", slow_unless(lambda folder: not folder.startswith("extr"), FOLDERS))
def test_every_reference_scene_has_a_plan(folder: str) -> None:
    """Under no load: some sliding faces over thin or nearly cancelling films allow less than their scene's load."""
    for one in expected(folder):
        found = plan(one.scene.model_copy(update={"load": Load(force=0.0)}))
        round_ = one.scene.probe.groove is None
        if found.evaluator == "solid" and round_:  # no cheaper one reaches the accuracy
            assert (evaluator("equivalent-inclusion").evaluate(one.scene).error_estimate or 1) > found.allowed, one.name
        else:
            assert (found.evaluator in ("axisymmetric", "equivalent-inclusion", "contact")) == round_, one.name
        numbers = [(d.effect, d.effect_on_stresses, d.effect_on_stiffness) for d in found.decisions]
        assert np.all(np.isfinite(np.array(numbers, dtype=float))), one.name


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
        found = plan(scene, 0.03)
        level = evaluator("equivalent-inclusion")
        whole, part = level.evaluate(scene, 0.002), level.evaluate(found.scene, 0.002)
        moved = [abs(math.log(getattr(whole, key) / getattr(part, key))) for key in ("ratio", "stiffness", "stress_outer")]
        assert max(moved) <= found.left_out <= 0.1 * 0.03
        assert part.log_sensitivity == pytest.approx(whole.log_sensitivity, rel=0.1 * 5 * 0.03)
        assert len(found.scene.inclusion) < 6 or max(moved) == 0

    def test_some_are_left_out_and_some_are_not(self) -> None:
        kept = [len(plan(self.scene(seed), 0.03).scene.inclusion) for seed in range(8)]
        assert min(kept) < 6
        assert max(kept) > 1

    def test_the_target_stays_the_target(self) -> None:
        scene = self.scene(0)
        found = plan(scene, 0.5)
        assert [body.target for body in found.scene.inclusion].count(True) == 1
        assert found.scene.inclusion[found.scene.target or 0].diameter == SCENE.inclusion[0].diameter
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
        one = named("solid", "two-tumours-on-large-tumour")
        found = plan(one.scene)
        assert not decision(found, "inclusion[1]").modelled
        result = evaluate(one.scene)
        alone = evaluate(found.scene, "axisymmetric", found.accuracy)
        assert result.error_estimate is not None
        assert alone.error_estimate is not None
        indentation = one.scene.load.indentation
        assert indentation is not None
        x = indentation * (1 / one.scene.probe.tube_radius + added_by_blocks(one.scene.probe, result, indentation))
        assert result.error_estimate - alone.error_estimate == pytest.approx(
            found.left_out + 0.1 * cover_factor(one.scene.inclusion) * x, rel=0.02
        )
        assert result.ratio == pytest.approx(one.ratio, rel=result.error_estimate + one.uncertainty)


class TestDetails:
    """Films and base against the layered mesh, groove and sides against 3D of an independent code."""

    @staticmethod
    @cache
    def bare() -> FilmForces:
        """Of the probe without films, under a rigid base."""
        return converged_forces(plain(SCENE), 1e-5).films[0]

    @pytest.mark.slow
    @pytest.mark.parametrize("stiff", [3e8, 3e9])
    def test_layers(self, stiff: float) -> None:
        layered = with_probe(SCENE, film=Film(youngs_modulus=stiff), base=Base(youngs_modulus=stiff, poisson_ratio=0.3))
        scene = plain(layered)
        found = plan(scene, 0.05)
        changes = converged_forces(scene, 1e-5).films[0], self.bare()
        logs = [math.log(films.totals[0] / films.totals[1]) for films in changes]
        promised = decision(found, "film compliance"), decision(found, "elastic base")
        assert not any(one.modelled for one in promised)
        assert 0 < abs(logs[0] - logs[1]) <= sum(one.effect for one in promised)
        totals = [films.totals.sum() for films in changes]
        assert abs(totals[0] / totals[1] - 1) <= sum(one.effect_on_stiffness or 0 for one in promised)

    @pytest.mark.parametrize("name", ["groove-on-axis", "groove-over-tumour"])
    def test_groove(self, name: str) -> None:
        one = named("solid", name)
        without = evaluate(with_probe(one.scene, groove=None), accuracy=0.003)
        assert without.ratio
        moved = abs(math.log(one.ratio / without.ratio))
        assert 0.003 < moved <= decision(plan(one.scene), "groove").effect

    def test_a_groove_that_does_not_matter_is_left_out(self) -> None:
        small = with_probe(SCENE, groove=Groove(width=2e-4, depth=5e-5))
        assert plan(small, 0.05).evaluator == "equivalent-inclusion"
        assert not decision(plan(small, 0.05), "groove").modelled
        assert plan(small, 0.003).evaluator != "solid" or decision(plan(small, 0.003), "groove").modelled

    @pytest.mark.slow
    def test_sides(self) -> None:
        one = named("solid", "two-tumours-between")
        bare = one.scene.model_copy(update={"inclusion": ()})
        result = evaluate(bare, "axisymmetric", 1e-4)
        without = json.loads((REFERENCE / "solid" / "expected.json").read_text())["flank"]["ratio_without"]
        assert result.ratio
        promised = decision(plan(bare), "sides that are not round").effect
        assert abs(math.log(result.ratio / without)) <= promised + decision(plan(bare), "far edges").effect + 8e-4

    @pytest.mark.parametrize("one", expected("half-space"), ids=lambda one: one.name)
    def test_the_half_space_ends_far_enough_away(self, one: object) -> None:
        scene = one.scene  # type: ignore[attr-defined]
        found = next(d for d in plan(scene).decisions if d.feature.startswith("the tissue beyond"))
        assert not found.modelled
        assert found.effect < 1e-5


class TestBeyondLinearElasticity:
    def test_nothing_here_is_called_below_tolerance(self) -> None:
        for force in (1e-6, 1e3):
            scene = SCENE.model_copy(update={"load": Load(force=force)})
            for feature in ("gap contact", "lift-off", "finite strain"):
                found = decision(plan(scene), feature)
                assert not found.modelled
                assert found.reason.startswith("no evaluator" if feature == "lift-off" else "no linear evaluator")

    def test_the_gap_closes_where_tall_columns_widen(self) -> None:
        """Far from its ends a column of strain e widens by nu e r, and so does the hole of a tube."""
        inner = SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e4, "poisson_ratio": 0.4})
        outer = SCENE.probe.outer.model_copy(update={"youngs_modulus": 1e5, "poisson_ratio": 0.3})
        sizes = {"inner_radius": 2e-3, "gap": 1e-4, "area_ratio": 0.5, "height": 60e-3}
        scene = with_probe(SCENE, inner=inner, outer=outer, **sizes)
        rough, probe = CoarseModel.of(scene), scene.probe
        strains = rough.forces.sum(axis=1) / [probe.inner_area * 1e4, probe.outer_area * 1e5]
        z, closing = rough.gap.heights.ravel(), rough.gap.nearing.ravel()
        widened = 0.4 * strains[0] * probe.inner_radius - 0.3 * strains[1] * probe.hole_radius
        assert np.interp(30e-3, z, closing) == pytest.approx(widened, rel=0.03)
        assert rough.approach >= closing.max()

    def test_walls_that_may_meet_are_told(self) -> None:
        soft = with_probe(SCENE, inner=SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e4}))
        closing = CoarseModel.of(soft).closure
        below, above = (
            decision(plan(soft.model_copy(update={"load": Load(force=times * closing)})), "gap contact") for times in (0.04, 0.06)
        )
        assert below.effect == 0
        assert above.effect == LARGEST  # nothing is known

    def test_a_rigid_punch_pulls_nowhere_and_a_bulging_one_does(self) -> None:
        """Under a frictionless rigid punch pressure is positive everywhere (Boussinesq); soft blocks' rims lose it."""
        rigid = SCENE.probe.inner.model_copy(update={"youngs_modulus": 1e9})
        scene = with_probe(SCENE, inner=rigid, outer=rigid).model_copy(update={"contact": Contact(interface="frictionless")})
        assert CoarseModel.of(scene).pulled == 0
        assert CoarseModel.of(named("axisymmetric", "shallow").scene).pulled > 0.005

    def test_a_scene_that_no_evaluator_takes_still_has_a_plan(self) -> None:
        scene = SCENE.model_copy(update={"contact": Contact(interface="unilateral", friction=0.2)})
        found = plan(scene)
        assert found.evaluator is None
        assert decision(found, "lift-off").reason.startswith("no evaluator")
        with pytest.raises(Refusal, match="unilateral"):
            evaluate(scene)


class TestAuto:
    @pytest.mark.parametrize("name", ["published-materials", "shallow"])
    def test_follows_the_plan(self, name: str) -> None:
        scene = named("axisymmetric", name).scene
        result, found = evaluate(scene), plan(scene)
        assert result.evaluator == found.evaluator
        assert [one.feature for one in result.plan] == [one.feature for one in found.decisions]

    def test_tilt_and_grooves_that_matter_ask_for_three_dimensions(self) -> None:
        assert plan(named("solid", "groove-on-axis").scene).evaluator == "solid"
        at = SCENE.placement.model_copy(update={"tilt": 0.02})
        found = estimate(SCENE.model_copy(update={"placement": at}), 0.01)  # of which solid may not reach a hundredth
        assert found.evaluator == "solid"
        assert decision(found, "third dimension").modelled


def test_command() -> None:
    path = str(REFERENCE / "solid" / "groove-on-axis.toml")
    run = CliRunner().invoke(cli, ["plan", path, "--json"])
    told = json.loads(run.stdout)
    assert told["evaluator"] == "solid"
    assert {"feature", "modelled", "effect", "tolerance", "reason"} <= set(told["plan"][0])
    table = CliRunner().invoke(cli, ["plan", path])
    assert "groove: modelled" in table.stdout
    assert CliRunner().invoke(cli, ["plan", path, "--accuracy", "2"], standalone_mode=False).exception is not None
