"""What a command imports: the start is short because what it does not need waits. Modules are held, not times."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from probe_design.commands.names import COMMANDS
from tests.support.paths import EXAMPLES, REFERENCE

SCENE = REFERENCE / "axisymmetric" / "shallow.toml"
BESIDE = EXAMPLES / "two-tumours.toml"
OURS = {"geometry", "solver", "probe_design"}
SCENES = OURS | {"click", "numpy", "pydantic", "pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}
# every evaluator's limits of the load come from the coarsest mesh, so that all print the same ones
ELEMENTS = {"scipy", "threadpoolctl", "pymklpardiso", "charset_normalizer", "cython_runtime"}
HEAVY = {
    "OCP", "cadquery", "casadi", "dask", "distributed", "matplotlib", "netgen", "pandas", "pint", "pytetwild", "pyvista", "usb",
    "vtk", "xarray",
}  # fmt: skip
PROGRAM = """
import json, sys
lines = json.loads(sys.argv[1])
before = set(sys.modules)
from probe_design.commands.main import main
for line in lines:
    sys.argv = ["probe-design", *line]
    try:
        main()
    except SystemExit as ended:
        assert not ended.code, ended
    print(*sorted(set(sys.modules) - before), file=sys.stderr)
    before = set(sys.modules)
"""


def list_modules_one_after_another(lines: list[list[str]]) -> list[set[str]]:
    """Modules that each of several commands imports in a process, without those that the commands before it have imported."""
    command = [sys.executable, "-W", "error", "-c", PROGRAM, json.dumps(lines)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert ended.returncode == 0, ended.stderr
    return [set(line.split()) for line in ended.stderr.split("\n")[-1 - len(lines) : -1]]


def run_and_list_modules(*arguments: object) -> set[str]:
    """Modules that a command imports in a process of its own."""
    (imported,) = list_modules_one_after_another([[str(argument) for argument in arguments]])
    return imported


def top_level(names: set[str]) -> set[str]:
    """Top-level modules of others and ours, without those of Python."""
    return {name.split(".")[0] for name in names if not name.startswith("_")} - sys.stdlib_module_names


def modules(*arguments: object) -> set[str]:
    return top_level(run_and_list_modules(*arguments))


@pytest.mark.parametrize("arguments", [["--help"], ["tissue", "--help"], ["--version"]])
def test_help_needs_click_alone(arguments: list[str]) -> None:
    assert modules(*arguments) == {"click", "probe_design"}


def find_unwanted(lines: list[list[str]], allowed: set[str]) -> dict[str, set[str]]:
    """What any of these commands imports beside the allowed modules: one process, as no command may import more than these."""
    imported = list_modules_one_after_another(lines)
    unwanted = {" ".join(line): top_level(names) - allowed for line, names in zip(lines, imported, strict=True)}
    return {line: names for line, names in unwanted.items() if names}


def test_help_of_a_command_needs_the_models_of_scenes_alone() -> None:
    """Not NumPy, no solver, no tables: 0.15 s of processor, of which pydantic and the models take two thirds."""
    lines = [[*name.split(), "--help"] for name, command in COMMANDS.items() if command.request]
    assert find_unwanted(lines, SCENES - {"numpy", "solver"}) == {}


def test_formulas_need_no_more_than_elements_do() -> None:
    cases = [("published", SCENE), ("closed-form", SCENE), ("closed-form", BESIDE)]
    lines = [["evaluate", str(scene), "--evaluator", evaluator, "--json"] for evaluator, scene in cases]
    assert find_unwanted(lines, SCENES | ELEMENTS) == {}


def test_a_table_needs_rich() -> None:
    imported = modules("evaluate", SCENE, "--evaluator", "closed-form")
    assert imported - SCENES - ELEMENTS - {"rich"} <= {"markdown_it", "mdurl", "pygments"}


def test_elements_need_no_cad_no_plots_no_tables() -> None:
    names = run_and_list_modules("evaluate", SCENE, "--accuracy", "0.1", "--json")
    assert top_level(names) & HEAVY == set()
    assert {"scipy", "threadpoolctl"} <= top_level(names)
    # a fifth of the whole start, which only other evaluators need
    assert (
        names & {"scipy.interpolate", "scipy.optimize", "scipy.special", "solver.contact.evaluator", "solver.solid.evaluator"}
        == set()
    )
