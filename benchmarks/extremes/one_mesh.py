"""Check the error bounds that one mesh states (eqs. AX.10, AX.11) against order 8, on drawn scenes and all references.

Every drawn scene has one tumour on the axis (``inclusion_draws``) and, where that is asked, one to three layers of tissue. What
order 8 itself is off counts against the bounds; bounds of the light mesh above 1 % are not believed, and left out. One line for
each bound that is smaller than the error, then a table by mesh.

    python -m benchmarks.extremes.one_mesh --scenes 250 --seed 1 --seed 2 --seed 3 --seed 4 --truths truths.jsonl
    python -m benchmarks.extremes.one_mesh --scenes 110 --seed 41 --seed 42 --layers --no-curves --truths truths.jsonl
    python -m benchmarks.extremes.one_mesh --scenes 0 --references

Order 8, which takes most of the time, is read from a file of an earlier run where one is named: bounds may change, what is
true does not.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.evaluators.inclusion_draws import draw, draw_skins
from benchmarks.tables import MeasuredTable
from geometry import InputError, Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.lower_order import bound_by_descent, bound_by_last_degree, bound_by_lower_order, is_graded_everywhere
from solver.axisymmetric.refinement import LIGHT_MESH, MAX_LIGHT_MESH_BOUND, MESH_LEVELS, SampleErrors
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.linalg.workspace import get_workspace

FOLDERS = ("axisymmetric", "extra", "extreme", "extremes", "half-space", "tissue-layers")
REFERENCES = Path(__file__).parents[2] / "tests" / "reference"
TRUTH_LEVEL, ONE_MESH = MESH_LEVELS[4], {"light": LIGHT_MESH, "4": MESH_LEVELS[1], "5": MESH_LEVELS[2], "6": MESH_LEVELS[3]}
OWN_BOUND_SUFFIX, ONE_STEP_SUFFIX, CURVE_SUFFIX = (
    ", of its own",
    ", near",
    ", curve",
)  # what is told without a smaller space, by one step; of all moduli
CURVES = {"light": LIGHT_MESH, "6": MESH_LEVELS[3]}
CURVE_MODULUS_FACTORS = (0.01, 1.0, 100.0)  # moduli of a curve, over the scene's own
SENSITIVITY_ACCURACY = 1e-5  # absolute, that a log-sensitivity is promised to
# by mesh: error over bound of totals and of log-sensitivity; largest bounds on the ratio and on a total
Shares = dict[str, tuple[float, float, float, float]]


@dataclass(frozen=True)
class TrueForces:
    """What order 8 says: both films' totals at k moduli, (k, 2), their rounding, (2,), and the log-sensitivities, (k,)."""

    totals: list[list[float]]
    rounding: list[float]
    log_sensitivity: list[float]

    @classmethod
    def from_sample(cls, sample: MeshSample) -> TrueForces:
        """Keep what is compared."""
        return cls(sample.totals.tolist(), sample.rounding.tolist(), sample.log_sensitivities[:, 0].tolist())


Truths = dict[str, TrueForces]  # by "lone" and "curve"


def draw_case(seed: int, number: int, layers: bool) -> Scene | None:
    """Return a scene, or None where its parts do not fit."""
    try:
        return (draw_skins if layers else draw)(seed, number).scene()
    except (InputError, ValueError):
        return None


def references() -> Iterator[tuple[str, Scene]]:
    """Yield the references that the evaluator takes."""
    for path in (path for folder in FOLDERS for path in sorted((REFERENCES / folder).glob("*.toml"))):
        scene = read_scene(path)
        if Axisymmetric().refusal(scene) is None and is_graded_everywhere(build_sections(scene).section):
            yield f"{path.parent.name}/{path.stem}", scene


def truths(scene: Scene, curve: bool) -> Truths:
    """Solve on the finest mesh, at the scene's own modulus and, if that is asked, on a curve.

    Raises
    ------
    SolveError
        The mesh cannot be solved.
    """
    sections = build_sections(scene)
    true_forces = {"lone": TrueForces.from_sample(solve_on_mesh(sections.section, sections, scene, TRUTH_LEVEL))}
    if curve and scene.inclusion:
        true_forces["curve"] = TrueForces.from_sample(
            solve_on_mesh(sections.section, sections, scene, TRUTH_LEVEL, moduli=_moduli(scene))
        )
    return true_forces


def shares(scene: Scene, true: Truths) -> Shares:
    """Return errors over bounds of one scene, by mesh.

    Raises
    ------
    SolveError
        A mesh cannot be solved.
    """
    sections = build_sections(scene)
    solved = {name: solve_on_mesh(sections.section, sections, scene, level) for name, level in ONE_MESH.items()}
    results = {name: _share(sample, bound_by_lower_order(sample), true["lone"]) for name, sample in solved.items()}
    for kind, tell in ((OWN_BOUND_SUFFIX, bound_by_last_degree), (ONE_STEP_SUFFIX, bound_by_descent)):
        results |= {
            f"{name}{kind}": _share(sample, bounds, true["lone"]) for name, sample in solved.items() if (bounds := tell(sample))
        }
    if "curve" in true:
        for name, level in CURVES.items():
            sample = solve_on_mesh(sections.section, sections, scene, level, moduli=_moduli(scene))
            results[f"{name}{CURVE_SUFFIX}"] = _share(
                sample, bound_by_last_degree(sample) or bound_by_lower_order(sample), true["curve"]
            )
    return {name: sample for name, sample in results.items() if not name.startswith("light") or sample[3] <= MAX_LIGHT_MESH_BOUND}


def _moduli(scene: Scene) -> Floats:
    return scene.inclusion[0].youngs_modulus * np.array(CURVE_MODULUS_FACTORS)


def _share(sample: MeshSample, bounds: SampleErrors, true: TrueForces) -> tuple[float, float, float, float]:
    differences = np.abs(sample.totals - true.totals) / (bounds.totals + true.rounding)
    derivative = np.abs(sample.log_sensitivities[:, 0] - true.log_sensitivity) / np.maximum(
        bounds.sensitivity[:, 0], SENSITIVITY_ACCURACY
    )
    relative = bounds.totals / np.abs(sample.totals)
    return float(differences.max()), float(derivative.max()), float(relative.sum(axis=1).max()), float(relative.max())


def read(path: Path | None) -> dict[str, Truths]:
    """Return what earlier runs left in a file, by scene."""
    rows = (json.loads(row) for row in path.read_text().splitlines()) if path and path.exists() else ()
    return {name: {kind: TrueForces(**values) for kind, values in entries.items()} for name, entries in rows}


def table(all_shares: list[Shares]) -> MeasuredTable:
    """Return the largest and usual shares by mesh."""
    columns = (
        "order of the mesh",
        "scenes",
        "error / bound, times",
        "99 of 100, times",
        "median, times",
        "of log-sensitivity, times",
    )
    printed = MeasuredTable("errors over their bounds from one mesh", (*columns, "median bound on the ratio, error"))
    for name in sorted({name for scene_shares in all_shares for name in scene_shares}):
        rows = [scene_shares[name] for scene_shares in all_shares if name in scene_shares]
        totals, derivatives, sizes, _ = (np.array(column) for column in zip(*rows, strict=True))
        spread = (totals.max(), np.quantile(totals, 0.99), np.median(totals), derivatives.max())
        printed.add(name, str(len(rows)), *map(float, spread), float(np.median(sizes)))
    return printed


def main() -> None:
    """Draw, solve, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=250, help="drawn scenes of each seed (250)")
    parser.add_argument("--first", type=int, default=0, help="number of the first drawn scene (0)")
    parser.add_argument("--seed", type=int, action="append", help="of drawn scenes (1)")
    parser.add_argument("--layers", action="store_true", help="drawn scenes have layers of tissue")
    parser.add_argument("--no-curves", action="store_true", help="leave those out, which take half of the time")
    parser.add_argument("--references", action="store_true", help="all references that the level takes, too")
    parser.add_argument("--truths", type=Path, help="file of what order 8 says, read and added to")
    parser.add_argument("--truths-only", action="store_true", help="add to it alone")
    options, all_shares = parser.parse_args(), []
    known = read(options.truths)
    numbers = range(options.first, options.first + options.scenes)
    kind = "layers, " * options.layers
    named = [
        (f"{kind}seed {seed}, number {k}", draw_case(seed, k, options.layers)) for seed in options.seed or [1] for k in numbers
    ]
    cases = [(name, scene) for name, scene in named if scene is not None]
    with threadpool_limits(1), Console(stderr=True).status("one mesh") as status:
        for name, scene in cases + list(references() if options.references else ()):
            status.update(name)
            get_workspace().begin()  # what earlier scenes needed may go
            try:
                if name not in known:
                    known[name] = truths(scene, not options.no_curves)
                    if options.truths:
                        with options.truths.open("a") as kept:
                            kept.write(json.dumps([name, {kind: asdict(entry) for kind, entry in known[name].items()}]) + "\n")
                if options.truths_only:
                    continue
                entry = shares(scene, known[name])
            except (SolveError, Refusal) as fault:
                print(f"{name}: {fault}")
                continue
            all_shares.append(entry)
            for mesh, (totals, derivatives, *_) in entry.items():
                if max(totals, derivatives) > 1:
                    print(
                        f"{name}: order {mesh}, totals {totals:.2f}, log_sensitivity {derivatives:.2f} times the bound",
                        flush=True,
                    )
    if all_shares:
        table(all_shares).print(Console(width=150))


if __name__ == "__main__":
    main()
