"""Print the charge of bonded films against bond and thickness, and which design stress and charge select.

    python -m benchmarks.films.bonds [-o docs/pictures]

Results are those of the evaluator ``axisymmetric`` at an accuracy of 0.01.

Duration: two minutes.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm, spearmanr

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design.data.noise import DEFAULT_CHARGE_NOISE_C
from solver import evaluate
from solver.results.result import Result

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.toml"
TAPE_MODULI = np.geomspace(1e4, 1e10, 25)
FILM_THICKNESSES = (9e-6, 28e-6, 52e-6, 110e-6)  # the makers', m
TAPE = {"thickness": 50e-6, "youngs_modulus": 4e5, "poisson_ratio": 0.49}
GLUE = {"thickness": 20e-6, "youngs_modulus": 1e9, "poisson_ratio": 0.4}
FALSE_ALARMS = 0.05
STACKS: dict[str, dict[str, dict[str, float]]] = {
    "rigid bond on both sides": {},
    "glue, 1 GPa, 20 um on both sides": {"bond_to_base": GLUE, "bond_to_block": GLUE},
    "tape towards the base, 10 MPa, 50 um": {"bond_to_base": TAPE | {"youngs_modulus": 1e7, "poisson_ratio": 0.45}},
    "tape towards the base, 1 MPa, 50 um": {"bond_to_base": TAPE | {"youngs_modulus": 1e6, "poisson_ratio": 0.45}},
    "tape on both sides, 0.4 MPa, 50 um": {"bond_to_base": TAPE, "bond_to_block": TAPE},
}


@dataclass(frozen=True)
class Judged:
    """A scene's result, and what one reading of stress or of charge determines.

    Attributes
    ----------
    by_stress, by_charge
        Standard deviation of ln E_object.
    detected
        Probability that the tumour is detected by charge, with ``FALSE_ALARMS``.
    """

    result: Result
    by_stress: float
    by_charge: float
    detected: float


def with_film(scene: Scene, film: dict[str, object]) -> Scene:
    """Return a scene with a film table; its readings are charges."""
    tables = scene.model_dump(exclude_unset=True)
    tables["probe"]["film"] = film
    return Scene.from_tables(tables | {"reading": {"observable": "charge"}})


def judge(scene: Scene) -> Judged:
    """Evaluate a scene and return the standard deviations of ln E_object.

    The only noise is that of the charges, ``DEFAULT_CHARGE_NOISE_C`` each. By stress a charge is taken as d33 times the force.
    """
    result, film = evaluate(scene, evaluator="axisymmetric"), scene.probe.film
    assert film is not None
    areas = scene.probe.inner_area, scene.probe.outer_area
    stresses = np.array([result.stress_inner, result.stress_outer], dtype=float)
    by_force = abs(film.d33) * stresses * areas
    charges = np.array([result.charge_inner, result.charge_outer], dtype=float)

    noise_stress, noise_charge = (np.linalg.norm(DEFAULT_CHARGE_NOISE_C / signals) for signals in (by_force, charges))
    # the same scene without the tumour, whose Poisson's ratio is the tissue's
    plain = evaluate(scene.replace({"inclusion[0].youngs_modulus": scene.tissue.youngs_modulus}), evaluator="axisymmetric")
    change = abs(np.log((result.charge_ratio or np.nan) / (plain.charge_ratio or np.nan))) / noise_charge
    threshold = norm.isf(FALSE_ALARMS / 2)
    return Judged(
        result,
        float(noise_stress / abs(result.log_sensitivity or np.nan)),
        float(noise_charge / abs(result.charge_log_sensitivity or np.nan)),
        float(norm.sf(threshold - change) + norm.cdf(-threshold - change)),
    )


def print_stacks(scene: Scene) -> None:
    """Print charges per force and log-sensitivities of the example scene with five stacks, FILM.md's first table."""
    rows = []
    for name, bonds in STACKS.items():
        judged = judge(with_film(scene, dict(bonds)))
        r = judged.result
        rows.append(
            (name, _picocoulombs(r.charge_per_force_inner), _picocoulombs(r.charge_per_force_outer), f"{r.charge_ratio:.3f}",
             f"{r.charge_log_sensitivity:.4f}", f"{r.log_sensitivity:.4f}", f"{judged.by_charge:.2f}")
        )  # fmt: skip
    header = ("stack", "inner, pC/N", "outer, pC/N", "charge ratio", "S by charge", "S by stress", "sd of ln E")
    print_table(header, rows)


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    for cells in (header, ["---"] * len(header), *rows):
        print(f"| {' | '.join(cells)} |", flush=True)
    print()


def _picocoulombs(value: float | None) -> str:
    return "-" if value is None else f"{1e12 * value:.2f}"


def draw_tapes(scene: Scene, folder: Path) -> None:
    """Draw charge per force and sd of ln E_object against the tape's modulus, for films of several thicknesses."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    left, right, detection = figure.subplots(1, 3)
    rows = []
    for color, thickness in zip(("C0", "C1", "C2", "C3"), FILM_THICKNESSES, strict=True):
        judged = []
        for modulus in TAPE_MODULI:
            tape = TAPE | {"youngs_modulus": float(modulus), "poisson_ratio": 0.45}
            judged.append(judge(with_film(scene, {"thickness": thickness, "bond_to_base": tape, "bond_to_block": tape})))
        inner, outer = (
            np.array([-1e12 * (getattr(item.result, f"charge_per_force_{block}") or np.nan) for item in judged])
            for block in ("inner", "outer")
        )
        name = f"{1e6 * thickness:g} um"
        detection.semilogx(TAPE_MODULI, [100 * item.detected for item in judged], color=color, label=f"film {name}")
        left.loglog(TAPE_MODULI, inner, color=color, label=f"film {name}, inner")
        left.loglog(TAPE_MODULI, outer, "--", color=color, label="outer")
        right.loglog(TAPE_MODULI, [item.by_charge for item in judged], color=color, label=f"film {name}")
        best = int(np.argmin([item.by_charge for item in judged]))
        detected = (f"{100 * judged[k].detected:.0f}" for k in (best, -1))
        ends = f"{inner[0]:.0f}", f"{inner[-1]:.1f}", f"{TAPE_MODULI[best]:.1e}"
        rows.append((name, *ends, f"{judged[best].by_charge:.2f}", *detected))
    labels = "charge per force, -pC/N", "sd of ln E_object, one reading at 10 mN", "detected of 100, 5 false alarms"
    for axes, label in zip((left, right, detection), labels, strict=True):
        axes.set_xlabel("Young's modulus of the tapes, Pa")
        axes.set_ylabel(label)
        axes.grid(True, which="both", alpha=0.3)
        axes.legend(fontsize=7)
    figure.savefig(folder / "film-bonds.png", dpi=110)
    best_columns = "best modulus of the tapes, Pa", "sd of ln E there", "detected of 100 there", "detected at 10 GPa"
    print_table(("film", "inner at 10 kPa, -pC/N", "inner at 10 GPa", *best_columns), rows)


def compare_designs(scene: Scene) -> None:
    """Print the best of 27 designs by stress and by charge, each judged by charge, with tapes on both sides."""
    rows, keys = [], []
    for radius, height, ratio in itertools.product((3e-3, 4e-3, 6e-3), (1.5e-3, 3e-3, 6e-3), (0.6, 1.2, 2.4)):
        design = scene.replace({"probe.inner_radius": radius, "probe.height": height, "probe.area_ratio": ratio})
        try:
            rows.append(judge(with_film(design, {"bond_to_base": TAPE, "bond_to_block": TAPE})))
        except ProbeError as refusal:
            print(f"left out: {radius}, {height}, {ratio}: {refusal}")
            continue
        keys.append(f"radius {1e3 * radius:g} mm, height {1e3 * height:g} mm, A2/A1 {ratio:g}")
    by_stress, by_charge = (np.array([getattr(row, name) for row in rows]) for name in ("by_stress", "by_charge"))
    print(f"rank correlation of the sd of ln E_object by stress and by charge: {spearmanr(by_stress, by_charge).statistic:.2f}")
    table = []
    for name, order in (("stress", by_stress), ("charge", by_charge)):
        best = int(np.argmin(order))
        table.append((name, keys[best], f"{by_stress[best]:.2f}", f"{by_charge[best]:.2f}"))
    print_table(("selected by", "design", "sd by stress", "sd by charge"), table)


def main() -> None:
    """Print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/pictures"))
    folder = parser.parse_args().output
    scene = read_scene(EXAMPLE)
    print_stacks(scene)
    draw_tapes(scene, folder)
    compare_designs(scene)


if __name__ == "__main__":
    main()
