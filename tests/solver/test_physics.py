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
from solver.axisymmetric.converged_forces import sample
from solver.axisymmetric.refinement import LEVELS
from solver.axisymmetric.sections import sections
from solver.closed_form.designs import forces, parameters
from solver.equivalent_inclusion.level import EquivalentInclusion, film_forces
from solver.equivalent_inclusion.readings import readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import Bound, FilmForces
from tests.support.random_scenes import MODULI, between, homogeneous, in_a_block, moved, scaled, scenes, stiffened
from tests.support.slow import slow_unless

ACCURACY = 0.05
EXACT = 1e-9  # rounding, and the residuals of the equations' solutions
EXAMPLES = {"closed-form": 40, "axisymmetric": 8, "equivalent-inclusion": 4}
DRAWN = {
    "closed-form": scenes(farthest=1.5, tumours=2),
    "axisymmetric": scenes(least_cover=0.03),
    "equivalent-inclusion": scenes(farthest=1.5, tumours=2),
}
BESIDE = ("closed-form", "equivalent-inclusion")  # levels that take tumours beside the axis


def held(
    levels: tuple[str, ...] = tuple(EXAMPLES), quick: tuple[str, ...] = ("closed-form", "axisymmetric"), **more: st.SearchStrategy
) -> Callable:
    """Make a law (level, scene, more) a test of each level on scenes that it takes, slow for those that are not quick."""

    def of(law: Callable[..., None]) -> Callable[[str], None]:
        @pytest.mark.parametrize("level", slow_unless(quick.__contains__, levels))
        def test(level: str) -> None:
            def check(**drawn: Any) -> None:
                assume(taken(level, drawn["scene"]))
                law(level, **drawn)

            check.__name__ = f"{law.__name__}_{level}".replace("-", "_")  # examples follow from the name
            few = settings(max_examples=EXAMPLES[level], suppress_health_check=[HealthCheck.too_slow], phases=[Phase.generate])
            few(given(scene=DRAWN[level], **more)(check))()

        test.__name__, test.__doc__ = law.__name__, law.__doc__
        return test

    return of


def taken(level: str, scene: Scene) -> bool:
    """The closed form refuses where its formulas break down; the other levels take every scene."""
    if level == "closed-form":
        try:
            answer(level, scene)
        except Refusal:
            return False
    return True


def answer(level: str, scene: Scene) -> Result:
    return evaluate(scene, level, ACCURACY)


def films(level: str, scene: Scene) -> FilmForces:
    """The film forces behind an answer; of ``axisymmetric`` those of its first mesh."""
    if level == "closed-form":
        shape, values = parameters(scene)
        found, slope = forces(shape, values[:, None])
        return FilmForces(found[0], Bound(np.zeros(2), 0.0), slope[0])
    if level == "axisymmetric":
        of = sections(scene)
        one = sample(of.section, of, scene, LEVELS[0])
        return FilmForces(one.forces[0], Bound(np.zeros(2), 0.0), one.slope[0])
    base = EquivalentInclusion().prepared(scene, ACCURACY)
    return film_forces(readings(base, Tumours.of(scene), scene.target or 0, sensitive=True), 0, True)


def same(one: Result, other: Result, stiffness: float = 1.0, rel: float = EXACT) -> None:
    """Both say the same, errors included, but for a factor of stiffness."""
    assert (one.ratio is None) == (other.ratio is None)
    assert other.stiffness == pytest.approx(stiffness * one.stiffness, rel=rel)
    if one.ratio is not None:
        assert other.ratio == pytest.approx(one.ratio, rel=rel)
        assert other.log_sensitivity == pytest.approx(one.log_sensitivity, rel=1e3 * rel, abs=rel)
        assert other.error_estimate == pytest.approx(one.error_estimate, rel=1e-3)


@held(lengths=between(1e-2, 3.0), moduli=between(0.1, 1e3))
def test_scale_of_lengths_and_of_moduli(level: str, scene: Scene, lengths: float, moduli: float) -> None:
    """Linear elasticity has no length and no modulus of its own."""
    same(answer(level, scene), answer(level, scaled(scene, lengths, moduli)), lengths * moduli)


@held()
def test_reciprocity_and_energy(level: str, scene: Scene) -> None:
    """Betti: F_ij = F_ji. Work is done on whatever is displaced: F is positive definite."""
    forces = films(level, scene).forces
    assert forces == pytest.approx(forces.T, rel=EXACT, abs=EXACT * forces.max())
    assert np.linalg.eigvalsh(forces).min() > 0


@held(part=st.sampled_from(sorted(MODULI)), times=between(1.05, 100.0))
def test_every_modulus_stiffens(level: str, scene: Scene, part: str, times: float) -> None:
    """Rayleigh: no displacement of the bases takes less energy where a modulus is larger."""
    soft, stiff = films(level, scene), films(level, stiffened(scene, part, times))
    slack = soft.bound.totals.sum() + stiff.bound.totals.sum() + EXACT * stiff.forces.max()
    assert np.linalg.eigvalsh(stiff.forces - soft.forces).min() >= -slack
    assert stiff.totals.sum() >= soft.totals.sum() - slack


@held()
def test_a_bond_stiffens(level: str, scene: Scene) -> None:
    """Free slip lets displacements take less energy."""
    bonded, slipping = (
        films(level, scene.model_copy(update={"contact": scene.contact.model_copy(update={"interface": name})}))
        for name in ("bonded", "frictionless")
    )
    slack = bonded.bound.totals.sum() + slipping.bound.totals.sum() + EXACT * bonded.forces.max()
    assert bonded.totals.sum() >= slipping.totals.sum() - slack


@held(quick=("closed-form",), force=between(1e-6, 1e-2), times=between(0.1, 10.0))
def test_balance_of_forces_linear_in_the_load(level: str, scene: Scene, force: float, times: float) -> None:
    """Stresses over end areas add up to the load and grow in proportion to it; the ratio does not depend on it."""
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])

    def at(**load: float) -> tuple[Result, np.ndarray]:
        found = answer(level, scene.model_copy(update={"load": Load(**load)}))
        return found, np.array([found.stress_inner, found.stress_outer])

    (one, stress), (more, larger), (none, zero) = at(force=force), at(force=times * force), at(force=0.0)
    pressed, by_depth = at(indentation=force / one.stiffness)
    assert stress @ areas == pytest.approx(force, rel=EXACT)
    assert by_depth == pytest.approx(stress, rel=EXACT)
    assert larger == pytest.approx(times * stress, rel=EXACT)
    assert not zero.any()
    for other in (more, none, pressed):
        assert (other.ratio, other.log_sensitivity, other.stiffness) == (one.ratio, one.log_sensitivity, one.stiffness)


@held(quick=("closed-form",))
def test_tumours_of_tissue_are_none(level: str, scene: Scene) -> None:
    """The homogeneous limit; a mesh round a sphere differs from one without, so ``axisymmetric`` within both bounds.

    The closed form integrates over fewer waves without a sphere.
    """
    same_tissue = homogeneous(scene)
    accuracy = 0.002 if level == "axisymmetric" else ACCURACY
    one, none = (evaluate(x, level, accuracy) for x in (same_tissue, scene.model_copy(update={"inclusion": ()})))
    waves = 3e-4 if level == "closed-form" else EXACT  # at most 1.6e-4 in drawn scenes
    slack = one.error_estimate + none.error_estimate if level == "axisymmetric" else waves
    assert one.ratio == pytest.approx(none.ratio, rel=slack)
    assert one.stiffness == pytest.approx(none.stiffness, rel=slack)


@held(like=st.booleans())
def test_sensitivity_is_the_slope_of_the_ratio(level: str, scene: Scene, like: bool) -> None:
    """At the tumours' moduli and at the tissue's."""
    scene = homogeneous(scene) if like else scene
    assume(films(level, scene).unresolved_stress is None)
    step = 1.01
    logs = [math.log(np.divide(*films(level, stiffened(scene, "inclusion", times)).totals)) for times in (step, 1 / step)]
    found = films(level, scene)
    # central differences are off by the third derivative, of the order of the slope, times step^2 / 6
    slack = found.sensitivity_error + 1e-4 * abs(found.log_sensitivity) + 1e-8
    assert found.log_sensitivity == pytest.approx((logs[0] - logs[1]) / (2 * math.log(step)), abs=slack)


@held(
    BESIDE,
    BESIDE,
    mirror=st.sampled_from([(-1, 0, 0, 1), (1, 0, 0, -1), (-1, 0, 0, -1), (0, 1, 1, 0), (0, -1, 1, 0)]),
    block=st.booleans(),
)
def test_mirrored_tumours(level: str, scene: Scene, mirror: tuple[int, ...], block: bool) -> None:
    """Mirrors of the tissue, and x for y."""
    scene = in_a_block(scene) if block else scene
    same(answer(level, scene), answer(level, moved(scene, *mirror)))


@held(BESIDE, turn=st.floats(0.0, 6.3))
def test_turned_tumours(level: str, scene: Scene, turn: float) -> None:
    """Round tissue under the probe's axis has no direction."""
    cos, sin = math.cos(turn), math.sin(turn)
    same(answer(level, scene), answer(level, moved(scene, cos, -sin, sin, cos)), rel=1e-7)
