"""Make ``tests/reference/contact/film_charges.json``: charges of bonded films under a hand's load through a skin, by NGSolve.

The probe of ``examples/skin.toml`` and others, pressed by ``pressed_films.py`` on two ``MESHES``. What a mesh is off at rest is
taken off as a factor: the truth there is ``FINEST``. A value is that of the finer mesh, its uncertainty (``_unc``) the difference
of both. Where faces slide, the log-sensitivity is a difference of states: ``ContactBoundary`` holds normals in its tangent, which
is then off by 1 to 3 %. The law is that of the materials, by default

    W = mu/2 (J^(-2/3) I1 - 3) + K/4 (J^2 - 1 - 2 ln J).

Usage: ``python -m benchmarks.references.loaded_film_charges FILE [CASE ...]``, which keeps the file's other cases

Duration: 15 minutes.
"""

from __future__ import annotations

import json
import sys
import time
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.contact.ngsolve_pressing import ContactSetting
from benchmarks.references.pressed_films import LoadedCharges, PressedFilms
from geometry import Scene
from geometry.common.arrays import Floats

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "skin.toml"
MESHES = (  # setting, layers at the ends of films and bonds
    (ContactSetting(4, 1.5, layers=1, mixed=True, tolerance=3e-5), 1),
    (ContactSetting(4, 1.2, layers=1, mixed=True, tolerance=3e-5), 1),
)
FINEST = (ContactSetting(7, 0.6, layers=6, mixed=True), 6)
FORCES, MORE_FORCES = (0.1, 0.3), (0.1, 0.3, 0.5)  # N
STEP = 0.08  # of the indentation, inner radii
KEPT_VALUES = ("indentation", "charge_inner", "charge_outer", "charge_ratio", "charge_log_sensitivity")
SMALL_VALUES = ("charge_per_force_inner", "charge_per_force_outer", "charge_log_sensitivity")
GLUE = {"thickness": 20e-6, "youngs_modulus": 1.7e9, "poisson_ratio": 0.4}
TAPE = {"thickness": 50e-6, "youngs_modulus": 3e5, "poisson_ratio": 0.49}
DRAGON_SKIN = {"youngs_modulus": 169e3, "poisson_ratio": 0.495, "law": "yeoh", "c2_over_c1": 0.122}  # the catalogue's numbers
ECOFLEX = {"youngs_modulus": 68.34e3, "poisson_ratio": 0.495, "law": "yeoh", "c2_over_c1": 0.034}
SILICONES = {"inner": DRAGON_SKIN, "outer": ECOFLEX, "outer_radius": 8e-3, "gap": 0.3e-3, "height": 4e-3}
FOREARM = (1.2e-3, 150e3, 10e3)


@dataclass(frozen=True)
class ChargeCase:
    """Bonds to block and base; the skin's thickness (m) and modulus, and that of what is below it (Pa), else the example's.

    ``probe`` replaces keys of the example's.
    """

    to_block: dict[str, float]
    to_base: dict[str, float]
    skin: tuple[float, float, float] | None = None
    film_thickness: float = 110e-6
    inset: float = 0.0
    probe: dict[str, Any] | None = None
    interface: str = "bonded"
    forces: tuple[float, ...] = FORCES


CASES = {
    "breast, tapes": ChargeCase(TAPE, TAPE),
    "breast, glue": ChargeCase(GLUE, GLUE),
    "thin stiff skin, tape to base": ChargeCase(GLUE, TAPE, skin=(0.5e-3, 300e3, 6e3)),
    "thick skin, tapes": ChargeCase(TAPE, TAPE, skin=(2e-3, 50e3, 6e3)),
    "forearm, glue": ChargeCase(GLUE, GLUE, skin=FOREARM),
    "forearm, thin film, tapes": ChargeCase(TAPE, TAPE, skin=FOREARM, film_thickness=28e-6, inset=0.2e-3),
    "silicone blocks, tape to base": ChargeCase(GLUE, TAPE, skin=FOREARM, probe=SILICONES, forces=MORE_FORCES),
    "silicone blocks, frictionless": ChargeCase(GLUE, TAPE, skin=FOREARM, probe=SILICONES, interface="frictionless"),
}


def build_tables(case: ChargeCase) -> dict[str, Any]:
    """Return the tables of a case's scene, SI, without its load."""
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    film = {"thickness": case.film_thickness, "electrode_inset": case.inset}
    tables["probe"]["film"] = film | {"bond_to_block": case.to_block, "bond_to_base": case.to_base}
    if case.skin is not None:
        thickness, skin, below = case.skin
        tables["tissue"]["youngs_modulus"] = below
        tables["tissue"]["layer"][0] |= {"thickness": thickness, "youngs_modulus": skin}
    tables["contact"]["interface"] = case.interface
    if case.probe is not None:
        tables["probe"] = {key: value for key, value in tables["probe"].items() if key != "area_ratio"} | case.probe
    return {key: table for key, table in tables.items() if key != "load"}


def compute_values(scene: Scene, state: LoadedCharges, correction: Floats, sensitivity: float) -> Floats:
    """Return ``KEPT_VALUES`` of a state, its charges times ``correction`` and log-sensitivity times ``sensitivity``."""
    charges, probe = state.charges * correction, scene.probe
    ratio = charges[0] / charges[1] * probe.outer_area / probe.inner_area
    return np.array([state.indentation, *charges, ratio, state.log_sensitivity * sensitivity])


def press(scene: Scene, forces: tuple[float, ...], mesh: tuple[ContactSetting, int], truth: LoadedCharges) -> list[Floats]:
    """Return ``KEPT_VALUES`` at those of the forces that one mesh reaches."""
    start, problem, rows = time.process_time(), PressedFilms(scene, *mesh), list[Floats]()
    unloaded = problem.measure_at_rest()
    factors, stiffer = truth.charges / unloaded.charges, float(truth.forces.sum() / unloaded.forces.sum())
    try:
        for force in forces:
            problem.press_to_force(force / stiffer, STEP)
            state = problem.measure()
            if scene.contact.interface == "frictionless":
                state = replace(state, log_sensitivity=problem.compute_difference(force / stiffer, STEP))
            rows.append(compute_values(scene, state, factors, truth.log_sensitivity / unloaded.log_sensitivity))
            print(mesh, force, rows[-1].tolist(), f"{time.process_time() - start:.0f} s", file=sys.stderr, flush=True)
    except ArithmeticError as fault:
        print(mesh, fault, file=sys.stderr, flush=True)
    return rows


def entry(case: ChargeCase) -> dict[str, Any]:
    """Return a case's scene and rows as the file has them."""
    tables = build_tables(case)
    scene = Scene.from_tables(tables | {"load": {"force": case.forces[0]}})
    truth, rows = PressedFilms(scene, *FINEST).measure_at_rest(), []
    for force, coarse, fine in zip(case.forces, *(press(scene, case.forces, mesh, truth) for mesh in MESHES), strict=False):
        row = {"force": force} | {key: float(f"{x:.6g}") for key, x in zip(KEPT_VALUES, fine, strict=True)}
        changes = np.abs(fine - coarse)
        rows.append(row | {f"{key}_unc": float(f"{x:.2g}") for key, x in zip(KEPT_VALUES, changes, strict=True)})
    per_force = truth.charges / truth.forces.sum()
    at_rest = dict(zip(SMALL_VALUES, [*per_force, truth.log_sensitivity], strict=True))
    return {"scene": tables, "small_load": {key: float(f"{x:.6g}") for key, x in at_rest.items()}, "rows": rows}


def main(path: Path, names: list[str]) -> None:
    """Write the file, after each case."""
    ngs.SetNumThreads(1)
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in names or CASES:
        entries[name] = entry(CASES[name])
        path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
