"""Collect the readings of a scan as residuals against tumour-free tissue, with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from probe_design.estimation.measurements import Reading
from probe_design.populations.design_file import Design
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.noise import compute_common_variances
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.planning.load_limits import compute_load_limits

MIN_READINGS = 3  # over the tissue: with fewer, every tumour of a population explains them
BASE_ACCURACY = 0.01  # relative, of the probe on tumour-free tissue
LOAD_ACCURACY = 0.01  # relative change of the ratio by the load above which it is refused, as in `optimize`
MIN_GAIN_SD_RELATIVE = 1e-6  # of a gain that is known: the likelihood divides by its variance


@dataclass(frozen=True)
class TumourFree:
    """The probe on the tissue without tumours.

    Attributes
    ----------
    scene
        The scene without tumours.
    totals
        Force on each film per unit indentation, N/m, and, where charges are read, charge of each film, C/m; shape (2 or 4,).
    logarithms
        Ln ratio, as it is read, and ln stiffness, N/m; shape (2,).
    """

    scene: Scene
    totals: Floats
    logarithms: Floats

    @classmethod
    def from_scene(cls, scene: Scene) -> TumourFree:
        """Solve the probe on the tissue of a scene.

        Raises
        ------
        Refusal
            ``equivalent-inclusion`` cannot model the scene.
        """
        scene = scene.model_copy(update={"inclusion": ()})
        films = EquivalentInclusion().prepare(scene, BASE_ACCURACY).films
        totals = np.asarray(stack_totals(scene, films), dtype=float)
        per_area = np.abs(totals[-2:]) / [scene.probe.inner_area, scene.probe.outer_area]
        return cls(scene, totals, np.log([per_area[0] / per_area[1], totals[:2].sum()]))


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
    gain_sd
        Standard deviation of the logarithm of each channel's gain, common to all readings, shape (2,).
    """

    positions: Floats
    values: Floats
    variance: Floats
    pose_sd: Floats
    is_baseline: Bools
    gain_sd: Floats

    @classmethod
    def from_readings(cls, readings: Sequence[Reading], design: Design, tumour_free: TumourFree) -> ScanData:
        """Return the data of readings with the noise of a design file; no reading or any number of them.

        Raises
        ------
        InputError
            A reading was taken at a larger load than linear elasticity, by which the readings are predicted, allows.
        """
        _check_loads(readings, tumour_free.scene)
        k, noise = len(readings), design.noise
        values, variance = np.zeros((k, 2)), np.full((k, 2), math.inf)
        for index, reading in enumerate(readings):
            values[index, 0] = math.log(reading.ratio) - tumour_free.logarithms[0]
            variance[index, 0] = reading.noise**2
            if reading.stiffness is not None:
                values[index, 1] = math.log(reading.stiffness) - tumour_free.logarithms[1]
                variance[index, 1] = (reading.stiffness_noise or reading.noise) ** 2
        pose = [[noise.pose if sd is None else sd for sd in (reading.x_sd, reading.y_sd)] for reading in readings]
        gains = np.sqrt(compute_common_variances(noise, (0, 1), tumour_free.totals))
        return cls(
            np.array([(reading.x, reading.y) for reading in readings]).reshape(k, 2), values, variance,
            np.array(pose, dtype=float).reshape(k, 2), np.array([reading.blank for reading in readings], dtype=bool),
            np.maximum(gains, MIN_GAIN_SD_RELATIVE),
        )  # fmt: skip

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self.values)

    def select(self, rows: Bools | slice) -> ScanData:
        """Return some of the readings."""
        keys = ("positions", "values", "variance", "pose_sd", "is_baseline")
        return replace(self, **{key: getattr(self, key)[rows] for key in keys})

    def join(self, new_data: ScanData) -> ScanData:
        """Return these readings followed by new ones."""
        keys = ("positions", "values", "variance", "pose_sd", "is_baseline")
        return replace(self, **{key: np.concatenate([getattr(self, key), getattr(new_data, key)]) for key in keys})

    @property
    def is_read(self) -> Bools:
        """Which channels are read, shape (k, 2)."""
        return np.isfinite(self.variance)


def check_readings(readings: Sequence[Reading]) -> None:
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


def _check_loads(readings: Sequence[Reading], scene: Scene) -> None:
    """Refuse readings at loads at which finite strain or the closing gap change the ratio, see ``LOAD_ACCURACY``."""
    if not readings:
        return
    largest = compute_load_limits(scene, LOAD_ACCURACY).linear
    if largest is None:
        return
    allowed = f"up to {1e3 * largest.force:.3g} mN: above it linear elasticity, by which locate predicts readings, is off by 1 %"
    for index, reading in enumerate(readings):
        if reading.force is not None and reading.force > largest.force:
            raise InputError(f"reading[{index}].force", Words(f"{1e3 * reading.force:.4g} mN"), allowed)
    load = scene.load
    if all(reading.force is not None for reading in readings):
        return
    if load.indentation is not None and load.indentation > largest.indentation:
        allowed = f"up to {format_mm(largest.indentation)}: above it linear elasticity, by which locate predicts, is off by 1 %"
        raise InputError("load.indentation", format_mm(load.indentation), allowed)
    if load.force is not None and load.force > largest.force:
        raise InputError("load.force", Words(f"{1e3 * load.force:.4g} mN"), allowed)
