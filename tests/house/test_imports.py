"""Import direction: geometry <- solver <- probe_design -> hw; and what a bare import must not load."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.paths import ROOT

# What each package may import of ours, and why:
# geometry and hw stand alone: a workshop needs no solver, a measuring computer neither shapes nor solvers;
# solver sees scenes only: results never depend on how they are asked for, optimised or shown.
ALLOWED = {
    "geometry": {"geometry"},
    "hw": {"hw"},
    "solver": {"solver", "geometry"},
    "probe_design": {"probe_design", "solver", "geometry", "hw"},
}
HEAVY = {"cadquery", "OCP", "matplotlib", "vtk", "vtkmodules", "pyvista", "pytetwild"}


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """Full names of the modules that a source imports anywhere in it, relative ones resolved."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_bytes(), str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level:
            yield ".".join([*package[: len(package) - node.level + 1], *filter(None, [node.module])])
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)


@pytest.mark.parametrize("package", ALLOWED)
def test_direction(package: str) -> None:
    assert sources(package)
    ours = ALLOWED.keys() - ALLOWED[package]
    wrong = [f"{path.relative_to(ROOT)} imports {name}" for path in sources(package) for name in imported(path)]
    assert [line for line in wrong if line.rsplit(" ", 1)[1].split(".")[0] in ours | {"tests", "benchmarks"}] == []


@pytest.mark.parametrize("package", ALLOWED)
def test_no_import_cycles(package: str) -> None:
    """The modules of a package can be put in an order in which each imports earlier ones only."""
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in sources(package)}
    needs = {name: {other for other in at_import(path) if other in names and other != name} for name, path in names.items()}
    done: set[str] = set()
    while ready := {name for name in needs.keys() - done if needs[name] <= done}:
        done |= ready
    assert sorted(needs.keys() - done) == []


def at_import(path: Path) -> Iterator[str]:
    """Modules that are imported when a source is, by its top-level statements; ``from package import module`` as module."""
    for node in ast.parse(path.read_bytes(), str(path)).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (ROOT / str(node.module) / "__init__.py").exists():
            submodules = {alias.name for alias in node.names if (ROOT / str(node.module) / f"{alias.name}.py").exists()}
            yield from (f"{node.module}.{name}" for name in submodules)
            if len(submodules) < len(node.names):
                yield str(node.module)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)


@pytest.mark.parametrize("module", ["geometry", "solver", "hw.reader", "hw.simulation.virtual"])
def test_bare_import_loads_nothing_heavy(module: str) -> None:
    found = modules_after(f"import {module}")
    assert found & HEAVY == set()
    assert "pint" not in found


def test_reading_hardware_loads_numpy_and_usb_only() -> None:
    found = modules_after("import hw.reader")
    assert (
        found & {"scipy", "casadi", "pydantic", "click", "rich", "pyvisa", "pyvisa_py", "geometry", "solver", "probe_design"}
        == set()
    )
    assert {"hw", "numpy", "usb"} <= found


def test_reading_a_scene_loads_nothing_heavy() -> None:
    path = ROOT / "tests" / "reference" / "axisymmetric" / "shallow.toml"
    found = modules_after(f"from geometry import read_scene; read_scene({str(path)!r})")
    assert found & (HEAVY | {"casadi"}) == set()


def modules_after(code: str) -> set[str]:
    """Top-level modules in a fresh interpreter after running the code."""
    program = f"{code}; import sys; print(*{{name.split('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.returncode == 0, run.stderr
    return set(run.stdout.split())
