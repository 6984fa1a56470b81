"""What a bare import must not load."""

from __future__ import annotations

import pytest

from tests.support.imports import modules_after
from tests.support.paths import ROOT

HEAVY = {"cadquery", "OCP", "matplotlib", "vtk", "vtkmodules", "pyvista", "pytetwild", "netgen"}


@pytest.mark.parametrize("module", ["geometry", "solver", "hw.reader", "hw.simulation.virtual"])
def test_bare_import_loads_nothing_heavy(module: str) -> None:
    modules = modules_after(f"import {module}")
    assert modules & HEAVY == set()
    assert "pint" not in modules


def test_reading_hardware_loads_numpy_and_usb_only() -> None:
    modules = modules_after("import hw.reader")
    unwanted = {"scipy", "casadi", "pydantic", "click", "rich", "pyvisa", "pyvisa_py", "geometry", "solver", "probe_design"}
    assert modules & unwanted == set()
    assert {"hw", "numpy", "usb"} <= modules


def test_reading_a_scene_loads_nothing_heavy() -> None:
    path = ROOT / "tests" / "reference" / "axisymmetric" / "shallow.toml"
    modules = modules_after(f"from geometry import read_scene; read_scene({str(path)!r})")
    assert modules & (HEAVY | {"casadi"}) == set()
