"""Seconds of ``equivalent-inclusion``: the probe once, tumours to first order and with reflections, one map. One thread.

Everything is timed under one probe (``SCENE``), in one run; wall-clock and process time side by side tell how
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
from solver.multiple_scattering.solve import arrange_spheres, solve_scattering

SCENE = Path(__file__).parents[2] / "tests" / "reference" / "off-axis" / "stiff-cover-0.25-offset-1.toml"
ACCURACIES = (0.01, 0.003, 0.001)
MANY = 10_000
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


def timed(run: Callable[[], object], repeats: int) -> Time:
    """Return the medians of several runs."""
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = perf_counter(), process_time()
        run()
        walls.append(perf_counter() - wall)
        cpus.append(process_time() - cpu)
    return Time(median(walls), median(cpus))


def speed(repeats: int, tell: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield tables of seconds."""
    scene = read_scene(SCENE)
    yield _setup(scene, repeats, tell)
    base = solve_undisturbed(scene, 0.003)
    yield _orders(base, repeats, tell)
    yield _first_order(base, repeats, tell)
    yield _reflections(base, repeats, tell)
    yield _limits(base, repeats, tell)


def _setup(scene: Scene, repeats: int, tell: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable(
        "the probe on its tissue, once for all tumours", ("accuracy", "unknowns, count", "wall, ms", "process, ms")
    )
    for accuracy in ACCURACIES:
        tell(f"speed: probe at {accuracy:g}")
        spent = timed(partial(_solved, scene, accuracy), repeats)
        unknowns = _solved(scene, accuracy).field.states.model.system.numbering.unknowns
        table.add(f"{accuracy:g}", unknowns, spent.wall, spent.cpu)
    table.note("unknowns of the mesh on which strains are found, elements condensed")
    return table


def _solved(scene: Scene, accuracy: float) -> Undisturbed:
    """The probe, solved anew: nobody asked for just this accuracy yet."""
    return solve_undisturbed(scene, accuracy * (1 - 1e-9 * next(_number)))


def _orders(base: Undisturbed, repeats: int, tell: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable("set-up of each azimuthal order, its matrix included, once per probe", ("m", "wall, ms", "process, ms"))
    spent: list[list[Time]] = [[] for _ in range(ORDERS)]
    for k in range(repeats):
        tell(f"speed: orders, run {k + 1} of {repeats}")
        reflector = replace(base.choose_reflector(Tumours.from_scene(base.scene).flatten()), _responses={}, _complements={})
        for m, times in enumerate(spent):
            times.append(timed(partial(_asked, reflector, m), 1))
    for m, times in enumerate(spent):
        table.add(str(m), median(one.wall for one in times), median(one.cpu for one in times))
    table.note("m = 1 includes what all orders above 0 share; m = 0 is that of the base states")
    return table


def _asked(reflector: Reflector, m: int) -> None:
    order = reflector.find_response(m)
    order.apply(np.ones((order.boundary.direct.shape[0], 2)), False)


def many(scene: Scene, number: int, seed: int = 1) -> Tumours:
    """Random tumours in the tissue, one a set: up to three outer radii from the axis, any size that fits."""
    rng = np.random.default_rng(seed)
    tissue = scene.tissue
    assert tissue.shape == "cylinder"
    far, depth = 3 * scene.probe.tube_radius, tissue.depth
    diameter = rng.uniform(1e-3, 12e-3, number)
    cover = np.exp(rng.uniform(np.log(0.05), np.log(2), number)) * diameter
    at = np.minimum(diameter / 2 + cover, depth - 0.55 * diameter)
    around = rng.uniform(0, 2 * np.pi, number)
    offset = far * np.sqrt(rng.uniform(0, 1, number))
    contrast = np.exp(rng.uniform(np.log(0.1), np.log(100), number))
    modulus, poisson = contrast * tissue.youngs_modulus, np.full(number, 0.45)
    values = (offset * np.cos(around), offset * np.sin(around), at, diameter, modulus, poisson)
    return Tumours(*(value[:, None] for value in values))


def _first_order(base: Undisturbed, repeats: int, tell: Callable[[str], None]) -> MeasuredTable:
    table = MeasuredTable(
        f"{MANY:,} random tumours to first order".replace(",", " "),
        ("with", "wall, s", "process, s", "tumours per process second, count"),
    )
    tumours = many(base.scene, MANY)
    tell("speed: table of strains")
    table_time = timed(lambda: replace(base.energies).interpolate(*np.full((2, 1), 0.0)), repeats)
    table.note(f"table of strain products, once per probe: {table_time.wall:.2f} s, {table_time.cpu:.2f} s of process time")
    compute_readings(base, tumours.select(slice(0, 10)), reflect=False)
    inside = base.energies.covers(tumours.offset + tumours.diameter / 2, -tumours.cover, -tumours.depth - tumours.diameter / 2)
    table.note(f"{np.mean(inside):.0%} of the tumours lie in the table, the others too near to the probe: elements are asked")
    for places, text in ((False, "forces, by modulus and Poisson's ratio"), (True, "by depth, offset, diameter too")):
        tell(f"speed: first order, {text}")
        spent = timed(partial(compute_readings, base, tumours, places=places, reflect=False), repeats)
        table.add(text, spent.wall, spent.cpu, round(MANY / spent.cpu))
    deep = tumours.select(np.flatnonzero(inside[:, 0]))
    spent = timed(lambda: compute_readings(base, deep, reflect=False), repeats)
    table.add("the first for those in the table alone", spent.wall, spent.cpu, round(len(deep.x) / spent.cpu))
    return table


def _reflections(base: Undisturbed, repeats: int, tell: Callable[[str], None]) -> MeasuredTable:
    title = f"a tumour of {1e3 * DIAMETER:g} mm, contrast 10, with reflections, its probe and orders known"
    headings = ("cover / D", "offset, outer radii", "orders", "reflections", "bound, error", "alone, ms", f"one of {BATCH}, ms")
    table = MeasuredTable(title, headings)
    modulus, outer = 10 * base.scene.tissue.youngs_modulus, base.scene.probe.tube_radius
    for cover in COVERS:
        for offset in OFFSETS:
            tell(f"speed: reflections, cover {cover:g}, offset {offset:g}")
            one = _stiff(base, cover, offset)
            alone = one.select(0)
            told = solve_scattering(
                base.field, base.choose_reflector(alone), base.strata, alone, REFLECTION_TOLERANCE_RELATIVE * base.accuracy
            )
            bound = float(compute_readings(base, one, reflect=True).error_estimate[0])
            batch = replace(one, youngs_modulus=modulus * np.linspace(0.9, 1.1, BATCH)[:, None])
            compute_readings(base, batch, reflect=True)  # finds each order's matrix
            single, many_ = (timed(partial(compute_readings, base, some, reflect=True), repeats).cpu for some in (one, batch))
            table.add(f"{cover:g}", f"{offset:g}", told.orders, told.steps, bound, single, many_ / BATCH)
    table.note(f"process time; accuracy {base.accuracy:g}; outer radius {1e3 * outer:g} mm")
    return table


def _limits(base: Undisturbed, repeats: int, tell: Callable[[str], None]) -> MeasuredTable:
    title = "what a tumour alone cannot do without: the orders' matrices read, the modes summed at a large product's speed"
    headings = ("cover / D", "offset, outer radii", "matrices, MB", "read, ms", "sums, Mflop", "at 500 x 500, ms", "alone, ms")
    table = MeasuredTable(title, headings)
    square = np.random.default_rng(1).random((500, 500))
    rate = 2 * 500**3 / timed(lambda: square @ square, 9).cpu
    for cover in COVERS:
        for offset in OFFSETS[1:]:
            tell(f"speed: limits, cover {cover:g}, offset {offset:g}")
            one = _stiff(base, cover, offset)
            mine = one.select(0)
            reflector = base.choose_reflector(mine)
            told = solve_scattering(base.field, reflector, base.strata, mine, REFLECTION_TOLERANCE_RELATIVE * base.accuracy)
            compute_readings(base, one, reflect=True)
            matrices = [np.array(reflector.find_response(m)._matrix) for m in range(told.orders)]
            column = np.ones(len(matrices[-1]))
            read = 2 * told.steps * timed(partial(_read, matrices, column), 9).cpu  # both base states
            flops = told.steps * _sums(
                reflector.build_exchange(*arrange_spheres(reflector.states.model.section, base.strata, mine))
            )
            alone = timed(partial(compute_readings, base, one, reflect=True), repeats).cpu
            size = told.steps * sum(one.nbytes for one in matrices) / 1e6
            table.add(f"{cover:g}", f"{offset:g}", round(size), read, round(flops / 1e6), flops / rate, alone)
    return table


def _read(matrices: list[Floats], column: Floats) -> None:
    for one in matrices:
        _ = one @ column[: len(one)]


def _sums(exchange: Exchange | CloseExchange) -> float:
    """Flops of one reflection's sums of modes and their transpose, both base states; every row has harmonics of one family."""
    assert isinstance(exchange, Exchange)
    samplers = [sampler for part in exchange.samples.parts for own in part._samplers for sampler in own]
    return float(
        sum(2 * 2 * len(rows) * one.stack.harmonics.count * one.count for one in samplers for rows, _ in one._list_families(2))
    )


def _stiff(base: Undisturbed, cover: float, offset: float) -> Tumours:
    modulus, outer = 10 * base.scene.tissue.youngs_modulus, base.scene.probe.tube_radius
    return Tumours(*np.reshape([offset * outer, 0, (cover + 0.5) * DIAMETER, DIAMETER, modulus, 0.47], (6, 1, 1)))


def one_map(points: int, sample: int, accuracy: float, tell: Callable[[str], None]) -> Iterator[MeasuredTable]:
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
    tell("map: readings")
    maps: dict[str, Readings] = {}
    texts = {"readings": False, "readings with sensitive=True": True}
    times = {text: timed(partial(_map, maps, text, scene, accuracy, tumours, sensitive), 1) for text, sensitive in texts.items()}
    results = [_axisymmetric(scene, tumours, int(k), accuracy, tell) for k in chosen]
    ratios = np.array([result.ratio for result, _ in results])
    for text, spent in times.items():
        found = maps[text]
        off = float(np.max(np.abs(found.ratio[chosen] / ratios - 1)))
        table.add(text, points**2, int(found.reflected.sum()), float(found.max_error.max()), off, spent.wall, spent.cpu)
    walls, cpus = (points**2 * float(np.mean([getattr(one, key) for _, one in results])) for key in ("wall", "cpu"))
    table.add("axisymmetric, one evaluate each", points**2, None, None, None, walls, cpus)
    table.note(
        f"axisymmetric: {sample} random points of the map were timed, their mean counts for all; off by: from it, at these"
    )
    yield table


def _map(into: dict[str, Readings], text: str, scene: Scene, accuracy: float, tumours: Tumours, sensitive: bool) -> None:
    into[text] = compute_readings(_solved(scene, accuracy), tumours, sensitive=sensitive)


def _axisymmetric(scene: Scene, tumours: Tumours, k: int, accuracy: float, tell: Callable[[str], None]) -> tuple[Result, Time]:
    tell(f"map: axisymmetric, point {k}")
    change = {"x": 0.0, "y": 0.0, "depth": float(tumours.depth[k, 0]), "diameter": float(tumours.diameter[k, 0])}
    one = scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update=change),)})
    found: list[Result] = []
    spent = timed(lambda: found.append(evaluate(one, "axisymmetric", accuracy)), 1)
    return found[0], spent
