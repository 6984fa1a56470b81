"""First-order effects of a scene's tumours on the film forces on the coarsest mesh, and so on the rule for loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from solver.equivalent_inclusion.first_order import Effects, compute_effects
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.inclusions.tumours import Tumours
from solver.planning.loads import LoadRule

MAX_BALL_RADIUS_DEPTHS = 0.98  # of its depth: the maximum radius of the ball that stands for a body of another shape
STIFFNESS_MARGIN = 0.99  # of the coarsest mesh's stiffness, which is at most 0.4 % above the true one in 40 drawn scenes
# of the larger film log-sensitivity: by so much less their difference counts (docs/explanation/plan.md)
SENSITIVITY_MARGIN = 0.05
MIN_STIFFNESS_RELATIVE = 0.1  # of that without tumours: the first order overestimates the effect of large soft ones


def compute_tumour_effects(scene: Scene, base: Undisturbed) -> tuple[Tumours, Effects]:
    """Return a scene's tumours, inside the tissue that is modelled, and the effect of each alone.

    Parameters
    ----------
    scene
        The scene, with tumours of any shape, each taken as a ball.
    base
        Base states of the scene's probe and tissue without tumours; a tumour beyond the tissue that they model is moved into it.

    Raises
    ------
    InputError
        A surface file that cannot be used.
    Refusal
        A tumour larger than the modelled tissue.
    """
    balls = tuple(_build_ball(k, body) for k, body in enumerate(scene.inclusion))
    tumours = base.move_inside(Tumours.from_scene(scene.model_copy(update={"inclusion": balls})))[0]
    row = tumours.flatten()  # from shape (1, t) to (t,)
    return tumours, compute_effects(base.energies, base.strata.find_hosts(row.depth), row)


def add_tumours(rule: LoadRule, scene: Scene, base: Undisturbed) -> LoadRule:
    """Adapt a load rule for tissue without tumours to a scene's tumours.

    Parameters
    ----------
    rule
        The rule without tumours; its stiffness is that of the coarsest mesh.
    scene
        The scene with its tumours.
    base
        Base states without tumours on the coarsest mesh.

    Raises
    ------
    InputError, Refusal
        See ``compute_tumour_effects``.
    """
    effects, totals = compute_tumour_effects(scene, base)[1], base.films.totals
    changed = totals + effects.forces.sum(axis=0).sum(axis=1)
    derivatives = None if scene.target is None else effects.derivatives["youngs_modulus"][scene.target].sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return adjust_rule(rule, float(changed.sum() / totals.sum()), None if derivatives is None else derivatives / changed)


def adjust_rule(rule: LoadRule, times: float, derivatives: Floats | None) -> LoadRule:
    """Adapt the load rule to tumours that change the stiffness, so that it holds for any evaluator.

    Softer tumours let a force press deeper; how much the film log-sensitivities cancel decides how well the log-sensitivity has
    to be known. Stiffer ones count as none: the force that closes the gap hardly depends on them.

    Parameters
    ----------
    rule
        The rule, with the stiffness without tumours.
    times
        The stiffness with tumours, divided by that without.
    derivatives
        Film log-sensitivities, inner and outer, shape (2,); None without a target.
    """
    stiffness = STIFFNESS_MARGIN * float(np.clip(times, MIN_STIFFNESS_RELATIVE, 1.0)) * rule.stiffness
    return replace(rule, stiffness=stiffness, films=_reduce_difference(derivatives))


def _reduce_difference(derivatives: Floats | None) -> tuple[float, float] | None:
    """Return film log-sensitivities with the smallest difference that their errors allow; None where they are unknown.

    The larger stays; the other moves towards it by ``SENSITIVITY_MARGIN`` of the larger, but not past it.
    """
    if derivatives is None or not np.isfinite(derivatives).all():
        return None
    larger = int(np.argmax(np.abs(derivatives)))
    difference = derivatives[0] - derivatives[1] if larger == 0 else derivatives[1] - derivatives[0]
    min_difference = np.sign(difference) * max(0.0, abs(difference) - SENSITIVITY_MARGIN * abs(derivatives[larger]))
    films = [float(derivatives[larger]), float(derivatives[larger] - min_difference)]
    return (films[0], films[1]) if larger == 0 else (films[1], films[0])


def _build_ball(k: int, body: Inclusion) -> Inclusion:
    """Return the ball that encloses an inclusion; it changes more than the body, stiff or soft (Rayleigh)."""
    if body.diameter is not None:
        return body
    if body.diameters is not None:
        size = max(body.diameters)
    else:
        from geometry.tetra.surface_files import read_surface

        assert body.surface is not None
        sheet = read_surface(body.surface, f"inclusion[{k}].surface", np.zeros(3))
        size = 2 * float(np.linalg.norm(sheet.points, axis=1).max())
    return body.model_copy(
        update={"diameter": min(size, 2 * MAX_BALL_RADIUS_DEPTHS * body.depth), "diameters": None, "surface": None}
    )
