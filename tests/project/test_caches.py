"""What modules of the solver keep themselves is listed here and stays small whatever is asked; all else is on a workspace."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from solver.closed_form import bessel
from solver.inclusions.solid_harmonics import SolidHarmonics, _recursion, derivatives
from solver.linalg.workspace import size
from solver.multiple_scattering.rings import AzimuthalGrid, _waves, turns
from solver.multiple_scattering.solve import ANGLES, DEGREES, ORDERS
from tests.support.imports import module, sources

KEEPERS = {"cache", "lru_cache"}
CONSTANT = {  # one value, or one for each of a few numbers of points
    "solver.closed_form.bessel._stored": "the stored table",
    "solver.closed_form.block_functions._axial_table": "two tables of 1 MB at most",
    "solver.closed_form.block_functions._disc": "two sets of some hundred numbers",
    "solver.closed_form.block_functions._wall_table": "two tables of 0.3 MB at most",
    "solver.closed_form.half_space._upper": "at most 4 lists of pairs",
    "solver.closed_form.lateral_boundary._shares": "at most 16 rules of Gauss",
    "solver.closed_form.off_axis._pairs": "at most 4 lists of pairs",
    "solver.closed_form.tractions.between_waves": "at most 64 rules of Gauss",
    "solver.closed_form.error_bound.weights": "the stored weights",
    "solver.equivalent_inclusion.first_order._sphere": "at most 8 rules",
    "solver.equivalent_inclusion.first_order.half_ball": "at most 8 rules",
    "solver.linalg.cholesky.pardiso": "a module",
    "solver.linalg.conjugate_gradients._rslab": "a module",
    "solver.linalg.memory.keep_freed": "nothing",
    "solver.linalg.threads._controller": "the libraries' names",
    "solver.linalg.workspace.of_process": "the workspace",
    "solver.multiple_scattering.solve._same": "at most 64 names of modes, 0.1 MB each with all their labels",
    "solver.solid.tetrahedron.rule": "two rules",
}
LARGEST = SolidHarmonics(DEGREES[1] + 2, ORDERS + 2)
ROUNDS = AzimuthalGrid(2 * ANGLES[1], False)
BOUNDED = {  # the largest value, of which there are at most ``maxsize``
    "solver.closed_form.bessel._cylindrical": (bessel._cylindrical, (3,)),
    "solver.closed_form.bessel._spherical": (bessel._spherical, (3,)),
    "solver.inclusions.solid_harmonics._recursion": (_recursion, (LARGEST.degree, LARGEST.order)),
    "solver.inclusions.solid_harmonics.derivatives": (derivatives, (LARGEST, "outgoing")),
    "solver.multiple_scattering.rings._waves": (_waves, (ROUNDS,)),
    "solver.multiple_scattering.rings.turns": (turns, (ROUNDS,)),
}
MOST = 2e7  # bytes of one


def keeping(path: Path) -> set[str]:
    """The functions of a module that keep what they return."""
    functions = [one for one in ast.walk(ast.parse(path.read_bytes())) if isinstance(one, ast.FunctionDef)]
    return {f"{module(path)}.{one.name}" for one in functions if any(_name(mark) in KEEPERS for mark in one.decorator_list)}


def _name(mark: ast.expr) -> str:
    called = mark.func if isinstance(mark, ast.Call) else mark
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def test_all_that_modules_keep_is_listed() -> None:
    assert set().union(*map(keeping, sources("solver"))) == {*CONSTANT, *BOUNDED}


@pytest.mark.parametrize("name", BOUNDED)
def test_what_depends_on_scenes_is_bounded(name: str) -> None:
    function, largest = BOUNDED[name]
    assert function.cache_info().maxsize * size(function(*largest)) < MOST
