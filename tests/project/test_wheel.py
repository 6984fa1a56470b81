"""What the wheel holds, and what installs from it therefore find."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tomllib
import venv
from importlib.util import find_spec
from pathlib import Path
from zipfile import ZipFile

import pytest

import probe_design
from geometry.provenance.block import DISTRIBUTION
from tests.support.paths import ROOT

PACKAGES = ("geometry", "hw", "probe_design", "solver")


def test_the_distribution_is_called_as_the_project_looks_it_up() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (project["name"], project["version"]) == (DISTRIBUTION, probe_design.__version__)


def test_wheel_holds_every_source_and_all_data(tmp_path: Path) -> None:
    """Slow without hatchling beside: pip then fetches it, 15 s."""
    options = ["--no-build-isolation"] if find_spec("hatchling") else []
    words = ["-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-deps", *options, "--wheel-dir", str(tmp_path)]
    ended = subprocess.run([sys.executable, *words, str(ROOT)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    (wheel,) = tmp_path.glob("*.whl")
    held = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = (path for package in PACKAGES for path in (ROOT / package).rglob("*.*") if path.is_file())
    assert held == {path.relative_to(ROOT).as_posix() for path in files if path.suffix != ".pyc"}
    assert {Path(name).suffix for name in held} >= {".py", ".json", ".npy", ".toml", ".in", ".js", ".rules"}


SMOKE = """
import json, sys
from pathlib import Path
import geometry, hw, probe_design, solver
from probe_design.data.builtin import read_loaded_builtin_scene
from probe_design.reporting.page import Text, Chapter, build_page
from geometry.provenance.block import build_provenance
from geometry.scenes.scene_file import scene_to_toml
for package in (geometry, hw, probe_design, solver):
    assert sys.argv[1] in package.__file__, package.__file__
scene = read_loaded_builtin_scene()
Path("scene.toml").write_text(scene_to_toml(scene))
found = probe_design.evaluate("scene.toml", evaluator="closed-form", accuracy=0.1)
answer = {"ratio": found.ratio, "provenance": build_provenance(scene)}
assert "WebGL" in build_page("Smoke", "It works.", [Chapter("One", (Text("text"),))], answer)
"""


@pytest.mark.slow
def test_what_is_built_works_alone(tmp_path: Path) -> None:
    """The wheel of the sdist in a bare environment, its dependencies beside; this tree is not among what can be imported."""
    sdist = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
    subprocess.run(sdist, cwd=ROOT, check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    words = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path), str(archive)]
    subprocess.run([*pip, *words], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    home = tmp_path / "alone"
    venv.create(home, with_pip=False)
    programs = home / ("Scripts" if os.name == "nt" else "bin")
    python, program = programs / "python", programs / "probe-design"
    subprocess.run([*pip, "--python", str(python), "install", "--no-deps", str(wheel)], check=True, capture_output=True)
    environment = {**os.environ, "PYTHONPATH": sysconfig.get_path("purelib")}

    def alone(*words: str) -> str:
        ended = subprocess.run([str(python), *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    alone("-c", SMOKE, str(home))
    output = json.loads(alone(str(program), "evaluate", "scene.toml", "--evaluator", "closed-form", "--json"))
    assert output["provenance"]["command"][0] == "evaluate"
    assert "breast" in alone("-m", "probe_design", "tissue", "list")
