"""The load that a design is verified with for one tumour: the scene's, or the largest for which linear elasticity is accurate.

The force is the least of the scene's (its own, or its indentation times the design's stiffness) and of what the rule of
``solver.planning.loads`` allows where the ratio has to be good to ``MAX_RATIO_CHANGE_RELATIVE``. What finite strain does to the
log-sensitivity is no limit: it is counted in the evaluator's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from geometry.common.errors import InputError
from geometry.scenes.scene import Load, Scene
from probe_design.design_search.loads import MAX_RATIO_CHANGE_RELATIVE, round_load_down
from solver.planning.loads import LoadRule

SCENE_LOAD, STRAIN_LIMIT, GAP_CLOSURE = "scene", "strain", "gap closure"  # what sets a load
MAX_DEPTH, LAST_CONVERGED, TIME_LIMIT, BEST_LOAD = (
    "depth",
    "last converged load",
    "time limit",
    "more tells less",
)  # likewise, beyond linear elasticity
LIMIT_OF_RULE = {"ratio": STRAIN_LIMIT, "strain limit": STRAIN_LIMIT, "gap closure": GAP_CLOSURE}


@dataclass(frozen=True)
class Pressing:
    """How a design is pressed.

    Attributes:
        load: the scene's, or the lower one of the same kind that is allowed, of ``loads.LOAD_DIGITS`` digits.
        force: on the base under it, N.
        x: the strain that the rule counts with, see ``LoadRule``.
        change: bound on what finite strain changes of the ratio there, relative; 0 where it is modelled.
        limited_by: what sets the load: ``SCENE_LOAD``, ``STRAIN_LIMIT`` or ``GAP_CLOSURE``; beyond linear elasticity
            ``SCENE_LOAD``, ``GAP_CLOSURE``, ``MAX_DEPTH`` (half an
            outer radius), ``LAST_CONVERGED`` (0.9 of the last load at which a step converges), ``TIME_LIMIT`` or ``BEST_LOAD``.
    """

    load: Load
    force: float
    x: float
    change: float
    limited_by: str


def compute_pressing(scene: Scene, stiffness: float, rule: LoadRule) -> Pressing:
    """Return the load on a scene's probe: the scene's, or the largest at which finite strain changes the ratio little enough.

    Args:
        scene: with a load above 0.
        stiffness: force per indentation that an evaluator finds, N/m.
        rule: of the scene, see ``solver.planning.load_limits``.
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
    """Return the force of a load, N: itself, or its indentation times the stiffness, N/m; floats or arrays."""
    return load.force if load.indentation is None else load.indentation * stiffness


def check_load(scene: Scene) -> None:
    """Raise ``InputError`` for a load of 0: without charges there is nothing to read."""
    load = scene.load
    key = "force" if load.indentation is None else "indentation"
    if not getattr(load, key):
        raise InputError(f"load.{key}", 0, f"a {key} above 0: at 0 the films give no charge to read")
