"""Inclusions of a scene that can be left out, by the first-order effect of each on the coarsest mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.first_order import bound_first_order_error, bound_first_order_share
from solver.inclusions.tumours import Tumours
from solver.planning.coarse_model import CoarseModel
from solver.planning.tumour_effects import compute_tumour_effects
from solver.results.result import Decision, Effect

LEFT_OUT_ACCURACY_SHARE = 0.1  # fraction of the accuracy for all inclusions left out together
NEIGHBOUR_SAFETY_FACTOR = 2.0  # on the bound of a first-order effect: neighbours change it too


@dataclass(frozen=True)
class Reduced:
    """A scene without its negligible inclusions.

    Attributes
    ----------
    scene
        The reduced scene, with a marked target if the whole scene had one.
    decisions
        One decision for each inclusion of the whole scene.
    left_out
        Bound on the relative change by all inclusions left out together.
    """

    scene: Scene
    decisions: tuple[Decision, ...]
    left_out: float


@dataclass(frozen=True)
class _InclusionEffects:
    """Estimated relative effects of t inclusions, each of shape (t,).

    Attributes
    ----------
    ratio, stresses, stiffness
        Changes of the ratio, of the stress that changes more, and of the stiffness.
    doubt
        Bounds on the errors of these estimates.
    on_target
        Bounds on the relative change of the log-sensitivity to the target.
    """

    ratio: Floats
    stresses: Floats
    stiffness: Floats
    doubt: Floats
    on_target: Floats

    def build_effect(self, k: int, bounded: bool) -> Effect:
        """Return the effect of inclusion k; with ``bounded`` its error bound is added, which makes it an upper bound."""
        margin = float(self.doubt[k]) if bounded else 0.0
        return Effect(float(self.ratio[k]) + margin, float(self.stresses[k]) + margin, float(self.stiffness[k]) + margin)


def leave_out_negligible(scene: Scene, coarse: CoarseModel, accuracy: float) -> Reduced:
    """Leave out the inclusions with the smallest effects, while all of them together change less than a tenth of the accuracy.

    The target stays, as do a body from a surface file, whose size is not known well enough, and all in layers of tissue: the
    bounds know one material about them.

    Raises
    ------
    InputError
        A surface file that cannot be used.
    Refusal
        An inclusion larger than the modelled tissue.
    """
    if not scene.inclusion:
        return Reduced(scene, (), 0.0)
    effects = _compute_effects(scene, coarse)
    inclusion_effects = [effects.build_effect(k, bounded=True) for k in range(len(scene.inclusion))]
    dropped: list[int] = []
    spent = np.zeros(2)  # sums over the inclusions left out: of their maximum effects, and of a fifth of those on the target
    for k in sorted(range(len(inclusion_effects)), key=lambda k: inclusion_effects[k].maximum):
        cost = np.array(
            [inclusion_effects[k].maximum, effects.on_target[k] / 5]
        )  # DESIGN: the log-sensitivity may be off by 5 times as much
        is_bounded = scene.inclusion[k].surface is None and not scene.tissue.layer
        if k != scene.target and is_bounded and np.all(spent + cost <= LEFT_OUT_ACCURACY_SHARE * accuracy):
            dropped.append(k)
            spent += cost
    decisions = tuple(_build_decision(scene, k, effects, k in dropped, accuracy) for k in range(len(inclusion_effects)))
    remaining = tuple(
        body.model_copy(update={"target": k == scene.target}) for k, body in enumerate(scene.inclusion) if k not in dropped
    )
    return Reduced(scene.model_copy(update={"inclusion": remaining}) if dropped else scene, decisions, float(spent[0]))


def _compute_effects(scene: Scene, coarse: CoarseModel) -> _InclusionEffects:
    """Compute the first-order effect of each inclusion, its error bound, and its effect on the target's sensitivity."""
    base, target = coarse.base_states, scene.target  # film forces and strains without tumours
    tumours, effects = compute_tumour_effects(scene, base)
    changes = effects.forces
    relative_errors = bound_first_order_share(base, tumours)[0]
    doubt = NEIGHBOUR_SAFETY_FACTOR * bound_first_order_error(relative_errors[:, None], changes[:, None])
    totals = coarse.forces.sum(axis=1)
    min_totals = np.minimum(np.abs(totals), np.abs(totals + changes.sum(axis=(0, 2))))
    min_totals = np.maximum(min_totals, 1e-9 * np.abs(totals).sum())  # a stress near zero: nothing is left out
    relative_changes, doubts = changes.sum(axis=2) / min_totals, doubt / min_totals
    doubts[base.strata.compute_gap(tumours)[0] < 0] = np.inf  # across an interface: the first order knows one material about it
    stiffness_changes = np.abs(changes.sum(axis=(1, 2))) / min_totals.sum()
    on_target = np.zeros(len(relative_errors))
    if target is not None:
        on_target = (
            doubts.sum(axis=1)
            + np.abs(relative_changes).max(axis=1)
            + _bound_effect_on_target(tumours, changes, effects.derivatives["youngs_modulus"], target)
        )
    ratio_changes, max_changes = np.abs(relative_changes[:, 0] - relative_changes[:, 1]), np.abs(relative_changes).max(axis=1)
    return _InclusionEffects(ratio_changes, max_changes, stiffness_changes, doubts.sum(axis=1), on_target)


def _bound_effect_on_target(tumours: Tumours, changes: Floats, derivatives: Floats, target: int) -> Floats:
    """Bound the relative change of the target's sensitivity by each inclusion's field at the target.

    Fields of spheres fall off with the cube of the distance; the work of one on the other is bounded by both effects:
    4 sqrt(dF_k / dF_t) (r_k r_t)^(3/2) / d^3 (PL.1).
    """
    tumour_set = tumours.select(0)
    radius = tumour_set.diameter / 2
    distance = np.sqrt(sum((getattr(tumour_set, key) - getattr(tumour_set, key)[target]) ** 2 for key in ("x", "y", "depth")))
    distance = np.maximum(distance, radius + radius[target])
    sizes = np.abs(changes.sum(axis=(1, 2)))
    target_size = max(float(sizes[target]), float(np.abs(derivatives[target].sum())), 1e-300)
    return np.asarray(4 * np.sqrt(sizes / target_size) * (radius * radius[target]) ** 1.5 / distance**3)  # eq. PL.1


def _build_decision(scene: Scene, k: int, effects: _InclusionEffects, dropped: bool, accuracy: float) -> Decision:
    """Return the line of the plan about inclusion k."""
    effect = effects.build_effect(k, bounded=dropped)
    size = f"changes the ratio by {'at most ' if dropped else ''}about {format_percent(effect.ratio)}"
    what = f"left out: {size}, counted in error_estimate" if dropped else f"modelled: {size}"
    if k == scene.target:
        what = f"modelled, as the target: {size}"
    return Decision.from_effect(f"inclusion[{k}]", not dropped, effect, LEFT_OUT_ACCURACY_SHARE * accuracy, what)
