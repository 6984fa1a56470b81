"""Compute the load for verification on one tumour: the scene's, or the largest for which linear elasticity is accurate.

The force is the smaller of the scene's (its own, or its indentation times the design's stiffness) and the largest for which
finite strain changes the ratio by at most ``MAX_RATIO_CHANGE_RELATIVE``, by the rule of ``solver.planning.loads``. The change of
the log-sensitivity by finite strain does not limit the load; it is counted in the evaluator's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from geometry.common.errors import InputError
from geometry.scenes.scene import Load, Scene
from probe_design.design_search.loads import MAX_RATIO_CHANGE_RELATIVE, round_load_down
from solver.planning.loads import LoadRule

SCENE_LOAD, STRAIN_LIMIT, GAP_CLOSURE = "scene", "strain", "gap closure"  # limits of a load
MAX_DEPTH, LAST_CONVERGED, TIME_LIMIT, BEST_LOAD = (
    "depth",
    "last converged load",
    "time limit",
    "more tells less",
)  # limits of a load beyond linear elasticity
LIMIT_OF_RULE = {"ratio": STRAIN_LIMIT, "strain limit": STRAIN_LIMIT, "gap closure": GAP_CLOSURE}


@dataclass(frozen=True)
class Pressing:
    """The load on a design.

    Attributes
    ----------
    load
        The scene's load, or the smaller one of the same kind that is allowed, of ``loads.LOAD_DIGITS`` digits.
    force
        Force on the base under this load, N.
    x
        Strain in the rule for loads, see ``LoadRule``.
    change
        Bound on the relative change of the ratio by finite strain; 0 where finite strain is modelled.
    limited_by
        The limit of the load: ``SCENE_LOAD``, ``STRAIN_LIMIT`` or ``GAP_CLOSURE``; beyond linear elasticity ``SCENE_LOAD``,
        ``GAP_CLOSURE``, ``MAX_DEPTH`` (half an outer radius), ``LAST_CONVERGED`` (0.9 of the last load at which a step
        converges), ``TIME_LIMIT`` or ``BEST_LOAD``.
    """

    load: Load
    force: float
    x: float
    change: float
    limited_by: str


def compute_pressing(scene: Scene, stiffness: float, rule: LoadRule) -> Pressing:
    """Return the load on a scene's probe: the scene's, or the largest at which finite strain changes the ratio little enough.

    Parameters
    ----------
    scene
        Scene with a load above 0.
    stiffness
        Force per unit indentation by an evaluator, N/m.
    rule
        Rule for the scene's load, see ``solver.planning.load_limits``.
    """
    largest, load, limited_by = rule.find_largest_load(MAX_RATIO_CHANGE_RELATIVE, promise=False), scene.load, SCENE_LOAD
    if largest.force < rule.compute_force(scene):
        limited_by = LIMIT_OF_RULE[largest.by]
        allowed = round_load_down(largest.force if load.indentation is None else largest.indentation)
        load = Load(force=allowed) if load.indentation is None else Load(indentation=allowed)
    force = compute_force(load, rule.stiffness)
    return Pressing(
        load, float(compute_force(load, stiffness)), rule.compute_x(force), rule.bound_ratio_change(force), limited_by
    )


def compute_force(load: Load, stiffness: Any) -> Any:
    """Return the force of a load, N: a force itself, or an indentation times the stiffness, N/m; floats or arrays."""
    return load.force if load.indentation is None else load.indentation * stiffness


def check_load(scene: Scene) -> None:
    """Raise ``InputError`` for a load of 0, which yields no charge."""
    load = scene.load
    key = "force" if load.indentation is None else "indentation"
    if not getattr(load, key):
        raise InputError(f"load.{key}", 0, f"a {key} above 0: at 0 the films give no charge to read")
