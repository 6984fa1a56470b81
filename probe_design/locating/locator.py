"""Locate tumours while the scan goes on: the map after each reading, and where to press next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import softmax

from geometry.common.arrays import Bools, Floats
from geometry.common.calls import check_call
from geometry.common.errors import InputError, Words
from probe_design.estimation.made_readings import add_si_units
from probe_design.estimation.measurements import Reading, build_scan_reading, is_on_tissue
from probe_design.locating.inference import Posterior, infer
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location
from probe_design.locating.next_position import MAX_PARTICLES, CandidateLoad, NextPosition, build_candidates, choose_position
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.run import build_models
from probe_design.locating.samples import Sample
from probe_design.locating.scan_data import MIN_READINGS, ScanConditions, ScanData
from probe_design.locating.scan_loads import SAME_FORCE_RELATIVE
from probe_design.locating.stopping import PlannedScan, Stop, find_stop
from probe_design.locating.streaming import Stream
from probe_design.populations.design_file import Design, DesignSource, read_design_source

DETECTED_SETS = 1000  # of tumours, by which the probability of detectable ones is known to 0.01
Region = tuple[tuple[float, float], tuple[float, float]]


class NoRecommendation(Exception):  # noqa: N818
    """Raised by ``Locator.ask`` where the survey may stop: no further reading is recommended."""


class Locator:
    """The posterior of the tumours, updated by each reading; the same seed and readings give the same numbers.

    ``update`` takes a reading, ``map`` returns what `locate` returns for the readings so far, ``next_position`` the place whose
    reading is expected to say the most, ``find_stop`` whether to stop. ``tell`` and ``ask`` are the same for programs that are
    written for the recommenders of bluesky-adaptive.

    Parameters
    ----------
    design : Design, mapping, or the name of a design file
        Probe, tissue, population and noise. Where [population] has no x, tumours lie within the positions of [protocol]; where it
        has no y, y ranges as x.
    outliers
        Expected fraction of wild readings.
    seed
        Of the random numbers.
    model
        Predicts readings; default: the table of the probe on the tissue.

    Examples
    --------
    >>> locator = Locator("design.toml")  # doctest: +SKIP
    >>> locator.update({"x": "30 mm", "y": "0 mm", "ratio": 0.391, "blank": True})  # doctest: +SKIP
    >>> locator.next_position()  # doctest: +SKIP
    """

    @check_call
    def __init__(self, design: DesignSource, *, outliers: float = 0.0, seed: int = 0, model: ForwardModel | None = None) -> None:
        known = read_design_source(design)
        if not isinstance(known, Design):
            raise InputError("design", Words("a scene file"), "a design file, with [population] and [noise]")
        if not 0 <= outliers <= 0.3:
            raise InputError("outliers", outliers, "a fraction from 0 to 0.3")
        self.design, self.seed, self.readings = known, seed, ()
        self._conditions = ScanConditions.from_design(known)
        lines = known.protocol.places
        grid = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
        prior = TumourPrior.from_design(known, grid)
        data = ScanData.from_readings((), known, self._conditions)
        models = build_models(prior, self._conditions.loads.scenes) if model is None else (model,)
        self._likelihood = Likelihood(data, models, prior, outliers)
        self._streams = tuple(Stream.from_prior(self._likelihood, number, seed) for number in range(1, len(prior.numbers)))
        self._posterior = self._combine()

    readings: tuple[Reading, ...]

    @property
    def probability(self) -> tuple[float, ...]:
        """Probability of no tumour, of one and so on."""
        return tuple(self._posterior.probability.tolist())

    @property
    def probability_none(self) -> float:
        """Probability of no tumour."""
        return self.probability[0]

    @property
    def prior(self) -> TumourPrior:
        """Tumours before the readings."""
        return self._likelihood.prior

    @property
    def loads(self) -> tuple[float | None, ...]:
        """Forces under which places are read, N: those of the protocol, without them None for the scene's load."""
        return self._conditions.loads.pressed

    @property
    def region(self) -> Region:
        """Where the probe presses: the population's places without their margin, ((low x, high x), (low y, high y)), m."""
        x, y = (
            (
                min(part.values) + self.design.population.margin * part.continuous,
                max(part.values) - self.design.population.margin * part.continuous,
            )
            for part in self.prior.ranges[:2]
        )
        return x, y

    def update(self, reading: Reading | Mapping[str, object]) -> None:
        """Take a reading into account.

        Parameters
        ----------
        reading
            A ``Reading``, or the entries of a line of a scan's file: x, y, ratio, and perhaps stiffness, noise, stiffness_noise,
            x_sd, y_sd, blank, force; numbers in SI units, or texts with units.

        Raises
        ------
        InputError
            An entry is not allowed.
        """
        entries = add_si_units(vars(reading) if isinstance(reading, Reading) else reading)
        reading = build_scan_reading(f"reading[{len(self.readings)}].", entries, self.design.scene, self._compute_noise)
        new_data = ScanData.from_readings((reading,), self.design, self._conditions)
        self._likelihood = replace(self._likelihood, data=self._likelihood.data.join(new_data))
        self.readings = (*self.readings, reading)
        count = len(self.readings)
        self._streams = tuple(
            stream.update(self._likelihood, np.random.default_rng((self.seed, number, count)), self.seed)
            for number, stream in enumerate(self._streams, start=1)
        )
        self._posterior = self._combine()

    def map(self) -> Location:
        """Return numbers, places, depths and sizes of the tumours given the readings so far, as `locate` does."""
        return infer(self._likelihood, self._conditions, self.seed, advise=False, posterior=self._posterior)

    def next_position(self, candidates: Floats | None = None, *, region: Region | None = None) -> NextPosition:
        """Return the place, and of several loads the one, whose reading is expected to say the most about the tumours.

        Parameters
        ----------
        candidates
            Places of the probe's axis, m, shape (k, 2), under each load of the protocol; or with the force, N, shape (k, 3);
            default: a grid over the region.
        region
            ((lowest x, highest x), (lowest y, highest y)), m; default: where tumours may lie.

        Raises
        ------
        InputError
            No candidate lies on the tissue, or a force is outside the loads at which readings are predicted.
        """
        given = np.atleast_2d(
            np.asarray(build_candidates(self.region if region is None else region) if candidates is None else candidates, float)
        )
        if given.shape[1] not in (2, 3) or not np.all(np.isfinite(given)):
            raise InputError("candidates", Words(f"an array of shape {given.shape}"), "finite numbers of shape (k, 2) or (k, 3)")
        loads, scene = self._conditions.loads, self._conditions.loads.main.scene
        on_tissue = given[[is_on_tissue(scene, x, y) for x, y in given[:, :2].tolist()]]
        if not len(on_tissue):
            raise InputError("candidates", Words("none on the tissue"), "places where the whole probe stands on the tissue")
        if given.shape[1] == 2:
            options = [(self._build_load(force), on_tissue) for force in self.loads]
        else:
            forces = np.unique(on_tissue[:, 2])
            loads.check_forces(forces.tolist())
            options = [(self._build_load(float(force)), on_tissue[on_tissue[:, 2] == force, :2]) for force in forces]
        return choose_position(self._likelihood, self.draw_sets(MAX_PARTICLES), self._posterior.probability, options)

    def get_sample(self, number: int) -> Sample:
        """Return the weighted sample of the posterior of a number of tumours, 1 or more."""
        return self._streams[number - 1].sample

    def draw_sets(self, count: int) -> tuple[Floats, ...]:
        """Return equally probable sets of tumours of each number above 0, shape (count, number, 5) each."""
        rng = np.random.default_rng((self.seed, 0, len(self.readings)))
        return tuple(self.prior.transform(stream.sample.resample(count, rng)) for stream in self._streams)

    @cached_property
    def planned_scan(self) -> PlannedScan:
        """The scan of the design's protocol, with the tumours that it detects."""
        loads = [replace(self._build_load(force), variance=self._compute_own_variance(force)) for force in self.loads]
        return PlannedScan.from_design(self.design, self._likelihood, loads)

    def compute_detectable_probability(self) -> float:
        """Return the probability that tumours lie there which the protocol's scan detects with a probability of 0.9."""
        fractions = [self.planned_scan.compute_detected_fraction(tumours) for tumours in self.draw_sets(DETECTED_SETS)]
        return float(self._posterior.probability[1:] @ np.array(fractions))

    def find_stop(self, following: NextPosition | None = None) -> Stop | None:
        """Return why the survey may stop, or None while further readings are worth their while, three at least.

        Parameters
        ----------
        following
            Result of ``next_position``, where it is computed before.
        """
        if sum(not reading.blank for reading in self.readings) < MIN_READINGS:
            return None
        following = self.next_position() if following is None else following
        return find_stop(self.probability_none, self.compute_detectable_probability(), following.information)

    def tell(self, x: Sequence[float], y: Sequence[float] | float) -> None:
        """Take a reading into account: x is (x, y), m, perhaps with the force, N, y the ratio or (ratio, stiffness in N/m)."""
        values = np.atleast_1d(np.asarray(y, dtype=float)).tolist()
        if not (2 <= len(x) <= 3 and 1 <= len(values) <= 2):
            allowed = "a place (x, y) or (x, y, force), and a ratio or (ratio, stiffness)"
            raise InputError("reading", Words(f"{len(x)} and {len(values)} numbers"), allowed)
        entries: dict[str, object] = dict(zip(("x", "y", "force"), map(float, x), strict=False))
        self.update(entries | dict(zip(("ratio", "stiffness"), values, strict=False)))

    def tell_many(self, xs: Iterable[Sequence[float]], ys: Iterable[Sequence[float] | float]) -> None:
        """Take several readings into account, see ``tell``."""
        for x, y in zip(xs, ys, strict=True):
            self.tell(x, y)

    def ask(self, n: int = 1, tell_pending: bool = True) -> tuple[float, ...]:
        """Return the place of the next reading, m, and, with loads of the protocol, its force, N.

        n is 1, as every reading changes the next place.

        Raises
        ------
        NoRecommendation
            The survey may stop.
        """
        del tell_pending
        if n != 1:
            raise NotImplementedError("one place at a time: the next reading changes where to press")
        following = self.next_position()
        if (stop := self.find_stop(following)) is not None:
            raise NoRecommendation(stop.text)
        return (following.x, following.y, *(() if following.force is None else (following.force,)))

    def _build_load(self, force: float | None) -> CandidateLoad:
        """Return a load of the next reading, N; None for the scene's."""
        weights, spreads = self._conditions.loads.weigh([force])
        return CandidateLoad(force, weights[0], spreads[0], self._expect_variance(force))

    def _compute_noise(self, force: float | None) -> tuple[float, float]:
        """Return the standard deviations of a reading of ratio and stiffness at a force, N, by the design's noise."""
        return self._conditions.loads.compute_noise(self.design.noise, force)

    @property
    def _channels(self) -> Bools:
        """Whether ratio and stiffness are read: as in the readings so far, or as the protocol says; shape (2,)."""
        if not self.readings:
            return np.array([True, self.design.protocol.stiffness])
        return np.asarray(self._likelihood.data.is_read.any(axis=0))

    def _compute_own_variance(self, force: float | None) -> Floats:
        """Return the variance of a reading at a force by the design's noise, inf where a channel is not read, shape (2,)."""
        return np.where(self._channels, np.square(self._compute_noise(force)), np.inf)

    def _expect_variance(self, force: float | None) -> Floats:
        """Return the variance of the next reading: that of those at this force, N, if any, else by the design's noise."""
        data, scene_force = self._likelihood.data, self._conditions.loads.main.scene.load.force or 0.0
        at_forces = np.array([scene_force if part.force is None else part.force for part in self.readings])
        chosen = np.isclose(at_forces, scene_force if force is None else force, rtol=SAME_FORCE_RELATIVE, atol=0.0)
        if not np.any(chosen):
            return self._compute_own_variance(force)
        return np.asarray(np.median(np.where(data.is_read, data.variance, np.inf)[chosen], axis=0))

    def _combine(self) -> Posterior:
        """Return the posterior of all numbers of tumours."""
        none = float(self._likelihood.evaluate_tumours(np.zeros((1, 0, 5)))[0]) if self.readings else 0.0
        log_evidence = np.array([none, *(stream.sample.log_evidence for stream in self._streams)])
        with np.errstate(divide="ignore"):
            probability = softmax(log_evidence + np.log(self._likelihood.prior.numbers))
        return Posterior(tuple(stream.sample for stream in self._streams), log_evidence, probability)
