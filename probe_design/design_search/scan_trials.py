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
from probe_design.estimation.measurements import Reading
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.prior import TumourPrior
from probe_design.locating.run import build_models
from probe_design.locating.samples import CONVERGED_SIZE
from probe_design.locating.sampling import draw_posterior
from probe_design.locating.scan_data import ScanConditions, ScanData
from probe_design.populations.design_file import Design
from probe_design.populations.objective import Kind, Objective
from probe_design.populations.population import TumourDraw
from probe_design.populations.several_loads import limit_loads

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
        forces = limit_loads(design.protocol, np.inf if scene.load.force is None else scene.load.force)
        protocol = design.protocol.model_copy(update={"loads": tuple(forces)})
        bench = _Bench.from_design(design.model_copy(update={"scene": scene, "protocol": protocol}))
        tumours = np.stack([draw.x, draw.y, draw.depth, draw.diameter, draw.youngs_modulus], axis=-1)
        fitting = np.flatnonzero(bench.prior.find_allowed(tumours[:, None]))
        if len(fitting) < min(MIN_TRIALS, len(draw)):
            raise Refusal("population", Words(f"{len(fitting)} tumours fit the middle tissue"), "ranges of which more fit")
        rows = np.array([bench.try_tumour(tumours[number], number) for number in fitting.tolist()])
        values: dict[Kind, Floats] = {"place_error": rows[:, 0], "information": rows[:, 1]}
        narrow = int((rows[:, 3] < CONVERGED_SIZE).sum())
        return cls(values, rows[:, 2], draw.tissue[fitting], bench.signal_error, bench.conditions.loads.evaluator, narrow)

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
    likelihood
        As in `locate`, of the scan without a tumour and without noise.
    conditions
        What its readings have in common.
    """

    likelihood: Likelihood
    conditions: ScanConditions

    @classmethod
    def from_design(cls, design: Design) -> _Bench:
        """Prepare the scan of a design file's protocol, whose places are all read under each of its loads."""
        conditions, protocol = ScanConditions.from_design(design), design.protocol
        places, readings = protocol.list_places(design.scene.placement.y), list[Reading]()
        for force in protocol.loads or (None,):
            noise, stiffness_noise = conditions.loads.compute_noise(design.noise, force)
            for k, (x, y) in enumerate([*places.tolist(), *[(0.0, 0.0)] * protocol.blank]):
                stiffness = 1.0 if protocol.stiffness else None
                is_blank = k == len(places)
                readings.append(
                    Reading(
                        x, y, 1.0, max(noise, MIN_NOISE), stiffness, max(stiffness_noise, MIN_NOISE), blank=is_blank, force=force
                    )
                )
        data = ScanData.from_readings(readings, design, conditions)
        prior = TumourPrior.from_design(design, places)
        without = replace(data, values=np.zeros_like(data.values))
        return cls(Likelihood(without, build_models(prior, conditions.loads.scenes), prior), conditions)

    @property
    def prior(self) -> TumourPrior:
        """Tumours before the readings."""
        return self.likelihood.prior

    @property
    def signal_error(self) -> float:
        """Largest relative error of a predicted signal."""
        model_error = np.max([model.error for model in self.likelihood.models])
        return float(np.hypot(model_error, self.likelihood.rows.total_scale.max(initial=0.0)))

    def try_tumour(self, tumour: Floats, number: int) -> tuple[float, float, float, float]:
        """Simulate and explain a scan over a tumour, shape (5,).

        Returns
        -------
        tuple[float, float, float, float]
            The place's standard deviation, m; the information, nats; the distance of the mean place from the tumour, m; the
            effective sample size.
        """
        rng = np.random.default_rng((SEED, number))
        data = replace(self.likelihood.data, values=self._simulate(tumour, rng))
        likelihood = replace(self.likelihood, data=data)
        sample = draw_posterior(likelihood, 1, SEED + number)
        places = self.prior.transform(sample.points)[:, 0, :2]
        mean = sample.weights @ places
        variance = sample.weights @ (places - mean) ** 2
        log_likelihood = likelihood.evaluate(sample.resample(SETS, rng)).mean()
        information = max(float(log_likelihood) - sample.log_evidence, 0.0)
        return float(np.sqrt(variance.sum())), information, float(np.linalg.norm(mean - tumour[:2])), sample.size

    def _simulate(self, tumour: Floats, rng: np.random.Generator) -> Floats:
        """Return the readings of a scan over a tumour against tissue without it, eq. LO.1, shape (k, 2)."""
        data, models = self.likelihood.data, self.likelihood.models
        moved = data.positions + data.pose_sd * rng.standard_normal(data.positions.shape)
        likelihood = replace(self.likelihood, data=replace(data, positions=moved))
        (signal,), (spread,) = likelihood.predict(tumour[None, None])
        rows, relative = likelihood.rows, data.weights @ np.stack([model.error for model in models])
        common = np.einsum("q,qkc->kc", rng.standard_normal(len(rows.constant)), rows.constant + rows.scale * signal)
        sd = np.sqrt(np.where(data.is_read, data.variance, 0.0) + spread + (relative * signal) ** 2)
        return np.where(data.is_read, signal + common + sd * rng.standard_normal(signal.shape), 0.0)
