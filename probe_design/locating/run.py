"""Run `locate`: read the scan, prepare the model, infer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from probe_design.estimation.made_readings import check_readings
from probe_design.estimation.measurements import Reading, read_readings
from probe_design.locating.inference import infer
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.scan_data import ScanConditions, ScanData, check_places
from probe_design.populations.design_file import Design
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.tumour_ranges import TumourRanges


def read_scan(path: Path, design: Design, conditions: ScanConditions) -> tuple[Reading, ...]:
    """Return the readings of a scan; the design file's noise, at each reading's force, is that of readings that state none.

    Raises
    ------
    InputError
        The file or one of its entries is not allowed.
    """
    return read_readings(path, design.scene, partial(conditions.loads.compute_noise, design.noise), is_scan=True)


def run_locate(
    design: Design, scan: tuple[Reading, ...] | Path, outlier_rate: float, seed: int, *, advise: bool,
    model: ForwardModel | None = None,
) -> Location:  # fmt: skip
    """Return the tumours that explain a scan, see ``probe_design.locate``.

    Parameters
    ----------
    design
        Probe, tissue, population and noise.
    scan
        Readings, or the path of their file.
    outlier_rate
        Expected fraction of wild readings.
    seed
        Of the random numbers.
    advise
        Whether to choose the next place.
    model
        Predicts readings under one load; default: the tables of the probe on the tissue.
    """
    conditions = ScanConditions.from_design(design)
    readings = read_scan(scan, design, conditions) if isinstance(scan, Path) else check_readings(scan, design.scene, is_scan=True)
    check_places(readings)
    data = ScanData.from_readings(readings, design, conditions)
    prior = TumourPrior.from_design(design, data.positions[~data.is_baseline])
    models = build_models(prior, conditions.loads.scenes) if model is None else (model,)
    result = infer(Likelihood(data, models, prior, outlier_rate), conditions, seed, advise=advise)
    return replace(result, warnings=(*result.warnings, *list_assumed_places(design, prior)))


def list_assumed_places(design: Design, prior: TumourPrior) -> Iterator[str]:
    """Yield a warning where readings along a line leave the places of tumours beside it to an assumption."""
    for name, places in zip("xy", prior.ranges, strict=False):
        if places.is_single and getattr(design.population, name) is None:
            yield (
                f"all readings have the same {name}, and tumours are assumed at {name} = {format_mm(places.values[0])} alone: "
                f"where they may lie beside it, state a range as [population] {name}; a line of readings does not tell its two "
                "sides apart"
            )


def build_models(prior: TumourPrior, scenes: Sequence[Scene]) -> tuple[ForwardModel, ...]:
    """Return the table of each scene, a load on the tissue, over the tumours of a prior, from the cache where built before.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene or its load, or the population does not fit the tissue.
    """
    depth, diameter, modulus = ((min(part.values), max(part.values)) for part in prior.ranges[2:])
    ranges = TumourRanges(depth, diameter, modulus, prior.poisson_ratio, prior.least_cover)
    return tuple(read_or_build_table(scene, ranges) for scene in scenes)
