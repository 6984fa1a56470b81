"""Simulate scans of known truth, and prepare their inference as `locate` does.

Readings are those of ``equivalent-inclusion`` with all reflections, all tumours together, or of ``contact`` under a load, never
of the tables by which the inference predicts. White noise, charge noise, a gain common to the scan and its baseline reading, and
errors of the probe's place are added. Each scan has random numbers of its own, so that a run may continue where it was cut off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.locating.forward_model import SCENE_TABLES, build_positions
from geometry import Scene
from geometry.common.arrays import Floats
from probe_design.data.noise import find_charge_per_force
from probe_design.estimation.measurements import Reading
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.run import build_models
from probe_design.locating.scan_data import ScanConditions, ScanData
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.population import ScenePopulation
from solver.inclusions.tumours import Tumours
from solver.reading_tables.effect_samplers import LinearEffects, LoadedEffects

NARROW = {"depth": ["8 mm", "20 mm"], "diameter": ["5 mm", "12 mm"], "object": ["16 kPa", "32 kPa"]}
WIDE = {"depth": ["5 mm", "25 mm"], "diameter": ["4 mm", "16 mm"], "object": ["8 kPa", "160 kPa"]}
COMMON = {"x": ["-16 mm", "16 mm"], "least_cover": "2 mm", "tumours": 1}
NOISE = {"white": 0.01, "gain": 0.05, "stiffness_white": 0.03, "stiffness_gain": 0.05, "charge": "0 pC"}
SKIN = {"thickness": "1 mm", "youngs_modulus": "20 kPa", "poisson_ratio": 0.45}
FAT = {"thickness": "12 mm", "youngs_modulus": "3 kPa", "poisson_ratio": 0.45}
BASELINE = (30e-3, 0.0)  # place of the baseline reading, m
TISSUES = 12  # different ones, where the tissue is not known
SEED = 39


@dataclass(frozen=True)
class Setting:
    """Tumours, tissue and errors of some scans.

    Attributes
    ----------
    population
        Table of the design file.
    has_stiffness
        Whether the stiffness is read besides the ratio.
    tissue
        Entries of the scene's tissue that differ from ``SCENE_TABLES``.
    noise
        Entries of the design's noise that differ from ``NOISE``.
    probe
        Entries of the scene's probe that differ from ``SCENE_TABLES``.
    load
        Force under which ``contact`` simulates the readings; linear elasticity without.
    """

    population: dict[str, Any]
    has_stiffness: bool = False
    tissue: dict[str, Any] = field(default_factory=dict)
    noise: dict[str, Any] = field(default_factory=dict)
    probe: dict[str, Any] = field(default_factory=dict)
    load: str | None = None


@dataclass(frozen=True)
class Scan:
    """A simulated scan.

    Attributes
    ----------
    readings
        The baseline reading first.
    likelihood
        Of the readings, as `locate` has it.
    """

    readings: tuple[Reading, ...]
    likelihood: Likelihood


class ScanMaker:
    """A setting with its design, prior and model.

    Parameters
    ----------
    name
        Of the setting; part of the seed.
    setting
        What is simulated.
    """

    def __init__(self, name: str, setting: Setting) -> None:
        load = {} if setting.load is None else {"load": {"force": setting.load}}
        parts = {"tissue": SCENE_TABLES["tissue"] | setting.tissue, "probe": SCENE_TABLES["probe"] | setting.probe}
        tables = SCENE_TABLES | parts | load
        self.name, self.setting, self.positions = name, setting, build_positions()
        self.design: Design = design_from_dict(
            {"scene": tables, "population": COMMON | setting.population, "noise": NOISE | setting.noise}
        )
        self.conditions = ScanConditions.from_design(self.design)
        self.prior = TumourPrior.from_design(self.design, self.positions)

    @cached_property
    def model(self) -> ForwardModel:
        """The table by which the inference predicts."""
        return build_models(self.prior, self.conditions.loads.scenes)[0]

    @cached_property
    def unread(self) -> Likelihood:
        """The likelihood of readings that are those of no tumour, for their noise."""
        return self.build_likelihood(self.build_readings(np.zeros((len(self.positions) + 1, 2))))

    @cached_property
    def gain_sd(self) -> Floats:
        """Standard deviation of all that moves the readings alike, of ln ratio and ln stiffness, shape (2,)."""
        return np.asarray(self.unread.rows.total_constant.max(axis=0))

    def build_rng(self, index: int, part: int = 0) -> np.random.Generator:
        """Return the random numbers of a scan."""
        return np.random.default_rng((SEED, crc32(self.name.encode()), index, part))

    def draw_tumours(self, index: int, count: int = 1) -> Floats:
        """Return tumours of the prior that fit the tissue, shape (count, 5)."""
        drawn = self.prior.transform(self.build_rng(index).random((256, count, 5))[..., list(self.prior.free)])
        return np.asarray(drawn[self.prior.find_allowed(drawn)][0])

    @cached_property
    def tissues(self) -> list[Scene]:
        """Tissues of the population without tumours: several where its ranges leave them open."""
        scene = self.design.scene.model_copy(update={"inclusion": ()})
        population = ScenePopulation.from_scene(self.design.scene, self.design.population)
        keys = [key for key in population.tissue_parameters if not population.ranges[key].is_single]
        if not keys:
            return [scene]
        steps = np.tile((np.arange(TISSUES) + 0.5) / TISSUES, (len(keys), 1))
        fractions = np.random.default_rng(SEED).permuted(steps, axis=1)
        columns = {key: population.ranges[key].compute_quantiles(row) for key, row in zip(keys, fractions, strict=True)}
        return [population.build_tissue_scene({key: float(column[k]) for key, column in columns.items()}) for k in range(TISSUES)]

    def simulate(self, index: int, tumours: Floats, positions: Floats) -> Floats:
        """Return ln ratio and ln stiffness, N/m, of the baseline reading and of the others without noise, shape (k + 1, 2)."""
        scene = self.tissues[index % len(self.tissues)]
        sampler = LinearEffects(scene) if self.setting.load is None else LoadedEffects(scene)
        totals = np.abs(sampler.films.totals)[None]
        if len(tumours):
            x, y, depth, diameter, modulus = (np.tile(column, (len(positions), 1)) for column in tumours.T)
            spheres = Tumours(x - positions[:, :1], y - positions[:, 1:], depth, diameter, modulus, 0.45)
            read = sampler.read_sets(spheres)
            totals = np.concatenate([totals, read.totals])
            stiffness = np.concatenate([[sampler.films.totals.sum()], read.stiffness])
        else:
            totals = np.repeat(totals, len(positions) + 1, axis=0)
            stiffness = totals.sum(axis=1)
        probe = scene.probe
        ratio = totals[:, 0] / totals[:, 1] * probe.outer_area / probe.inner_area
        return np.asarray(np.log(np.stack([ratio, stiffness], axis=-1)))

    def move(self, index: int) -> Floats:
        """Return the places where the probe really is, m, shape (k, 2)."""
        return self.positions + self.design.noise.pose * self.build_rng(index, 1).standard_normal(self.positions.shape)

    def add_noise(self, index: int, truth: Floats) -> Floats:
        """Return simulated readings with noise and a common gain, as logarithms, shape (k + 1, 2)."""
        noise, rng = self.design.noise, self.build_rng(index, 2)
        gains = np.array([np.sqrt(2) * noise.gain, noise.stiffness_gain]) * rng.standard_normal(2)
        values = truth + gains + [noise.white, noise.stiffness_white] * rng.standard_normal(truth.shape)
        if noise.charge:
            probe = self.design.scene.probe
            forces = np.exp(truth[:, 0]) * probe.inner_area / probe.outer_area
            shares = np.stack([forces, np.ones_like(forces)], axis=-1) / (1 + forces)[:, None]
            charges = find_charge_per_force(probe) * (self.design.scene.load.force or 0.0) * shares
            off = noise.charge * rng.standard_normal(charges.shape) / charges
            values[:, 0] += np.log(np.abs(1 + off[:, 0]) / np.abs(1 + off[:, 1]))
        return np.asarray(values)

    def build_readings(self, values: Floats) -> tuple[Reading, ...]:
        """Return readings from logarithms, the baseline reading first."""
        noise, stiffness_noise = self.conditions.loads.compute_noise(self.design.noise, None)
        places = [BASELINE, *self.positions.tolist()]
        read = np.exp(values).tolist()
        return tuple(
            Reading(x, y, ratio, noise, stiffness if self.setting.has_stiffness else None, stiffness_noise, blank=row == 0)
            for row, ((x, y), (ratio, stiffness)) in enumerate(zip(places, read, strict=True))
        )

    def build_likelihood(self, readings: Sequence[Reading], outlier_rate: float = 0.0) -> Likelihood:
        """Return the likelihood of readings as `locate` builds it."""
        data = ScanData.from_readings(readings, self.design, self.conditions)
        return Likelihood(data, (self.model,), self.prior, outlier_rate)

    def compute_deflections(self, tumours: Floats) -> Floats:
        """Return the deflection of a scan by each tumour, shape (n, 5), in standard deviations beside a gain, (n,)."""
        data = self.unread.data
        signals = np.zeros((len(tumours), len(data), 2))
        signals[:, 1:] = self.model.predict(tumours[:, None], self.positions)
        S0, S1, S2 = (((signals**power) / data.variance).sum(axis=1) for power in range(3))
        return np.asarray(np.sqrt((S2 - S1**2 / (S0 + self.gain_sd**-2.0)).sum(axis=-1)))
