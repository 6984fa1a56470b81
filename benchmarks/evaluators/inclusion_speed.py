"""Time ``equivalent-inclusion``: the probe once, tumours to first order and with reflections, one map. One thread.

Everything is timed under one probe (``SCENE``), in one run; wall-clock and process time side by side show how
busy the machine is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

from benchmarks.tables import MeasuredTable
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from solver import Result, evaluate
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_undisturbed
from solver.equivalent_inclusion.readings import REFLECTION_TOLERANCE_RELATIVE, Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.close_exchange import CloseExchange
from solver.multiple_scattering.exchange import Exchange, Reflector
from solver.multiple_scattering.lockstep import run_in_lockstep
from solver.multiple_scattering.solve import arrange_spheres, iterate_scattering

SCENE = Path(__file__).parents[2] / "tests" / "reference" / "off-axis" / "stiff-cover-0.25-offset-1.toml"
ACCURACIES = (0.01, 0.003, 0.001)
TUMOUR_COUNT = 10_000
COVERS = (0.1, 0.25, 0.5)  # diameters
OFFSETS = (0.0, 0.5, 1.0, 2.0)  # outer radii
DIAMETER = 8e-3
ORDERS = 9
BATCH = 24  # tumours in one call: enough for the orders' matrices
MAP_DEPTHS, MAP_DIAMETERS = (6e-3, 24e-3), (1e-3, 10e-3)
_number = count(1)


@dataclass(frozen=True)
class Time:
    """Wall-clock and process seconds."""

    wall: float
    cpu: float


def time_runs(run: Callable[[], object], repeats: int) -> Time:
    """Return the medians of several runs."""
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = perf_counter(), process_time()
        run()
        walls.append(perf_counter() - wall)
        cpus.append(process_time() - cpu)
    return Time(median(walls), median(cpus))


def speed(repeats: int, progress: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield tables of seconds."""
    scene = read_scene(SCENE)
    yield _setup(scene, repeats, progress)
    base = solve_undisturbed(scene, 0.003)
    yield _orders(base, repeats, progress)
    yield _first_order(base, repeats, progress)
    yield _reflections(base, repeats, progress)
    yield _limits(base, repeats, progress)


def _setup(scene: Scene, repeats: int, progress: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable(
        "the probe on its tissue, once for all tumours", ("accuracy", "unknowns, count", "wall, ms", "process, ms")
    )
    for accuracy in ACCURACIES:
        progress(f"speed: probe at {accuracy:g}")
        spent = time_runs(partial(_solve_anew, scene, accuracy), repeats)
        unknowns = _solve_anew(scene, accuracy).field.states.model.system.numbering.unknowns
        table.add(f"{accuracy:g}", unknowns, spent.wall, spent.cpu)
    table.note("unknowns of the mesh on which strains are found, elements condensed")
    return table


def _solve_anew(scene: Scene, accuracy: float) -> Undisturbed:
    """Solve the probe again, at an accuracy that is not cached."""
    return solve_undisturbed(scene, accuracy * (1 - 1e-9 * next(_number)))


def _orders(base: Undisturbed, repeats: int, progress: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable("set-up of each azimuthal order, its matrix included, once per probe", ("m", "wall, ms", "process, ms"))
    spent: list[list[Time]] = [[] for _ in range(ORDERS)]
    for k in range(repeats):
        progress(f"speed: orders, run {k + 1} of {repeats}")
        reflector = replace(base.choose_reflector(Tumours.from_scene(base.scene).flatten()), _responses={}, _complements={})
        for m, times in enumerate(spent):
            times.append(time_runs(partial(_apply_order, reflector, m), 1))
    for m, times in enumerate(spent):
        table.add(str(m), median(sample_time.wall for sample_time in times), median(sample_time.cpu for sample_time in times))
    table.note("m = 1 includes what all orders above 0 share; m = 0 is that of the base states")
    return table


def _apply_order(reflector: Reflector, m: int) -> None:
    order = reflector.find_response(m)
    order.apply(np.ones((order.boundary.direct.shape[0], 2)), False)


def draw_tumours(scene: Scene, number: int, seed: int = 1) -> Tumours:
    """Random tumours in the tissue, one a set: up to three outer radii from the axis, any size that fits."""
    rng = np.random.default_rng(seed)
    tissue = scene.tissue
    assert tissue.shape == "cylinder"
    far, depth = 3 * scene.probe.tube_radius, tissue.depth
    diameter = rng.uniform(1e-3, 12e-3, number)
    cover = np.exp(rng.uniform(np.log(0.05), np.log(2), number)) * diameter
    depths = np.minimum(diameter / 2 + cover, depth - 0.55 * diameter)
    around = rng.uniform(0, 2 * np.pi, number)
    offset = far * np.sqrt(rng.uniform(0, 1, number))
    contrast = np.exp(rng.uniform(np.log(0.1), np.log(100), number))
    modulus, poisson = contrast * tissue.youngs_modulus, np.full(number, 0.45)
    values = (offset * np.cos(around), offset * np.sin(around), depths, diameter, modulus, poisson)
    return Tumours(*(value[:, None] for value in values))


def _first_order(base: Undisturbed, repeats: int, progress: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable(
        f"{TUMOUR_COUNT:,} random tumours to first order".replace(",", " "),
        ("with", "wall, s", "process, s", "tumours per process second, count"),
    )
    tumours = draw_tumours(base.scene, TUMOUR_COUNT)
    progress("speed: table of strains")
    table_time = time_runs(lambda: replace(base.energies).interpolate(*np.full((2, 1), 0.0)), repeats)
    table.note(f"table of strain products, once per probe: {table_time.wall:.2f} s, {table_time.cpu:.2f} s of process time")
    compute_readings(base, tumours.select(slice(0, 10)), reflect=False)
    inside = base.energies.covers(tumours.offset + tumours.diameter / 2, -tumours.cover, -tumours.depth - tumours.diameter / 2)
    table.note(f"{np.mean(inside):.0%} of the tumours lie in the table, the others too near to the probe: elements are asked")
    for places, text in ((False, "forces, by modulus and Poisson's ratio"), (True, "by depth, offset, diameter too")):
        progress(f"speed: first order, {text}")
        spent = time_runs(partial(compute_readings, base, tumours, places=places, reflect=False), repeats)
        table.add(text, spent.wall, spent.cpu, round(TUMOUR_COUNT / spent.cpu))
    deep = tumours.select(np.flatnonzero(inside[:, 0]))
    spent = time_runs(lambda: compute_readings(base, deep, reflect=False), repeats)
    table.add("the first for those in the table alone", spent.wall, spent.cpu, round(len(deep.x) / spent.cpu))
    return table


def _reflections(base: Undisturbed, repeats: int, progress: Callable[[str], None]) -> MeasuredTable:
    title = f"a tumour of {1e3 * DIAMETER:g} mm, contrast 10, with reflections, its probe and orders known"
    headings = ("cover / D", "offset, outer radii", "orders", "reflections", "bound, error", "alone, ms", f"one of {BATCH}, ms")
    table = MeasuredTable(title, headings)
    modulus, outer = 10 * base.scene.tissue.youngs_modulus, base.scene.probe.tube_radius
    for cover in COVERS:
        for offset in OFFSETS:
            progress(f"speed: reflections, cover {cover:g}, offset {offset:g}")
            stiff_scene = _stiff(base, cover, offset)
            alone = stiff_scene.select(0)
            tolerance = REFLECTION_TOLERANCE_RELATIVE * base.accuracy
            steps = iterate_scattering(base.field, base.choose_reflector(alone), base.strata, alone, tolerance)
            scattering = run_in_lockstep([steps])[0]
            bound = float(compute_readings(base, stiff_scene, reflect=True).error_estimate[0])
            batch = replace(stiff_scene, youngs_modulus=modulus * np.linspace(0.9, 1.1, BATCH)[:, None])
            compute_readings(base, batch, reflect=True)  # finds each order's matrix
            single, batched = (
                time_runs(partial(compute_readings, base, tumours, reflect=True), repeats).cpu for tumours in (stiff_scene, batch)
            )
            table.add(f"{cover:g}", f"{offset:g}", scattering.orders, scattering.steps, bound, single, batched / BATCH)
    table.note(f"process time; accuracy {base.accuracy:g}; outer radius {1e3 * outer:g} mm")
    return table


def _limits(base: Undisturbed, repeats: int, progress: Callable[[str], None]) -> MeasuredTable:
    title = "what a tumour alone cannot do without: the orders' matrices read, the modes summed at a large product's speed"
    headings = ("cover / D", "offset, outer radii", "matrices, MB", "read, ms", "sums, Mflop", "at 500 x 500, ms", "alone, ms")
    table = MeasuredTable(title, headings)
    square = np.random.default_rng(1).random((500, 500))
    rate = 2 * 500**3 / time_runs(lambda: square @ square, 9).cpu
    for cover in COVERS:
        for offset in OFFSETS[1:]:
            progress(f"speed: limits, cover {cover:g}, offset {offset:g}")
            stiff_scene = _stiff(base, cover, offset)
            mine = stiff_scene.select(0)
            reflector = base.choose_reflector(mine)
            tolerance = REFLECTION_TOLERANCE_RELATIVE * base.accuracy
            scattering = run_in_lockstep([iterate_scattering(base.field, reflector, base.strata, mine, tolerance)])[0]
            compute_readings(base, stiff_scene, reflect=True)
            matrices = [np.array(reflector.find_response(m)._matrix) for m in range(scattering.orders)]
            column = np.ones(len(matrices[-1]))
            read = 2 * scattering.steps * time_runs(partial(_read, matrices, column), 9).cpu  # both base states
            flops = scattering.steps * _sums(
                reflector.build_exchange(*arrange_spheres(reflector.states.model.section, base.strata, mine))
            )
            alone = time_runs(partial(compute_readings, base, stiff_scene, reflect=True), repeats).cpu
            size = scattering.steps * sum(stiff_scene.nbytes for stiff_scene in matrices) / 1e6
            table.add(f"{cover:g}", f"{offset:g}", round(size), read, round(flops / 1e6), flops / rate, alone)
    return table


def _read(matrices: list[Floats], column: Floats) -> None:
    for matrix in matrices:
        _ = matrix @ column[: len(matrix)]


def _sums(exchange: Exchange | CloseExchange) -> float:
    """Flops of one reflection's sums of modes and their transpose, both base states; every row has harmonics of one family."""
    assert isinstance(exchange, Exchange)
    samplers = [sampler for part in exchange.samples.parts for part_samplers in part._samplers for sampler in part_samplers]
    return float(
        sum(
            2 * 2 * len(rows) * member.stack.harmonics.count * member.count
            for member in samplers
            for rows, _ in member._list_families(2)
        )
    )


def _stiff(base: Undisturbed, cover: float, offset: float) -> Tumours:
    modulus, outer = 10 * base.scene.tissue.youngs_modulus, base.scene.probe.tube_radius
    return Tumours(*np.reshape([offset * outer, 0, (cover + 0.5) * DIAMETER, DIAMETER, modulus, 0.47], (6, 1, 1)))


def one_map(points: int, sample: int, accuracy: float, progress: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield the seconds of one map of ``points`` x ``points`` depths and diameters, and of ``axisymmetric`` for each of them."""
    scene = read_scene(SCENE)
    target = scene.inclusion[0]
    depth, diameter = np.meshgrid(np.linspace(*MAP_DEPTHS, points), np.linspace(*MAP_DIAMETERS, points), indexing="ij")
    tumours = Tumours(
        0.0,
        0.0,
        depth.reshape(-1, 1),
        diameter=diameter.reshape(-1, 1),
        youngs_modulus=target.youngs_modulus,
        poisson_ratio=target.poisson_ratio,
    )
    table = MeasuredTable(
        f"{points} x {points} depths and diameters on the axis, accuracy {accuracy:g}, probe's set-up included",
        ("by", "points", "with reflections", "worst bound, error", "off by, error", "wall, s", "process, s"),
    )
    chosen = np.random.default_rng(1).choice(points**2, sample, replace=False)
    progress("map: readings")
    maps: dict[str, Readings] = {}
    texts = {"readings": False, "readings with sensitive=True": True}
    times = {
        text: time_runs(partial(_map, maps, text, scene, accuracy, tumours, sensitive), 1) for text, sensitive in texts.items()
    }
    results = [_axisymmetric(scene, tumours, int(k), accuracy, progress) for k in chosen]
    ratios = np.array([result.ratio for result, _ in results])
    for text, spent in times.items():
        known_times = maps[text]
        difference = float(np.max(np.abs(known_times.ratio[chosen] / ratios - 1)))
        table.add(
            text,
            points**2,
            int(known_times.reflected.sum()),
            float(known_times.max_error.max()),
            difference,
            spent.wall,
            spent.cpu,
        )
    walls, cpus = (points**2 * float(np.mean([getattr(map_time, key) for _, map_time in results])) for key in ("wall", "cpu"))
    table.add("axisymmetric, one evaluate each", points**2, None, None, None, walls, cpus)
    table.note(
        f"axisymmetric: {sample} random points of the map were timed, their mean counts for all; off by: from it, at these"
    )
    yield table


def _map(results: dict[str, Readings], text: str, scene: Scene, accuracy: float, tumours: Tumours, sensitive: bool) -> None:
    results[text] = compute_readings(_solve_anew(scene, accuracy), tumours, sensitive=sensitive)


def _axisymmetric(
    scene: Scene, tumours: Tumours, k: int, accuracy: float, progress: Callable[[str], None]
) -> tuple[Result, Time]:
    progress(f"map: axisymmetric, point {k}")
    change = {"x": 0.0, "y": 0.0, "depth": float(tumours.depth[k, 0]), "diameter": float(tumours.diameter[k, 0])}
    changed = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update=change),)})
    results: list[Result] = []
    spent = time_runs(lambda: results.append(evaluate(changed, "axisymmetric", accuracy)), 1)
    return results[0], spent
