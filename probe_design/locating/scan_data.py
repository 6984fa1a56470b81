"""Collect the readings of a scan as residuals against tumour-free tissue, with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import format_mm
from probe_design.estimation.measurements import Reading
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.scan_loads import ScanLoads
from probe_design.locating.tissue_effects import TissueEffects
from probe_design.populations.design_file import Design
from probe_design.populations.noise import compute_common_variances
from probe_design.populations.population import ScenePopulation

MIN_READINGS = 3  # over the tissue: with fewer, every tumour of a population explains them
UNLIKE_SHARE = 0.3  # of the model's error without tumours, that each load has by itself, as of signals (``reading_tables``)
ARRAYS = ("positions", "values", "variance", "pose_sd", "is_baseline", "weights", "spreads")  # of ``ScanData``


@dataclass(frozen=True)
class ScanConditions:
    """What the readings of a scan have in common: probe, tissue and loads without tumours, and errors.

    Attributes
    ----------
    loads
        The probe on the tissue without tumours, at each load.
    errors
        Gains, errors of the model without tumours, and what is not known of the tissue.
    middles
        Numbers of the tissue that are not known, in the middle of their ranges, SI units, by name.
    """

    loads: ScanLoads
    errors: CommonErrors
    middles: dict[str, float] = field(default_factory=dict)

    @classmethod
    def from_design(cls, design: Design) -> ScanConditions:
        """Compute the conditions of a design file's scans.

        Raises
        ------
        InputError
            No tumour of the population fits the tissue at both ends of its ranges, or loads contradict each other.
        Refusal
            The evaluator cannot model the scene or a load.
        """
        loads = ScanLoads.from_design(design)
        tissue = TissueEffects.from_population(ScenePopulation.from_scene(design.scene, design.population), loads)
        gains = np.sqrt(compute_common_variances(design.noise, (0, 1), loads.main.totals))
        errors = CommonErrors.from_channels("ln_gain", np.tile(gains, (len(loads.nodes), 1)))
        errors = errors.join(CommonErrors.from_channels("model", loads.errors))
        if len(loads.nodes) > 1:
            for row in np.eye(len(loads.nodes)):
                errors = errors.join(CommonErrors.from_channels("load", UNLIKE_SHARE * row[:, None] * loads.errors))
        return cls(loads, errors.join(tissue.errors), tissue.middles)


@dataclass(frozen=True)
class ScanData:
    """k readings of ln ratio and ln stiffness, less the prediction for tumour-free tissue.

    Attributes
    ----------
    positions
        Of the probe's axis, m, shape (k, 2).
    values
        Residuals against tumour-free tissue, shape (k, 2); 0 where a channel is not read.
    variance
        Of each reading by itself, shape (k, 2); inf where a channel is not read.
    pose_sd
        Standard deviation of the probe's place, m, shape (k, 2).
    is_baseline
        Whether a reading is over tumour-free tissue, shape (k,).
    errors
        What all readings have in common.
    weights, spreads
        Weights of the l loads in the signals of each reading, and in their error, eq. LO.6, shape (k, l) each; left out: one
        load.
    """

    positions: Floats
    values: Floats
    variance: Floats
    pose_sd: Floats
    is_baseline: Bools
    errors: CommonErrors
    weights: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    spreads: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        """Fill in the weights of a single load."""
        if not self.weights.shape[1]:
            object.__setattr__(self, "weights", np.ones((len(self.values), 1)))
            object.__setattr__(self, "spreads", np.zeros((len(self.values), 1)))

    @classmethod
    def from_readings(cls, readings: Sequence[Reading], design: Design, conditions: ScanConditions) -> ScanData:
        """Return the data of readings with the noise of a design file; no reading or any number of them.

        Raises
        ------
        InputError
            A reading was taken at another load than those for which readings are predicted.
        """
        loads, k, noise = conditions.loads, len(readings), design.noise
        forces = [reading.force for reading in readings]
        loads.check_forces(forces)
        blanks = loads.compute_logarithms(forces)
        values, variance = np.zeros((k, 2)), np.full((k, 2), math.inf)
        for index, (reading, blank) in enumerate(zip(readings, blanks, strict=True)):
            values[index, 0] = math.log(reading.ratio) - blank[0]
            variance[index, 0] = reading.noise**2
            if reading.stiffness is not None:
                values[index, 1] = math.log(reading.stiffness) - blank[1]
                variance[index, 1] = (reading.stiffness_noise or reading.noise) ** 2
        pose = [[noise.pose if sd is None else sd for sd in (reading.x_sd, reading.y_sd)] for reading in readings]
        weights, spreads = (part.reshape(k, len(loads.nodes)) for part in loads.weigh(forces))
        return cls(
            np.array([(reading.x, reading.y) for reading in readings]).reshape(k, 2), values, variance,
            np.array(pose, dtype=float).reshape(k, 2), np.array([reading.blank for reading in readings], dtype=bool),
            conditions.errors, weights, spreads,
        )  # fmt: skip

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self.values)

    def select(self, rows: Bools | slice) -> ScanData:
        """Return some of the readings."""
        return replace(self, **{key: getattr(self, key)[rows] for key in ARRAYS})

    def join(self, new_data: ScanData) -> ScanData:
        """Return these readings followed by new ones."""
        joined: dict[str, Any] = {key: np.concatenate([getattr(self, key), getattr(new_data, key)]) for key in ARRAYS}
        return replace(self, **joined)

    @property
    def is_read(self) -> Bools:
        """Which channels are read, shape (k, 2)."""
        return np.isfinite(self.variance)


def check_places(readings: Sequence[Reading]) -> None:
    """Refuse readings from which no place can be inferred.

    Raises
    ------
    InputError
        There are too few, or all lie at the same place.
    """
    over_tissue = [reading for reading in readings if not reading.blank]
    if len(over_tissue) < MIN_READINGS:
        allowed = f"{MIN_READINGS} or more besides baseline readings (blank = true)"
        raise InputError("readings", Words(f"{len(over_tissue)} over the tissue"), allowed)
    places = {(reading.x, reading.y) for reading in over_tissue}
    if len(places) == 1:
        x, y = places.pop()
        place = Words(f"all at x = {format_mm(x)}, y = {format_mm(y)}")
        raise InputError("readings", place, "readings at several places, stated by the columns x and y with their units")
