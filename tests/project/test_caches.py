"""What modules of the solver keep themselves is listed here and stays small whatever is asked; all else is on a workspace."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from solver.closed_form import bessel
from solver.inclusions.solid_harmonics import SolidHarmonics, _build_recursion, build_derivatives
from solver.linalg.workspace import measure_bytes
from solver.multiple_scattering.rings import AzimuthalGrid, _compute_waves, build_turn_matrices
from solver.multiple_scattering.solve import ANGLE_LIMITS, DEGREE_LIMITS, MAX_MODE_ORDER
from tests.support.imports import module, sources

KEEPERS = {"cache", "lru_cache"}
CONSTANT = {  # one value, or one for each of a few numbers of points
    "solver.closed_form.bessel._load_stored_values": "the stored table",
    "solver.closed_form.block_functions._build_axial_table": "two tables of 1 MB at most",
    "solver.closed_form.block_functions._compute_disc_integrals": "two sets of some hundred numbers",
    "solver.closed_form.block_functions._build_wall_table": "two tables of 0.3 MB at most",
    "solver.closed_form.half_space._index_upper_triangle": "at most 4 lists of pairs",
    "solver.closed_form.lateral_boundary._build_wave_rule": "at most 16 rules of Gauss",
    "solver.closed_form.off_axis._build_pairs": "at most 4 lists of pairs",
    "solver.closed_form.tractions.build_wave_rule": "at most 64 rules of Gauss",
    "solver.closed_form.error_quantile.read_quantiles": "the three stored tables",
    "solver.closed_form.film_blocks.load_table": "two tables of 0.5 MB at most",
    "solver.closed_form.film_loads._build_plain_rule": "two rules of some hundred numbers",
    "solver.closed_form.film_loads._compute_mass_numbers": "two sets of some hundred numbers",
    "solver.closed_form.film_loads._sample_membrane_functions": "two sets of some hundred numbers",
    "solver.equivalent_inclusion.first_order._build_half_sphere": "at most 8 rules",
    "solver.equivalent_inclusion.first_order.build_half_ball": "at most 8 rules",
    "solver.linalg.cholesky.load_pardiso": "a module",
    "solver.linalg.conjugate_gradients._load_rslab": "a module",
    "solver.linalg.memory.keep_freed": "nothing",
    "solver.linalg.threads._get_controller": "the libraries' names",
    "solver.linalg.workspace.get_process_workspace": "the workspace",
    "solver.multiple_scattering.solve._share_modes": "at most 64 names of modes, 0.1 MB each with all their labels",
    "solver.reading_tables.build._compute_source_digest": "one digest",
    "solver.solid.tetrahedron.build_rule": "two rules",
}
LARGEST = SolidHarmonics(DEGREE_LIMITS[1] + 2, MAX_MODE_ORDER + 2)
ROUNDS = AzimuthalGrid(2 * ANGLE_LIMITS[1], False)
BOUNDED = {  # the largest value, of which there are at most ``maxsize``
    "solver.closed_form.bessel._fit_cubics": (bessel._fit_cubics, (1, 3)),
    "solver.inclusions.solid_harmonics._build_recursion": (_build_recursion, (LARGEST.degree, LARGEST.order)),
    "solver.inclusions.solid_harmonics.build_derivatives": (build_derivatives, (LARGEST, "outgoing")),
    "solver.multiple_scattering.rings._compute_waves": (_compute_waves, (ROUNDS,)),
    "solver.multiple_scattering.rings.build_turn_matrices": (build_turn_matrices, (ROUNDS,)),
}
MOST = 2e7  # bytes of one


def keeping(path: Path) -> set[str]:
    """The functions of a module that keep what they return."""
    functions = [function for function in ast.walk(ast.parse(path.read_bytes())) if isinstance(function, ast.FunctionDef)]
    return {
        f"{module(path)}.{function.name}"
        for function in functions
        if any(_name(mark) in KEEPERS for mark in function.decorator_list)
    }


def _name(mark: ast.expr) -> str:
    called = mark.func if isinstance(mark, ast.Call) else mark
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def test_all_that_modules_keep_is_listed() -> None:
    assert set().union(*map(keeping, sources("solver"))) == {*CONSTANT, *BOUNDED}


@pytest.mark.parametrize("name", BOUNDED)
def test_what_depends_on_scenes_is_bounded(name: str) -> None:
    function, largest = BOUNDED[name]
    assert function.cache_info().maxsize * measure_bytes(function(*largest)) < MOST
