"""Measure how many designs per second the closed form evaluates, and where the time goes.

``python -m benchmarks.closed_form.speed`` prints designs per second with their derivatives by E_object, and with those by all
parameters, on one thread and on two (halves of the designs); all is processor time; also designs that differ in
their inclusion alone. Beside them what one design needs of Bessel functions and of systems of equations, at the speed of these
alone; then the shares of the parts.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import process_time
from timeit import repeat
from typing import Any

import numpy as np

from benchmarks.closed_form.accuracy import REFERENCE, draw_designs
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from solver.closed_form import bessel
from solver.closed_form.designs import PROBE_PARAMETERS, TISSUE_PARAMETERS, Shape, compute_forces
from solver.linalg.memory import keep_freed
from solver.linalg.threads import limit_to_one_thread

NEAR_SIDE_OUTER_RADII = 2.0  # outer radii to the near sides
DESIGNS = 4096
REPEATS = 7
BESSEL, SOLVE = "values of Bessel functions", "flops of systems"
PARTS = {
    "_add_end_compliances": "blocks' ends", "_compute_works": "half-space under rings", "_choose_waves": "transforms of loads",
    "_compute_sides": "sides",
    "build_sphere_in_layer": "sphere's waves, image in bottom and surface",
    "compute_off_axis_response": "answer of the blocks off the axis",
    "compute_higher_moments": "sphere beyond its moments", "_interpolate": "of all: Bessel functions",
    "solve": "of all: systems of equations",
}  # fmt: skip


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    with limit_to_one_thread():  # two of BLAS would count twice
        measure()


def measure() -> None:
    """Print the tables."""
    keep_freed()
    rates = {BESSEL: _bessel_rate(), SOLVE: _solve_rate()}
    print(
        f"{1e9 * rates[BESSEL]:.1f} ns a value of Bessel functions, {1e-9 / rates[SOLVE]:.1f} Gflop/s in systems of 15 unknowns"
    )
    print(
        "| scene | a second | us | Bessel values | us | systems, flop | us | all derivatives, one alone, us |"
        " on two threads, us | one probe and tissue, a second |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    shares = []
    for name, scene in scenes():
        shape, values = draw_designs(scene, DESIGNS)
        spent = best(partial(compute_forces, shape, values)) / DESIGNS
        needs = _count_operations(shape, values[:, :512])
        limits = " | ".join(f"{needs[kind]:.0f} | {1e6 * needs[kind] * rates[kind]:.1f}" for kind in (BESSEL, SOLVE))
        all_gradients = best(partial(compute_gradients, shape, values[:, 0], np.flatnonzero(values[:, 0]).tolist()))
        two_threads = _two_threads(shape, values)
        last = f"{1e6 * all_gradients:.0f} | {1e6 * two_threads:.0f} | {_held(shape, values):.0f}"
        print(f"| {name} | {1 / spent:.0f} | {1e6 * spent:.0f} | {limits} | {last} |")
        shares.append((name, _shares(shape, values)))
    print("\n| part, % | " + " | ".join(name for name, _ in shares) + " |\n|---" + "|---" * len(shares) + "|")
    for part, text in PARTS.items():
        print(f"| {text} | " + " | ".join(f"{100 * share.get(part, 0.0):.0f}" for _, share in shares) + " |")


def scenes() -> Iterator[tuple[str, Scene]]:
    """Yield scenes on the axis, beside it, and both between near sides."""
    for folder, name, text in (("axisymmetric", "shallow", "on the axis"), ("solid", "flank", "off the axis")):
        scene = read_scene(REFERENCE / folder / f"{name}.toml")
        yield text, scene
        tissue, far = scene.tissue, NEAR_SIDE_OUTER_RADII * scene.probe.tube_radius
        sizes = {"radius": far} if tissue.shape == "cylinder" else {"length": 2 * far, "breadth": 2 * far}
        yield f"{text}, near sides", scene.model_copy(update={"tissue": tissue.model_copy(update=sizes)})


def best(run: Callable[[], object]) -> float:
    """Return the least of several runs, s."""
    run()
    return min(repeat(run, timer=process_time, number=1, repeat=REPEATS))


def compute_gradients(shape: Shape, values: Floats, which: Sequence[int]) -> tuple[Floats, Floats]:
    """Return forces of one design and their derivatives by some of its parameters, by complex steps: exact to rounding.

    Parameters
    ----------
    shape
        See ``Shape``.
    values
        The parameters, shape (parameters,).
    which
        Indices of k of them.

    Returns
    -------
    tuple[Floats, Floats]
        Forces and slope of the design, shape (2, 2, 2), and their derivatives, shape (k, 2, 2, 2).
    """
    steps = np.zeros((len(values), len(which)), dtype=complex)
    steps[list(which), range(len(which))] = 1e-30j * np.abs(values[list(which)])
    complex_forces = np.stack(compute_forces(shape, values[:, None] + steps), axis=1)
    return complex_forces[0].real, complex_forces.imag / (1e-30 * np.abs(values[list(which)]))[:, None, None, None]


def _held(shape: Shape, values: Floats) -> float:
    """Designs a second that differ in their inclusion alone."""
    repeated = values.copy()
    repeated[: len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)] = values[: len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS), :1]
    return DESIGNS / best(partial(compute_forces, shape, repeated))


def _two_threads(shape: Shape, values: Floats) -> float:
    """Processor seconds of a design on two threads."""
    halves = [values[:, k::2] for k in range(2)]
    with ThreadPoolExecutor(2) as pool:
        return best(lambda: list(pool.map(lambda half: compute_forces(shape, half), halves))) / DESIGNS


@contextmanager
def _count_calls(owner: Any, name: str, count: Callable[..., float], total: list[float]) -> Iterator[None]:
    """Add up what every call of a function counts."""
    original = getattr(owner, name)

    def call_counted(*arguments: Any) -> Any:
        total.append(count(*arguments))
        return original(*arguments)

    setattr(owner, name, call_counted)
    try:
        yield
    finally:
        setattr(owner, name, original)


def _count_operations(shape: Shape, values: Floats) -> dict[str, float]:
    """Values of Bessel functions, and flops of systems of equations, of one design."""
    looked: list[float] = []
    solved: list[float] = []
    with (
        _count_calls(bessel, "_interpolate", lambda x, tables: x.size * len(tables), looked),
        _count_calls(np.linalg, "solve", lambda a, b: len(a) * _flops(a.shape[-1], b.shape[-1]), solved),
    ):
        compute_forces(shape, values)
    return {BESSEL: sum(looked) / values.shape[1], SOLVE: sum(solved) / values.shape[1]}


def _flops(size: int, sides: int) -> float:
    return 2 / 3 * size**3 + 2 * size**2 * sides


def _bessel_rate() -> float:
    x = np.random.default_rng(1).uniform(0, 12, (512, 18))
    return best(lambda: [bessel.bessel(x, 9) for _ in range(10)]) / (10 * 9 * x.size)


def _solve_rate() -> float:
    K = np.random.default_rng(1).uniform(0, 1, (512, 15, 15)) + 15 * np.eye(15)
    return best(lambda: [np.linalg.solve(K, K[:, :, :5]) for _ in range(10)]) / (10 * 512 * _flops(15, 5))


def _shares(shape: Shape, values: Floats) -> dict[str, float]:
    """Share of the parts in all time."""
    profile = cProfile.Profile(process_time)
    profile.runcall(compute_forces, shape, values)
    seconds: dict[str, float] = {}
    stats: Any = pstats.Stats(profile)
    for (path, _, name), (_, _, _, spent, _) in stats.stats.items():
        if name in PARTS and ("closed_form" in path or Path(path).stem == "_linalg"):
            seconds[name] = spent / stats.total_tt
    return seconds


if __name__ == "__main__":
    main()
