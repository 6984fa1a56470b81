"""Inclusions of a scene that can be left out, by the first-order effect of each on the coarsest mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Inclusion, Scene
from solver.equivalent_inclusion.first_order_bound import first_order_error, first_order_share
from solver.inclusions.tumours import Tumours
from solver.planning.coarse_model import CoarseModel
from solver.planning.tumour_effects import TumourEffects
from solver.results.result import Decision, Effect

SHARE = 0.1  # fraction of the accuracy for all inclusions left out together
DOUBT = 2.0  # on the bound of a first-order effect: neighbours change it too


@dataclass(frozen=True)
class Reduced:
    """A scene without its negligible inclusions.

    Attributes:
        scene: with a marked target, if the whole had one.
        decisions: one for each inclusion of the whole.
        left_out: bound on what those left out change together, relative.
    """

    scene: Scene
    decisions: tuple[Decision, ...]
    left_out: float


@dataclass(frozen=True)
class _InclusionEffects:
    """Estimated effects of each of t inclusions, bounds on their errors, and bounds on the change of the target's sensitivity."""

    ratio: Floats
    stresses: Floats
    stiffness: Floats
    doubt: Floats
    on_target: Floats

    def effect(self, k: int, bounded: bool) -> Effect:
        more = float(self.doubt[k]) if bounded else 0.0
        return Effect(float(self.ratio[k]) + more, float(self.stresses[k]) + more, float(self.stiffness[k]) + more)


def reduced(scene: Scene, rough: CoarseModel, accuracy: float) -> Reduced:
    """Leave out the inclusions with the smallest effects, while all of them together change less than a tenth of the accuracy.

    The target stays, as do a body from a surface file, whose size is not known well enough, and all in layers of tissue: the
    bounds know one material about them.

    Raises:
        InputError: a surface file that cannot be used.
        Refusal: an inclusion larger than the modelled tissue.
    """
    if not scene.inclusion:
        return Reduced(scene, (), 0.0)
    effects = _effects(scene, rough)
    every = [effects.effect(k, bounded=True) for k in range(len(scene.inclusion))]
    dropped: list[int] = []
    spent = np.zeros(2)
    for k in sorted(range(len(every)), key=lambda k: every[k].largest):
        cost = np.array([every[k].largest, effects.on_target[k] / 5])  # DESIGN: the log-sensitivity may be off by 5 times as much
        known = scene.inclusion[k].surface is None and not scene.tissue.layer
        if k != scene.target and known and np.all(spent + cost <= SHARE * accuracy):
            dropped.append(k)
            spent += cost
    decisions = tuple(_decision(scene, k, effects, k in dropped, accuracy) for k in range(len(every)))
    kept = tuple(_marked(scene, k) for k in range(len(every)) if k not in dropped)
    return Reduced(scene.model_copy(update={"inclusion": kept}) if dropped else scene, decisions, float(spent[0]))


def _marked(scene: Scene, k: int) -> Inclusion:
    return scene.inclusion[k].model_copy(update={"target": k == scene.target})


def _effects(scene: Scene, rough: CoarseModel) -> _InclusionEffects:
    base, target = rough.undisturbed, scene.target
    found = TumourEffects.of(scene, base)
    tumours, each = found.tumours, found.each
    changes = each.forces
    share = first_order_share(base, tumours)[0]
    doubt = DOUBT * first_order_error(share[:, None], changes[:, None])
    totals = rough.forces.sum(axis=1)
    least = np.minimum(np.abs(totals), np.abs(totals + changes.sum(axis=(0, 2))))
    least = np.maximum(least, 1e-9 * np.abs(totals).sum())  # a stress near zero: nothing is left out
    parts, doubts = changes.sum(axis=2) / least, doubt / least
    doubts[base.strata.gap(tumours)[0] < 0] = np.inf  # across an interface: the first order knows one material about it
    whole = np.abs(changes.sum(axis=(1, 2))) / least.sum()
    on_target = np.zeros(len(share))
    if target is not None:
        on_target = doubts.sum(axis=1) + np.abs(parts).max(axis=1) + _on_target(tumours, each.forces, each.by_log_modulus, target)
    return _InclusionEffects(np.abs(parts[:, 0] - parts[:, 1]), np.abs(parts).max(axis=1), whole, doubts.sum(axis=1), on_target)


def _on_target(tumours: Tumours, changes: Floats, slopes: Floats, target: int) -> Floats:
    """Bound the relative change of the target's sensitivity by each inclusion's field at the target.

    Fields of spheres fall off with the cube of the distance; the work of one on the other is bounded by both effects:
    4 sqrt(dF_k / dF_t) (r_k r_t)^(3/2) / d^3 (PL.1).
    """
    one = tumours.of_index(0)
    radius = one.diameter / 2
    apart = np.sqrt(sum((getattr(one, key) - getattr(one, key)[target]) ** 2 for key in ("x", "y", "depth")))
    apart = np.maximum(apart, radius + radius[target])
    sizes = np.abs(changes.sum(axis=(1, 2)))
    own = max(float(sizes[target]), float(np.abs(slopes[target].sum())), 1e-300)
    return np.asarray(4 * np.sqrt(sizes / own) * (radius * radius[target]) ** 1.5 / apart**3)


def _decision(scene: Scene, k: int, effects: _InclusionEffects, dropped: bool, accuracy: float) -> Decision:
    effect = effects.effect(k, bounded=dropped)
    size = f"changes the ratio by {'at most ' if dropped else ''}about {effect.ratio:.2g}"
    what = f"left out: {size}, counted in error_estimate" if dropped else f"modelled: {size}"
    if k == scene.target:
        what = f"modelled, as the target: {size}"
    return Decision.of(f"inclusion[{k}]", not dropped, effect, SHARE * accuracy, what)
