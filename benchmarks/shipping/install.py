"""Install the wheel into an empty environment, try it there, and print time and size by package.

The environment holds what pip takes for the wheel, and nothing else. `pip check` finds no conflict, and the program runs there.
``--cold`` leaves pip's cache aside, so that everything is downloaded. The continuous integration runs it without.

Duration: a minute.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path
from time import perf_counter
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"geometry", "hw", "probe_design", "solver"}
SHOWN_MB = 10.0  # smaller packages are summed in one line
OPTIONAL_USES = {  # what could become an extra: packages that only some commands load
    "cadquery": "export, solid", "cadquery-ocp": "export, solid", "llvmlite": "none: cadquery", "numba": "none: cadquery",
    "trame-vuetify": "none: cadquery", "casadi": "optimize", "netgen-mesher": "solid",
    "netgen-occt": "solid", "pytetwild": "solid, bodies from files", "pyvista": "solid pictures", "vtk": "solid pictures",
    "ezdxf": "export", "h5py": "HDF5 files", "matplotlib": "pictures",
}  # fmt: skip


def build_wheel(folder: Path) -> Path:
    """Build the wheel of this tree, and check that it holds the four packages and nothing else."""
    words = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run([sys.executable, *words], check=True)
    (wheel,) = folder.glob("*.whl")
    held = {name.partition("/")[0] for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    if held != PACKAGES:
        raise SystemExit(f"the wheel holds {', '.join(sorted(held))}; expected: {', '.join(sorted(PACKAGES))}")
    return wheel


def install(wheel: Path, home: Path, *, cold: bool) -> float:
    """Install the wheel with all that it requires into a new environment; return the seconds that pip took."""
    venv.create(home, with_pip=True)
    words = [
        "-m",
        "pip",
        "install",
        "--quiet",
        *(["--no-cache-dir"] if cold else []),
        "-c",
        str(ROOT / "constraints.txt"),
        str(wheel),
    ]
    start = perf_counter()
    subprocess.run([str(find_programs(home) / "python"), *words], check=True)
    return perf_counter() - start


def try_out(home: Path) -> None:
    """Run ``pip check`` and the program in the environment, away from this tree."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    programs = find_programs(home)
    for command in (
        [programs / "python", "-m", "pip", "check"],
        [programs / "probe-design", "--version"],
        [programs / "probe-design", "evaluate", ROOT / "examples" / "scene.toml", "--accuracy", "0.05"],
    ):
        subprocess.run([str(word) for word in command], cwd=home, env=environment, check=True, stdout=subprocess.DEVNULL)


def find_programs(home: Path) -> Path:
    """Return the folder of an environment's programs."""
    return home / ("Scripts" if os.name == "nt" else "bin")


def measure_sizes(home: Path) -> Iterator[tuple[str, float]]:
    """Yield name and size, MB on disk, of each distribution of an environment."""
    for path in [*home.glob("lib/python*/site-packages"), *home.glob("Lib/site-packages")]:
        for distribution in distributions(path=[str(path)]):
            yield distribution.metadata["Name"], sum(_list_sizes(distribution)) / 1e6


def _list_sizes(distribution: Distribution) -> Iterator[int]:
    """Yield the sizes of a distribution's files, bytes, as its record states them."""
    for row in csv.reader(io.StringIO(distribution.read_text("RECORD") or "")):
        if len(row) == 3 and row[2]:
            yield int(row[2])


def main() -> None:
    """Build, install, try out and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cold", action="store_true", help="leave pip's cache aside")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "alone"
        seconds = install(build_wheel(Path(folder)), home, cold=options.cold)
        try_out(home)
        sizes = sorted(measure_sizes(home), key=lambda row: -row[1])
    print(f"{len(sizes)} packages, {sum(size for _, size in sizes):.0f} MB on disk, installed in {seconds:.0f} s\n")
    print("| package | MB | needed by some commands only |\n|---|---|---|")
    for name, size in sizes:
        if size >= SHOWN_MB:
            print(f"| {name} | {size:.0f} | {OPTIONAL_USES.get(name.lower().replace('_', '-'), '')} |")
    print(f"| {sum(size < SHOWN_MB for _, size in sizes)} others | {sum(size for _, size in sizes if size < SHOWN_MB):.0f} | |")


if __name__ == "__main__":
    main()
