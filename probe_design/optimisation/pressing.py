"""How hard a design is pressed: as the scene says, or as far as linear elasticity answers for it.

The force is the least of the scene's (its own, or its indentation times the design's stiffness) and of what the rule of
``solver.planning.loads`` allows where the ratio has to be good to ``MAX_RATIO_CHANGE_RELATIVE``. What finite strain does to the
log-sensitivity is no limit: it is counted in the judge's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_FLOOR, Decimal
from typing import Any

import numpy as np

from geometry.common.errors import InputError
from geometry.scenes.scene import Load, Scene
from solver.planning.law_factor import compute_law_factor
from solver.planning.loads import CLOSURE_FORCE_SHARE, MAX_X, LoadRule, find_largest_x
from solver.planning.strains import compute_block_strain, compute_both_strains, compute_cover_factor, compute_slimness

MAX_RATIO_CHANGE_RELATIVE = 0.01  # relative change of the ratio by finite strain that is allowed
LOAD_DIGITS = 3  # of a load that the rule sets
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
        load: the scene's, or the lower one of the same kind that is allowed, of ``LOAD_DIGITS`` digits.
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


def round_load_down(value: float) -> float:
    """Return a load rounded down to ``LOAD_DIGITS`` digits."""
    unit = Decimal(1).scaleb(Decimal(value).adjusted() + 1 - LOAD_DIGITS)
    return float(Decimal(value).quantize(unit, ROUND_FLOOR))


def compute_force(load: Load, stiffness: Any) -> Any:
    """Return the force of a load, N: itself, or its indentation times the stiffness, N/m; floats, arrays or casadi."""
    return load.force if load.indentation is None else load.indentation * stiffness


def check_load(scene: Scene) -> None:
    """Raise ``InputError`` for a load of 0: without charges there is nothing to read."""
    load = scene.load
    key = "force" if load.indentation is None else "indentation"
    if not getattr(load, key):
        raise InputError(f"load.{key}", 0, f"a {key} above 0: at 0 the films give no charge to read")


def compute_pressing_force(scene: Scene, v: Any, radius: Any, totals: Any, wall_approach: float = 0.0) -> Any:
    """Return the same force for many designs, or as an expression; closure limits it where ``wall_approach`` is given.

    Args:
        scene: whose tissue and load count.
        v: the variables of designs, in the order of ``design_space.VARIABLES``.
        radius: outer radii, m.
        totals: force on the inner and on the outer film per unit indentation, N/m.
        wall_approach: approach of the gap's walls per unit indentation, see ``CoarseModel.wall_approach``; 0 where not known.
    """
    stiffness = totals[0] + totals[1]
    areas = (np.pi * v[0] ** 2, np.pi * v[0] ** 2 / v[1])
    inner, outer = (
        compute_block_strain(v[3], total / area / E) for total, area, E in zip(totals, areas, (v[4], v[5]), strict=True)
    )
    slim = compute_slimness(radius, radius - v[0] - v[2])
    added = _maximum(inner, slim * outer)
    cover, law = compute_cover_factor(scene.inclusion), compute_law_factor(scene, MAX_X)
    _, strain = compute_both_strains(radius, scene.tissue, scene.contact.interface, added, cover, law=law)
    force = _minimum(
        compute_force(scene.load, stiffness), find_largest_x(MAX_RATIO_CHANGE_RELATIVE, promise=None)[0] / strain * stiffness
    )
    return _minimum(force, CLOSURE_FORCE_SHARE * stiffness * v[2] / wall_approach) if wall_approach > 0 else force


def _minimum(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers, arrays or casadi expressions."""
    return a * (a <= b) + b * (b < a)


def _maximum(a: Any, b: Any) -> Any:
    return a * (a >= b) + b * (b > a)
