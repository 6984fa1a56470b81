"""What physics fixes, held by every evaluator on random scenes: scale, reciprocity, stiffening, balance, limits, mirrors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st

from geometry import Load, Refusal, Scene
from solver import Result, evaluate
from solver.axisymmetric.converged_forces import solve_on_mesh
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sections import build_sections
from solver.closed_form.designs import build_parameters, compute_forces
from solver.equivalent_inclusion.evaluator import EquivalentInclusion, build_film_forces
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import Bound, FilmForces
from tests.support.random_scenes import MODULI, draw_between, homogeneous, in_a_block, moved, scaled, scenes, stiffened
from tests.support.slow import slow_unless

ACCURACY = 0.05
EXACT = 1e-9  # rounding, and the residuals of the equations' solutions
EXAMPLES = {"closed-form": 15, "axisymmetric": 8, "equivalent-inclusion": 4}
DRAWN = {
    "closed-form": scenes(farthest=1.5, tumours=2),
    "axisymmetric": scenes(least_cover=0.03),
    "equivalent-inclusion": scenes(farthest=1.5, tumours=2),
}
BESIDE = ("closed-form", "equivalent-inclusion")  # evaluators that take tumours off the axis


def held(
    evaluators: tuple[str, ...] = tuple(EXAMPLES),
    quick: tuple[str, ...] = ("closed-form", "axisymmetric"),
    **options: st.SearchStrategy,
) -> Callable:
    """Make a law (evaluator, scene, more) a test of each evaluator on scenes that it takes, slow unless quick."""

    def decorate(law: Callable[..., None]) -> Callable[[str], None]:
        @pytest.mark.parametrize("evaluator", slow_unless(quick.__contains__, evaluators))
        def test(evaluator: str) -> None:
            def check(**drawn: Any) -> None:
                assume(taken(evaluator, drawn["scene"]))
                law(evaluator, **drawn)

            check.__name__ = f"{law.__name__}_{evaluator}".replace("-", "_")  # examples follow from the name
            few_examples = settings(
                max_examples=EXAMPLES[evaluator], suppress_health_check=[HealthCheck.too_slow], phases=[Phase.generate]
            )
            few_examples(given(scene=DRAWN[evaluator], **options)(check))()

        test.__name__, test.__doc__ = law.__name__, law.__doc__
        return test

    return decorate


def taken(evaluator: str, scene: Scene) -> bool:
    """The closed form refuses where its formulas break down; the other evaluators take every scene."""
    if evaluator == "closed-form":
        try:
            answer(evaluator, scene)
        except Refusal:
            return False
    return True


def answer(evaluator: str, scene: Scene) -> Result:
    return evaluate(scene, evaluator, ACCURACY)


def films(evaluator: str, scene: Scene) -> FilmForces:
    """The film forces behind a result; of ``axisymmetric`` those of its first mesh."""
    if evaluator == "closed-form":
        shape, values = build_parameters(scene)
        forces_found, derivative = compute_forces(shape, values[:, None])
        return FilmForces(forces_found[0], Bound(np.zeros(2), 0.0), derivative[0])
    if evaluator == "axisymmetric":
        scene_sections = build_sections(scene)
        solution = solve_on_mesh(scene_sections.section, scene_sections, scene, MESH_LEVELS[0])
        return FilmForces(solution.forces[0], Bound(np.zeros(2), 0.0), solution.modulus_derivative[0])
    base = EquivalentInclusion().prepare(scene, ACCURACY)
    return build_film_forces(compute_readings(base, Tumours.from_scene(scene), scene.target or 0, sensitive=True), 0, True)


def assert_same(first: Result, second: Result, stiffness: float = 1.0, rel: float = EXACT) -> None:
    """Both results are the same, errors included, but for a factor of stiffness."""
    assert (first.ratio is None) == (second.ratio is None)
    assert second.stiffness == pytest.approx(stiffness * first.stiffness, rel=rel)
    if first.ratio is not None:
        assert second.ratio == pytest.approx(first.ratio, rel=rel)
        assert second.log_sensitivity == pytest.approx(first.log_sensitivity, rel=1e3 * rel, abs=rel)
        assert second.error_estimate == pytest.approx(first.error_estimate, rel=1e-3)


@held(lengths=draw_between(1e-2, 3.0), moduli=draw_between(0.1, 1e3))
def test_scale_of_lengths_and_of_moduli(evaluator: str, scene: Scene, lengths: float, moduli: float) -> None:
    """Linear elasticity has no length and no modulus of its own."""
    assert_same(answer(evaluator, scene), answer(evaluator, scaled(scene, lengths, moduli)), lengths * moduli)


@held()
def test_reciprocity_and_energy(evaluator: str, scene: Scene) -> None:
    """Betti: F_ij = F_ji. Work is done on whatever is displaced: F is positive definite."""
    forces = films(evaluator, scene).forces
    assert forces == pytest.approx(forces.T, rel=EXACT, abs=EXACT * forces.max())
    assert np.linalg.eigvalsh(forces).min() > 0


@held(part=st.sampled_from(sorted(MODULI)), times=draw_between(1.05, 100.0))
def test_every_modulus_stiffens(evaluator: str, scene: Scene, part: str, times: float) -> None:
    """Rayleigh: no displacement of the bases takes less energy where a modulus is larger."""
    soft, stiff = films(evaluator, scene), films(evaluator, stiffened(scene, part, times))
    slack = soft.bound.totals.sum() + stiff.bound.totals.sum() + EXACT * stiff.forces.max()
    assert np.linalg.eigvalsh(stiff.forces - soft.forces).min() >= -slack
    assert stiff.totals.sum() >= soft.totals.sum() - slack


@held()
def test_a_bond_stiffens(evaluator: str, scene: Scene) -> None:
    """Free slip lets displacements take less energy."""
    bonded, slipping = (
        films(evaluator, scene.model_copy(update={"contact": scene.contact.model_copy(update={"interface": name})}))
        for name in ("bonded", "frictionless")
    )
    slack = bonded.bound.totals.sum() + slipping.bound.totals.sum() + EXACT * bonded.forces.max()
    assert bonded.totals.sum() >= slipping.totals.sum() - slack


@held(quick=("closed-form",), force=draw_between(1e-6, 1e-2), times=draw_between(0.1, 10.0))
def test_balance_of_forces_linear_in_the_load(evaluator: str, scene: Scene, force: float, times: float) -> None:
    """Stresses over end areas add up to the load and grow in proportion to it; the ratio does not depend on it."""
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])

    def evaluate_at(**load: float) -> tuple[Result, np.ndarray]:
        result = answer(evaluator, scene.model_copy(update={"load": Load(**load)}))
        return result, np.array([result.stress_inner, result.stress_outer])

    (base, stress), (scaled, larger), (unloaded, zero) = (
        evaluate_at(force=force),
        evaluate_at(force=times * force),
        evaluate_at(force=0.0),
    )
    pressed, by_depth = evaluate_at(indentation=force / base.stiffness)
    assert stress @ areas == pytest.approx(force, rel=EXACT)
    assert by_depth == pytest.approx(stress, rel=EXACT)
    assert larger == pytest.approx(times * stress, rel=EXACT)
    assert not zero.any()
    for compared in (scaled, unloaded, pressed):
        assert (compared.ratio, compared.log_sensitivity, compared.stiffness) == (
            base.ratio,
            base.log_sensitivity,
            base.stiffness,
        )


@held(quick=("closed-form",))
def test_tumours_of_tissue_are_none(evaluator: str, scene: Scene) -> None:
    """The homogeneous limit; a mesh round a sphere differs from one without, so ``axisymmetric`` within both bounds.

    The closed form integrates over fewer waves without a sphere.
    """
    same_tissue = homogeneous(scene)
    accuracy = 0.002 if evaluator == "axisymmetric" else ACCURACY
    hidden, bare = (evaluate(x, evaluator, accuracy) for x in (same_tissue, scene.model_copy(update={"inclusion": ()})))
    waves = 3e-4 if evaluator == "closed-form" else EXACT  # at most 1.6e-4 in drawn scenes
    slack = hidden.error_estimate + bare.error_estimate if evaluator == "axisymmetric" else waves
    assert hidden.ratio == pytest.approx(bare.ratio, rel=slack)
    assert hidden.stiffness == pytest.approx(bare.stiffness, rel=slack)


@held(like=st.booleans())
def test_sensitivity_is_the_slope_of_the_ratio(evaluator: str, scene: Scene, like: bool) -> None:
    """At the tumours' moduli and at the tissue's."""
    scene = homogeneous(scene) if like else scene
    assume(films(evaluator, scene).stress_below_error is None)
    step = 1.01
    logs = [math.log(np.divide(*films(evaluator, stiffened(scene, "inclusion", times)).totals)) for times in (step, 1 / step)]
    forces_found = films(evaluator, scene)
    # central differences are off by the third derivative, of the order of the slope, times step^2 / 6
    slack = forces_found.sensitivity_error + 1e-4 * abs(forces_found.log_sensitivity) + 1e-8
    assert forces_found.log_sensitivity == pytest.approx((logs[0] - logs[1]) / (2 * math.log(step)), abs=slack)


@held(
    BESIDE,
    BESIDE,
    mirror=st.sampled_from([(-1, 0, 0, 1), (1, 0, 0, -1), (-1, 0, 0, -1), (0, 1, 1, 0), (0, -1, 1, 0)]),
    block=st.booleans(),
)
def test_mirrored_tumours(evaluator: str, scene: Scene, mirror: tuple[int, ...], block: bool) -> None:
    """Mirrors of the tissue, and x for y."""
    scene = in_a_block(scene) if block else scene
    assert_same(answer(evaluator, scene), answer(evaluator, moved(scene, *mirror)))


@held(BESIDE, turn=st.floats(0.0, 6.3))
def test_turned_tumours(evaluator: str, scene: Scene, turn: float) -> None:
    """Round tissue under the probe's axis has no direction."""
    cos, sin = math.cos(turn), math.sin(turn)
    assert_same(answer(evaluator, scene), answer(evaluator, moved(scene, cos, -sin, sin, cos)), rel=1e-7)
