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
from solver.planning.loads import CLOSING, LoadRule, largest_x
from solver.planning.strains import block_strain, both_strains, cover_factor, slimness

RATIO = 0.01  # relative change of the ratio by finite strain that is allowed
DIGITS = 3  # of a load that the rule sets
SCENE, STRAIN, GAP = "scene", "strain", "gap closure"  # what sets a load
DEPTH, LAST, TIME, BEST = "depth", "last converged load", "time limit", "more tells less"  # likewise, beyond linear elasticity
BY = {"ratio": STRAIN, "strain limit": STRAIN, "gap closure": GAP}


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
    by: str


def pressing(scene: Scene, stiffness: float, rule: LoadRule) -> Pressing:
    """Return the load on a scene's probe: the scene's, or the largest at which finite strain changes the ratio little enough.

    Args:
        scene: with a load above 0.
        stiffness: force per indentation that an evaluator finds, N/m.
        rule: of the scene, see ``solver.planning.load_limits``.
    """
    largest, load, by = rule.largest(RATIO, promise=False), scene.load, SCENE
    if largest.force < rule.force(scene):
        by = BY[largest.by]
        allowed = rounded_down(largest.force if load.indentation is None else largest.indentation)
        load = Load(force=allowed) if load.indentation is None else Load(indentation=allowed)
    force = asked(load, rule.stiffness)
    return Pressing(load, float(asked(load, stiffness)), rule.x(force), rule.ratio_change(force), by)


def rounded_down(value: float) -> float:
    """Return a load rounded down to ``LOAD_DIGITS`` digits."""
    unit = Decimal(1).scaleb(Decimal(value).adjusted() + 1 - DIGITS)
    return float(Decimal(value).quantize(unit, ROUND_FLOOR))


def asked(load: Load, stiffness: Any) -> Any:
    """Return the force of a load, N: itself, or its indentation times the stiffness, N/m; floats, arrays or casadi."""
    return load.force if load.indentation is None else load.indentation * stiffness


def check_load(scene: Scene) -> None:
    """Raise ``InputError`` for a load of 0: without charges there is nothing to read."""
    load = scene.load
    key = "force" if load.indentation is None else "indentation"
    if not getattr(load, key):
        raise InputError(f"load.{key}", 0, f"a {key} above 0: at 0 the films give no charge to read")


def pressing_force(scene: Scene, v: Any, radius: Any, totals: Any, nearing: float = 0.0) -> Any:
    """Return the same force for many designs, or as an expression; closure is known as far as ``nearing`` tells it.

    Args:
        scene: whose tissue and load count.
        v: the variables of designs, in the order of ``design_space.VARIABLES``.
        radius: outer radii, m.
        totals: force on the inner and on the outer film per unit indentation, N/m.
        wall_approach: approach of the gap's walls per unit indentation, see ``CoarseModel.approach``; 0 where not known.
    """
    stiffness = totals[0] + totals[1]
    areas = (np.pi * v[0] ** 2, np.pi * v[0] ** 2 / v[1])
    inner, outer = (block_strain(v[3], total / area / E) for total, area, E in zip(totals, areas, (v[4], v[5]), strict=True))
    slim = slimness(radius, radius - v[0] - v[2])
    added = _greater(inner, slim * outer)
    _, strain = both_strains(radius, scene.tissue, scene.contact.interface, added, cover_factor(scene.inclusion))
    force = _lesser(asked(scene.load, stiffness), largest_x(RATIO, promise=None)[0] / strain * stiffness)
    return _lesser(force, CLOSING * stiffness * v[2] / nearing) if nearing > 0 else force


def _lesser(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers, arrays or casadi expressions."""
    return a * (a <= b) + b * (b < a)


def _greater(a: Any, b: Any) -> Any:
    return a * (a >= b) + b * (b > a)
