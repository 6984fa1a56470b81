"""Collect the readings of a scan as residuals against tumour-free tissue, with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from probe_design.estimation.measurements import Reading
from probe_design.locating.tissue_errors import estimate_tissue_errors
from probe_design.populations.design_file import Design
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.noise import compute_common_variances
from probe_design.populations.population import ScenePopulation
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.planning.load_limits import compute_load_limits
from solver.reading_tables.effect_samplers import LOAD_ACCURACY, choose_sampler

MIN_READINGS = 3  # over the tissue: with fewer, every tumour of a population explains them
MAX_FORCE_CHANGE_RELATIVE = 0.05  # of a reading's force, from the one under which readings are predicted
MIN_GAIN_SD_RELATIVE = 1e-6  # of a gain that is known: the likelihood divides by its variance


@dataclass(frozen=True)
class TumourFree:
    """The probe on the tissue without tumours, under the scene's load where that is beyond linear elasticity.

    Attributes
    ----------
    scene
        The scene without tumours.
    totals
        Force on each film per unit indentation, N/m, and, where charges are read, charge of each film, C/m; shape (2 or 4,).
    logarithms
        Ln ratio, as it is read, and ln stiffness, N/m; shape (2,).
    errors
        Their standard deviations by errors of the model, and by what is not known of the tissue, shape (2,).
    signal_errors
        Relative standard deviations of what tumours change, by what is not known of the tissue, shape (2,).
    evaluator
        Name of the model of the readings.
    """

    scene: Scene
    totals: Floats
    logarithms: Floats
    errors: Floats = field(default_factory=lambda: np.zeros(2))
    signal_errors: Floats = field(default_factory=lambda: np.zeros(2))
    evaluator: str = EquivalentInclusion.name

    @classmethod
    def from_scene(cls, scene: Scene) -> TumourFree:
        """Solve the probe on the tissue of a scene.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene or its load.
        """
        scene = scene.model_copy(update={"inclusion": ()})
        sampler = choose_sampler(scene)
        films = sampler.films
        totals = np.asarray(stack_totals(scene, films), dtype=float)
        per_area = np.abs(totals[-2:]) / [scene.probe.inner_area, scene.probe.outer_area]
        errors = np.array([films.get_observable(scene).bound.log_ratio, films.stiffness_error]) / 2  # of bounds
        return cls(scene, totals, np.log([per_area[0] / per_area[1], totals[:2].sum()]), errors, np.zeros(2), sampler.name)

    @classmethod
    def from_design(cls, design: Design) -> TumourFree:
        """Solve the probe on the tissue in the middle of a design's ranges; what is not known of it counts as errors.

        Raises
        ------
        InputError
            No tumour of the population fits the tissue at both ends of its ranges.
        Refusal
            The evaluator cannot model the scene or its load.
        """
        population = ScenePopulation.from_scene(design.scene, design.population)
        free = cls.from_scene(population.middle)
        readings, signals = estimate_tissue_errors(population)
        return replace(free, errors=np.hypot(free.errors, readings), signal_errors=signals)

    @property
    def is_linear(self) -> bool:
        """Whether readings are predicted by linear elasticity."""
        return self.evaluator == EquivalentInclusion.name


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
    scale_sd
        Standard deviation of the logarithm of all signals of tumours, as the tissue is not known, shape (2,).
    """

    positions: Floats
    values: Floats
    variance: Floats
    pose_sd: Floats
    is_baseline: Bools
    gain_sd: Floats
    scale_sd: Floats = field(default_factory=lambda: np.zeros(2))

    @classmethod
    def from_readings(cls, readings: Sequence[Reading], design: Design, tumour_free: TumourFree) -> ScanData:
        """Return the data of readings with the noise of a design file; no reading or any number of them.

        Raises
        ------
        InputError
            A reading was taken at another load than those for which readings are predicted.
        """
        _check_loads(readings, tumour_free)
        k, noise = len(readings), design.noise
        values, variance = np.zeros((k, 2)), np.full((k, 2), math.inf)
        for index, reading in enumerate(readings):
            values[index, 0] = math.log(reading.ratio) - tumour_free.logarithms[0]
            variance[index, 0] = reading.noise**2
            if reading.stiffness is not None:
                values[index, 1] = math.log(reading.stiffness) - tumour_free.logarithms[1]
                variance[index, 1] = (reading.stiffness_noise or reading.noise) ** 2
        pose = [[noise.pose if sd is None else sd for sd in (reading.x_sd, reading.y_sd)] for reading in readings]
        # errors of the prediction without tumours are common to all readings, as the gain is
        gains = np.sqrt(compute_common_variances(noise, (0, 1), tumour_free.totals) + tumour_free.errors**2)
        return cls(
            np.array([(reading.x, reading.y) for reading in readings]).reshape(k, 2), values, variance,
            np.array(pose, dtype=float).reshape(k, 2), np.array([reading.blank for reading in readings], dtype=bool),
            np.maximum(gains, MIN_GAIN_SD_RELATIVE), tumour_free.signal_errors,
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


def _check_loads(readings: Sequence[Reading], tumour_free: TumourFree) -> None:
    """Refuse readings at other loads than those for which they are predicted."""
    forces = [(index, reading.force) for index, reading in enumerate(readings) if reading.force is not None]
    if not forces:
        return
    if tumour_free.is_linear:
        largest = compute_load_limits(tumour_free.scene, LOAD_ACCURACY).linear
        high, low = math.inf if largest is None else largest.force, 0.0
        allowed = f"up to {1e3 * high:.3g} mN: above it linear elasticity, by which the design's load is predicted, is off by 1 %"
    else:
        force = tumour_free.scene.load.force or 0.0
        low, high = (force * (1 + sign * MAX_FORCE_CHANGE_RELATIVE) for sign in (-1, 1))
        allowed = f"{1e3 * low:.4g} to {1e3 * high:.4g} mN, near the design's load.force, under which readings are predicted"
    for index, force in forces:
        if not low <= force <= high:
            raise InputError(f"reading[{index}].force", Words(f"{1e3 * force:.4g} mN"), allowed)
