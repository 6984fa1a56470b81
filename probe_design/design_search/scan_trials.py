"""Verify what a scan says of tumours: simulate one scan over each, and explain it as `locate` does, given that there is one.

The readings over a tumour follow eq. LO.1 with the table of ``equivalent-inclusion`` or ``contact`` that `locate` uses, each
error of it drawn. Of the posterior of one tumour the place's standard deviation is (var x + var y)^(1/2), and the information
its divergence from the prior, the posterior mean of ln L less ln of the evidence. Both are exact but for the samples: they know
that a weak tumour may seem to lie elsewhere, which readings linearised about it, as those of the search, do not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.data.noise import MIN_NOISE
from probe_design.locating.forward_model import build_model
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.samples import CONVERGED_SIZE
from probe_design.locating.sampling import draw_posterior
from probe_design.locating.scan_data import ScanData, TumourFree
from probe_design.populations.design_file import Design
from probe_design.populations.noise import compute_reading_variances
from probe_design.populations.objective import Kind, Objective
from probe_design.populations.population import TumourDraw

SEED = 39  # of noise and samples, the same for every design, so that the differences between designs are more exact
SETS = 512  # equally probable sets of a posterior, over which ln L is averaged: its standard error is 0.07 nats
MIN_TRIALS = 2


@dataclass(frozen=True)
class ScanTrials:
    """Simulated scans over n tumours, and what `locate` says of each.

    Attributes
    ----------
    values
        Standard deviation of the place, m, and information, nats, of each tumour, shape (n,).
    distances
        Between the posterior mean of the place and the tumour, m, shape (n,).
    tissue
        Number of each tumour's tissue in the draw, shape (n,).
    model_error
        Relative error of the predicted signals.
    evaluator
        Model of the readings.
    narrow
        Trials whose samples are too few for a good posterior.
    """

    values: dict[Kind, Floats]
    distances: Floats
    tissue: Ints
    model_error: float
    evaluator: str
    narrow: int

    @classmethod
    def from_design(cls, design: Design, scene: Scene, draw: TumourDraw) -> ScanTrials:
        """Simulate and explain a scan over each tumour of a draw that fits the middle tissue.

        Parameters
        ----------
        design
            Population, protocol and noise.
        scene
            The probe under its load.
        draw
            The tumours.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene or its load, or hardly any tumour fits the middle tissue.
        """
        bench = _Bench.from_design(design.model_copy(update={"scene": scene}))
        tumours = np.stack([draw.x, draw.y, draw.depth, draw.diameter, draw.youngs_modulus], axis=-1)
        fitting = np.flatnonzero(bench.prior.find_allowed(tumours[:, None]))
        if len(fitting) < min(MIN_TRIALS, len(draw)):
            raise Refusal("population", Words(f"{len(fitting)} tumours fit the middle tissue"), "ranges of which more fit")
        rows = np.array([bench.try_tumour(tumours[number], number) for number in fitting.tolist()])
        model, free = bench.model, bench.free
        error = float(np.max(np.hypot(model.error, np.hypot(model.scale_error, free.signal_errors))))
        values: dict[Kind, Floats] = {"place_error": rows[:, 0], "information": rows[:, 1]}
        narrow = int((rows[:, 3] < CONVERGED_SIZE).sum())
        return cls(values, rows[:, 2], draw.tissue[fitting], error, free.evaluator, narrow)

    def compute_objective(self, aim: Objective) -> tuple[float, float]:
        """Return the statistic of the quantity that a design file asks for, and its standard error."""
        values = self.values[aim.maximise]
        return aim.compute_statistic(values), aim.compute_error(values, self.tissue)

    def compute_gain(self, reference: ScanTrials, aim: Objective) -> tuple[float, float]:
        """Return the gain over another probe or scan for the same tumours, above 0 if better, and its standard error."""
        values, others = self.values[aim.maximise], reference.values[aim.maximise]
        gain = aim.sign * (aim.compute_statistic(values) - aim.compute_statistic(others))
        if aim.statistic == "mean":
            return gain, aim.compute_error(values - others, self.tissue)
        return gain, float(np.hypot(aim.compute_error(values, self.tissue), aim.compute_error(others, self.tissue)))

    def as_dict(self) -> JsonObject:
        """Return the means as a JSON object, SI units."""
        mean = Objective()
        numbers = {kind: [float(values.mean()), mean.compute_error(values, self.tissue)] for kind, values in self.values.items()}
        root_mean_square = float(np.sqrt((self.distances**2).mean()))
        return numbers | {
            "distance_rms": root_mean_square, "trials": len(self.distances), "evaluator": self.evaluator,
            "signal_error": self.model_error, "narrow": self.narrow,
        }  # fmt: skip


@dataclass(frozen=True)
class _Bench:
    """A scan of one probe, simulated and explained for any tumour.

    Attributes
    ----------
    prior, model
        As in `locate`.
    free
        The probe on tumour-free tissue.
    without
        The scan without a tumour and without noise.
    """

    prior: TumourPrior
    model: ForwardModel
    free: TumourFree
    without: ScanData

    @classmethod
    def from_design(cls, design: Design) -> _Bench:
        """Prepare the scan of a design file's protocol."""
        free, protocol, noise = TumourFree.from_design(design), design.protocol, design.noise
        places = protocol.list_places(design.scene.placement.y)
        is_baseline = np.arange(len(places) + protocol.blank) >= len(places)
        k = len(is_baseline)
        own = compute_reading_variances(noise, free.scene, free.totals[None])[:, 0]
        variance = np.maximum(np.where([True, protocol.stiffness], own, np.inf), MIN_NOISE**2)
        without = ScanData(
            np.vstack([places, np.zeros((k - len(places), 2))]), np.zeros((k, 2)), np.tile(variance, (k, 1)),
            np.full((k, 2), noise.pose), is_baseline, ScanData.from_readings((), design, free).gain_sd, free.signal_errors,
        )  # fmt: skip
        prior = TumourPrior.from_design(design, places)
        return cls(prior, build_model(prior), free, without)

    def try_tumour(self, tumour: Floats, number: int) -> tuple[float, float, float, float]:
        """Simulate and explain a scan over a tumour, shape (5,).

        Returns
        -------
        tuple[float, float, float, float]
            The place's standard deviation and the distance of its mean from the tumour, m, between them the information, nats;
            last the effective sample size.
        """
        rng = np.random.default_rng((SEED, number))
        likelihood = Likelihood(self._simulate(tumour, rng), self.model, self.prior)
        sample = draw_posterior(likelihood, 1, SEED + number)
        places = self.prior.transform(sample.points)[:, 0, :2]
        mean = sample.weights @ places
        variance = sample.weights @ (places - mean) ** 2
        log_likelihood = likelihood.evaluate(sample.resample(SETS, rng)).mean()
        information = max(float(log_likelihood) - sample.log_evidence, 0.0)
        return float(np.sqrt(variance.sum())), information, float(np.linalg.norm(mean - tumour[:2])), sample.size

    def _simulate(self, tumour: Floats, rng: np.random.Generator) -> ScanData:
        """Return the readings of a scan over a tumour, eq. LO.1."""
        data, model = self.without, self.model
        over = ~data.is_baseline
        values = data.gain_sd * rng.standard_normal(2) + np.zeros((len(data), 2))
        values += np.sqrt(np.where(data.is_read, data.variance, 0.0)) * rng.standard_normal(values.shape)
        moved = data.positions + data.pose_sd * rng.standard_normal(values.shape)
        common = 1 + np.hypot(model.scale_error, data.scale_sd) * rng.standard_normal(2)
        own = model.error * rng.standard_normal(values.shape)
        values[over] += model.predict(tumour[None, None], moved[over])[0] * (common + own[over])
        return replace(data, values=np.where(data.is_read, values, 0.0))
