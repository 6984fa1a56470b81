"""Tissue that folds onto the tube's outer wall: the stated error covers meshes on which the first touch comes too late."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.common.errors import SolveError
from geometry.meridian.mesh_lines import MeridianFineness
from solver.contact.corner_check import CornerCheck
from solver.contact.loaded_scene import MESH_FINENESSES, LoadedScene
from solver.contact.path import Path
from solver.contact.tumours_anywhere import TISSUE_FINENESSES
from tests.support.paths import SCENE

# ln of the inner charge over the outer, per nominal end area, by force, N: one layer of corner cells, order 4, which touches from
# 0.1 N on. Such layers at order 3 give 1.4131 and 1.4857, at order 2 on twice as many cells each way 1.4158 and 1.4893
CHARGE_RATIOS = {0.1: 1.4144, 0.2: 1.4870}
SPREAD = 0.002  # of ln of these


def build_scene() -> Scene:
    """A wide probe with a thin tube wall and films between tapes, on tissue without tumours."""
    tables = read_scene(SCENE).model_dump(exclude_none=True)
    block, bond = {"youngs_modulus": 1e6, "poisson_ratio": 0.48}, {"name": "tape-50um"}
    film = {"thickness": 28e-6, "youngs_modulus": 2.5e9, "d31": 23e-12, "d32": 2e-12, "d33": -33e-12}
    tables["probe"] = {
        "inner_radius": 8.2e-3,
        "outer_radius": 9.2e-3,
        "gap": 0.1e-3,
        "height": 3e-3,
        "inner": block,
        "outer": block,
        "base": {"rigid": True},
        "film": film | {"bond_to_base": bond, "bond_to_block": bond},
    }
    tables["tissue"] |= {"radius": 50e-3, "depth": 60e-3}
    return Scene.from_tables(tables | {"inclusion": ()})


@pytest.mark.parametrize("finenesses", [MESH_FINENESSES, TISSUE_FINENESSES])
def test_stated_error_covers_finer_corners(finenesses: tuple[MeridianFineness, ...]) -> None:
    loaded = LoadedScene.from_scene(build_scene(), 0.01, finenesses)
    area_ratio = 8.2**2 / (9.2**2 - 8.3**2)  # inner over outer nominal end area
    for force, ratio in CHARGE_RATIOS.items():
        charges = loaded.press_to_force(force).films.charges
        assert charges is not None
        error = abs(float(np.log(charges.totals[0] / charges.totals[1] / area_ratio / ratio)))
        assert error <= charges.bound.log_ratio + SPREAD
        assert charges.bound.log_ratio < 0.04  # and stays of use
    assert error > 0.008  # meshes without corner cells touch too late: the difference of the two alone was 0.006 to 0.014


# What the load adds to ln ratio and to the log-sensitivity of a stiff probe with a wide gap, by indentation in outer radii:
# layers of corner cells at order 3, and at order 2 on twice as many cells each way, which differ by less than SPREAD
GROWTHS = {0.15: (0.0205, 0.00678), 0.25: (0.0336, 0.01182)}


def test_stated_error_covers_corners_without_a_finer_mesh() -> None:
    block = {"youngs_modulus": 2e6, "poisson_ratio": 0.48}
    sizes = {"inner_radius": 3e-3, "outer_radius": 9e-3, "gap": 2e-3, "height": 8e-3}
    tissue = {"shape": "cylinder", "radius": 54e-3, "depth": 50e-3, "youngs_modulus": 5e3, "poisson_ratio": 0.4}
    sphere = {"diameter": 9e-3, "depth": 9e-3, "youngs_modulus": 5e4, "poisson_ratio": 0.4}
    probe = {**sizes, "inner": block, "outer": block, "base": {"rigid": True}}
    scene = Scene.from_tables({"probe": probe, "tissue": tissue, "inclusion": [sphere], "load": {"force": 0.001}})
    loaded = replace(LoadedScene.from_scene(scene, 0.01), corner_check=CornerCheck(_fail))
    rest = loaded.linear.films[0]
    for x, (growth, added) in GROWTHS.items():
        films = loaded.press_to_indentation(x * loaded.paths[1].radius).films
        error = float(np.log(films.totals[0] / films.totals[1] / (rest.totals[0] / rest.totals[1]))) - growth
        assert abs(error) <= films.bound.log_ratio + SPREAD / 2
        assert films.log_sensitivity is not None
        assert rest.log_sensitivity is not None
        assert abs(films.log_sensitivity - rest.log_sensitivity - added) <= films.sensitivity_error
        assert films.bound.log_ratio < 0.025


def _fail() -> Path:
    """Build no path: no finer mesh converges."""
    raise SolveError("no step converges")


def test_fine_corners_that_no_longer_converge_are_not_pressed_again() -> None:
    path = Mock(last=Mock(indentation=1e-3))
    path.iterate_steps.side_effect = SolveError("an element folds over")
    check = CornerCheck(lambda: path)
    assert check.press(2e-3) == check.press(3e-3) == 1e-3
    assert path.iterate_steps.call_count == 1


@pytest.mark.parametrize(("reached", "length"), [(1e-3, 1e-5), (1.95e-3, 3e-4)])
def test_fine_corners_are_left_where_steps_become_short(reached: float, length: float) -> None:
    points = [Mock(indentation=reached) for _ in range(5)]
    path = Mock(last=points[0], unit=1e-2, radius=1e-2, length=length)
    path.iterate_steps.return_value = iter(points)
    check = CornerCheck(lambda: path)
    assert check.press(2e-3) == reached
    assert next(path.iterate_steps.return_value) is points[1]
