"""Measure surveys: presses until the place is known, and stops that are wrong.

    nice python -m benchmarks.locating.surveys [--surveys 200] [--rows rows.jsonl]

Tumours are drawn from the population of ``examples/scans/one-clear.toml`` with one tumour at most; readings are those of
``equivalent-inclusion`` with reflections, with a common gain and noise of each reading. The first table has tumours that the scan
of 25 presses detects with a probability of 0.9: errors of the posterior median of the place, over all tumours, after each number
of presses besides the baseline reading. The second has scans as the prior draws them. A stop is wrong where a tumour is stated
and none lies there, or where none is stated and one lies there which the scan detects with 0.9. Seconds are of the processor.

Duration: eight minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console

from benchmarks.rows import Row, RowFile
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from probe_design.estimation.measurements import Reading
from probe_design.locating.locator import Locator
from probe_design.locating.posterior import compute_quantiles
from probe_design.locating.scan_data import MIN_READINGS
from probe_design.locating.stopping import find_stop
from probe_design.populations.design_file import Design, read_design
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours

DESIGN_FILE = "examples/scans/one-clear.toml"
TUMOURS, MAX_PRESSES = 12, 30
LIMITS = (0.1, 0.02, 0.01)  # of the probability of tumours that the scan detects, below which a survey stops
RASTER_PRESSES = 25
SHOWN = (3, 6, 8, 12, 16, 25)  # presses of the first table
SEED = 40


def read_single_design() -> Design:
    """Return the design with one tumour at most."""
    design = read_design(DESIGN_FILE)
    return design.model_copy(update={"population": design.population.model_copy(update={"tumours": 1})})


class Patient:
    """A tissue with a tumour or none, and its readings."""

    def __init__(self, design: Design, base: object, tumour: Floats | None, seed: int) -> None:
        self.design, self.base, self.tumour = design, base, tumour
        self.rng = np.random.default_rng((SEED, seed))
        self.gain = np.sqrt(2) * design.noise.gain * self.rng.standard_normal()

    def press(self, x: float, y: float, *, blank: bool = False) -> Reading:
        """Return one reading."""
        films = self.base.films.totals  # type: ignore[attr-defined]
        if self.tumour is not None and not blank:
            tumour_x, tumour_y, depth, diameter, modulus = self.tumour[:, None, None]
            spheres = Tumours(tumour_x - x, tumour_y - y, depth, diameter, modulus, 0.45)
            films = compute_readings(self.base, spheres, reflect=True).totals[0]  # type: ignore[arg-type]
        probe = self.design.scene.probe
        ratio = films[0] / films[1] * probe.outer_area / probe.inner_area
        noise = self.design.noise.white
        return Reading(x, y, float(ratio * np.exp(self.gain + noise * self.rng.standard_normal())), noise, blank=blank)


def draw_tumours(locator: Locator, count: int, seed: int) -> Floats:
    """Return tumours of the prior that fit the tissue, shape (count, 5)."""
    rng = np.random.default_rng((SEED, seed))
    tumours = locator.prior.transform(rng.random((3 * count, 1, 5)))
    return np.asarray(tumours[locator.prior.find_allowed(tumours)][:count, 0])


def start(design: Design, patient: Patient, seed: int) -> Locator:
    """Return the posterior after the baseline reading."""
    locator = Locator(design, seed=seed)
    locator.update(patient.press(0.0, 0.0, blank=True))
    return locator


def compute_error(locator: Locator, tumour: Floats) -> float:
    """Return the distance of the posterior median from the tumour, m."""
    sample = locator.get_sample(1)
    places = locator.prior.transform(sample.points)[:, 0, :2]
    median = [compute_quantiles(places[:, axis], sample.weights, (0.5,))[0] for axis in range(2)]
    return float(np.hypot(*(np.array(median) - tumour[:2])))


def press_in_order(design: Design, base: object, tumour: Floats, index: int, order: str) -> Row:
    """Return the error of the place after each press, m, and the times of updates and decisions, s."""
    line = np.linspace(-16e-3, 16e-3, 5)
    raster = [(float(x), float(y)) for y in line for x in line]
    patient = Patient(design, base, tumour, index)
    locator = start(design, patient, index)
    row: Row = {"errors": [], "updates": [], "decisions": []}
    for press in range(RASTER_PRESSES):
        x, y = raster[press]
        if order != "raster":
            begin = process_time()
            place = locator.next_position()
            row["decisions"].append(process_time() - begin)
            x, y = place.x, place.y
        reading = patient.press(x, y)
        begin = process_time()
        locator.update(reading)
        row["updates"].append(process_time() - begin)
        row["errors"].append(compute_error(locator, tumour))
    return row


def measure_presses(design: Design, base: object, rows: RowFile) -> MeasuredTable:
    """Return errors of the place by next_position and by a raster."""
    first = Locator(design)
    candidates = draw_tumours(first, 4 * TUMOURS, 1)
    detected = [tumour for tumour in candidates if first.planned_scan.compute_detected_fraction(tumour[None, None])][:TUMOURS]
    measured = {
        order: [
            rows.get(f"{order}/{index}", lambda i=index, t=tumour, o=order: press_in_order(design, base, t, i, o))  # type: ignore[misc]
            for index, tumour in enumerate(detected)
        ]
        for order in ("next_position", "raster")
    }
    errors = {order: np.median([row["errors"] for row in parts], axis=0) * 1e3 for order, parts in measured.items()}
    updates, decisions = (
        [seconds for parts in measured.values() for row in parts for seconds in row[key]] for key in ("updates", "decisions")
    )
    table = MeasuredTable(
        f"median error of the place, mm, over {len(detected)} tumours",
        ("order", *(f"{count} presses" for count in SHOWN), "1 mm after"),
    )
    for name, medians in errors.items():
        below = np.flatnonzero(medians <= 1)
        reached = str(below[0] + 1) if len(below) else f"not in {RASTER_PRESSES}"
        table.add(name, *(f"{medians[count - 1]:.2f}" for count in SHOWN), reached)
    for name, times in (("update", updates), ("decision", decisions)):
        table.note(f"{name}: {1e3 * np.median(times):.0f} ms in the median, {1e3 * np.quantile(times, 0.99):.0f} ms at 99 %")
    return table


def survey(design: Design, base: object, tumour: Floats, index: int) -> Row:
    """Return the first stop of a survey by each limit: limit, reason, presses, whether it is wrong, and how probably."""
    is_there = bool(np.random.default_rng((SEED, 3, index)).random() < 0.5)
    patient = Patient(design, base, tumour if is_there else None, 1000 + index)
    locator = start(design, patient, index)
    detected = is_there and locator.planned_scan.compute_detected_fraction(tumour[None, None]) > 0
    first: dict[float, list[object]] = {}
    while len(first) < len(LIMITS):
        place, presses = locator.next_position(), len(locator.readings) - 1
        detectable = locator.compute_detectable_probability()
        for limit in LIMITS if presses >= MIN_READINGS else ():
            stop = find_stop(locator.probability_none, detectable, place.information, limit)
            reason = "presses" if stop is None else stop.reason
            if limit not in first and (stop is not None or presses >= MAX_PRESSES):
                is_wrong = not is_there if reason == "tumour" else detected
                expected = locator.probability_none if reason == "tumour" else detectable
                first[limit] = [limit, reason, presses, bool(is_wrong), expected]
        locator.update(patient.press(place.x, place.y))
    return {"stops": list(first.values())}


def measure_stops(design: Design, base: object, rows: RowFile, surveys: int) -> MeasuredTable:
    """Return why surveys of scans from the prior stop, and how many of the stops are wrong."""
    tumours = draw_tumours(Locator(design), surveys, 2)
    stops = [
        rows.get(f"survey/{index}", lambda i=index, t=tumour: survey(design, base, t, i))["stops"]  # type: ignore[misc]
        for index, tumour in enumerate(tumours)
    ]
    columns = ("limit", "reason", "surveys", "wrong", "presses in the median", "at 90 %")
    table = MeasuredTable(f"stops of {surveys} surveys by the limit of detectable tumours", columns)
    for limit in LIMITS:
        chosen = [part for parts in stops for part in parts if part[0] == limit]
        for cause in sorted({part[1] for part in chosen}):
            same = [part for part in chosen if part[1] == cause]
            counts, wrong = [part[2] for part in same], sum(part[3] for part in same)
            table.add(limit, cause, len(same), wrong, f"{np.median(counts):.0f}", f"{np.quantile(counts, 0.9):.0f}")
        wrong, expected = sum(part[3] for part in chosen), sum(part[4] for part in chosen)
        table.note(f"limit {limit:g}: {wrong} of {surveys} stops are wrong, {expected:.1f} by the posteriors")
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surveys", type=int, default=200)
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    arguments = parser.parse_args()
    design, console, rows = read_single_design(), Console(width=130), RowFile(arguments.rows)
    base = EquivalentInclusion().prepare(design.scene.model_copy(update={"inclusion": ()}), 0.003)
    measure_presses(design, base, rows).print(console)
    measure_stops(design, base, rows, arguments.surveys).print(console)


if __name__ == "__main__":
    main()
