"""Check film forces under load on a mesh that is finer at the blocks' corners, where tissue folds onto a wall.

A bonded corner turns the tissue's surface towards the wall at any load: contact grows from the corner on. A mesh shows it later,
from the load on at which its first contact point touches, and the coarser its cells at the corner, the later. Meshes that are
equally coarse there agree with each other and are wrong alike. One layer of corner cells moves the first touch from 0.16 to below
0.1 outer radii, and is within 0.3 % of such layers on meshes of order three and four; it converges less far than coarse ones.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property

from geometry.common.errors import SolveError
from geometry.meridian.mesh_lines import MeridianFineness
from solver.contact.path import FIRST_STEP_RELATIVE, MAX_STEP_RELATIVE, Path

CORNER_FINENESS = MeridianFineness(1, 1, 2)
# of the first contact point's distance at rest. Fine corners touch between 0.06 and 0.1 outer radii; there coarse ones are at
# 0.2 to 0.8 of it, 0.5 at 0.1 on the order-three mesh
NEAR_WALL_RELATIVE = 0.5
NEARLY_RELATIVE = 0.95  # of the indentation: what is missing then adds a few per cent to the bounds
FORCE_MARGIN = 1e-3  # relative: points at a force lie this close to it, on either side


@dataclass(frozen=True)
class CornerCheck:
    """A load path with fine corners, which is built and pressed only where tissue comes near a wall.

    Attributes
    ----------
    build
        Function that builds the path.
    """

    build: Callable[[], Path]
    _ends: list[float] = field(default_factory=list, repr=False)  # where no further step converges, m: it is not tried again

    @cached_property
    def path(self) -> Path:
        """The load path, as far as it was pressed."""
        return self.build()

    def press(self, indentation: float) -> float:
        """Press to an indentation, m, and return the one that was reached: no step may converge beyond it, or none at all."""
        try:
            path = self.path
        except SolveError:
            return 0.0
        if self._ends and indentation > self._ends[0]:
            return self._ends[0]
        with suppress(SolveError):
            for point in path.iterate_steps(indentation):
                nearly = point.indentation > NEARLY_RELATIVE * indentation
                if path.length < (0.5 * MAX_STEP_RELATIVE * path.radius if nearly else FIRST_STEP_RELATIVE * path.unit):
                    break  # few more converge, each after some that fail
            else:
                path.press_to_indentation(indentation)
        reached = min(indentation, path.last.indentation)
        if reached < indentation:
            self._ends.append(reached)
        return reached


def is_near_wall(path: Path, until: float) -> bool:
    """Return whether tissue touches a wall or comes near it on a path up to the indentation ``until``, m."""
    rest_gaps = _list_gaps(path, 0)
    return any(
        gap < NEAR_WALL_RELATIVE * rest_gap
        for number, point in enumerate(path.points)
        if point.indentation <= until * (1 + FORCE_MARGIN)
        for gap, rest_gap in zip(_list_gaps(path, number), rest_gaps, strict=True)
    )


def _list_gaps(path: Path, number: int) -> list[float]:
    """Return the smallest gap between each wall and the tissue beside it at a point of a path, m."""
    return [touch.min_gap for touch in path.points[number].equilibrium.equations.touches[1:]]
