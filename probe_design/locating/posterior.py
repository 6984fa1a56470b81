"""Summarise a sample of tumours: quantiles, what the readings add to the prior, the region of the place, maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, label

from geometry.common.arrays import Bools, Floats
from probe_design.locating.prior import TUMOUR_QUANTITIES, TumourPrior
from probe_design.locating.samples import Sample

LEARNT_SD_RELATIVE = 0.9  # of the prior's standard deviation: above it a quantity counts as not learnt
REGION_CELL_M = 0.5e-3  # of the grid on which the region of a place is computed
REGION_SMOOTHING_CELLS = (
    2.0  # standard deviation: samples of 600 to 6000 then hold 0.90 to 0.95 of flat, round and ring-like places
)
MAX_CELLS = 200  # of that grid, along x and along y
MIN_PART = 0.2  # of a place's probability, from which a part of its region by itself counts as a place
PRIOR_SAMPLES = 2**13  # for the prior's standard deviations and quantiles
NORMAL_90 = 1.6449  # standard deviations to either side within which 90 % of a normal number lie
SUMMARY_NAMES = (*TUMOUR_QUANTITIES, "ln_contrast")


@dataclass(frozen=True)
class Summary:
    """What the readings say of one quantity of one tumour, SI units.

    Attributes
    ----------
    median
        Posterior median.
    interval_50, interval_90
        Central posterior intervals.
    sd_relative
        Posterior over prior standard deviation; None where the population has a single value.
    is_learnt
        Whether the readings narrow the prior, see ``LEARNT_SD_RELATIVE``.
    """

    median: float
    interval_50: tuple[float, float]
    interval_90: tuple[float, float]
    sd_relative: float | None
    is_learnt: bool


@dataclass(frozen=True)
class CommonSummary(Summary):
    """What the readings say of a number that is common to them: a gain's logarithm, or a number of the tissue, SI units.

    Attributes
    ----------
    before_90
        Central interval before the readings.
    """

    before_90: tuple[float, float]

    @classmethod
    def from_mixture(
        cls, means: Floats, spreads: Floats, weights: Floats, *, deviation: float, middle: float | None
    ) -> CommonSummary:
        """Return the summary of a mixture of normal numbers.

        Parameters
        ----------
        means, spreads, weights
            Of each component, shape (n,); the weights sum to 1.
        deviation
            Standard deviation before the readings, about 0.
        middle
            Number of which these are relative logarithms; None for the logarithms themselves.
        """
        nodes = np.linspace(-4, 4, 81)
        node_weights = np.exp(-(nodes**2) / 2) / np.exp(-(nodes**2) / 2).sum()
        values = (means[:, None] + spreads[:, None] * nodes).ravel()
        quantiles = compute_quantiles(values, (weights[:, None] * node_weights).ravel(), (0.05, 0.25, 0.5, 0.75, 0.95))
        before = deviation * np.array([-1, 1]) * NORMAL_90
        if middle is not None:
            quantiles, before = middle * np.exp(quantiles), middle * np.exp(before)
        low, lower, median, upper, high = quantiles.tolist()
        mean = weights @ means
        sd = float(np.sqrt(weights @ (spreads**2 + (means - mean) ** 2)) / deviation)
        return cls(median, (lower, upper), (low, high), sd, sd < LEARNT_SD_RELATIVE, (float(before[0]), float(before[1])))


def compute_quantiles(values: Floats, weights: Floats, fractions: tuple[float, ...]) -> Floats:
    """Return weighted quantiles of values (n,) with weights that sum to 1, shape (fractions,)."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order]) - weights[order] / 2
    return np.interp(fractions, cumulative, values[order])


def list_values(prior: TumourPrior, tumours: Floats, log_tissue: Floats | float = 0.0) -> Floats:
    """Return the columns named in ``SUMMARY_NAMES`` of tumours (n, m, 5), shape (n, m, 6).

    ``log_tissue``, (n, l), is ln of the modulus of each layer of the tissue, and of the tissue below them, over the middle of its
    range: the contrast is to the layer as it is that holds the tumour.
    """
    hosts = prior.strata.find_layer(tumours[..., 2])
    log_moduli = np.broadcast_to(log_tissue, (len(tumours), len(prior.strata.materials)))
    contrast = prior.compute_contrast(tumours) - np.take_along_axis(log_moduli, hosts, axis=1)
    return np.concatenate([tumours, contrast[..., None]], axis=-1)


def draw_prior_values(prior: TumourPrior, log_tissue_sd: Floats | float) -> Floats:
    """Return ``list_values`` of single tumours of the prior that fit, with standard deviations of ln modulus, (l,); (n, 6)."""
    tumours = prior.transform(prior.draw(PRIOR_SAMPLES, 1, 0))
    tumours = tumours[prior.find_allowed(tumours)]
    chance = np.random.default_rng(0).standard_normal((len(tumours), len(prior.strata.materials)))
    return list_values(prior, tumours, log_tissue_sd * chance)[:, 0]


def summarise(
    prior: TumourPrior, sample: Sample, log_tissue: Floats | float = 0.0, log_tissue_sd: Floats | float = 0.0
) -> tuple[dict[str, Summary], ...]:
    """Return the summaries of all quantities of each tumour of a sample, by ``SUMMARY_NAMES``.

    Parameters
    ----------
    prior
        Of the tumours.
    sample
        Of the posterior.
    log_tissue
        Ln of each layer's modulus over the middle of its range for each set of the sample, shape (n, l); 0 where it is known.
    log_tissue_sd
        Their standard deviations before the readings, shape (l,).
    """
    values, weights = list_values(prior, prior.transform(sample.points), log_tissue), sample.weights
    prior_sd = _scale(draw_prior_values(prior, log_tissue_sd)).std(axis=0)
    scaled = _scale(values)
    mean = np.einsum("n,nmq->mq", weights, scaled)
    sd = np.sqrt(np.einsum("n,nmq->mq", weights, (scaled - mean) ** 2))
    tumours = []
    for number in range(values.shape[1]):
        summaries = {}
        for column, name in enumerate(SUMMARY_NAMES):
            low, lower, median, upper, high = compute_quantiles(
                values[:, number, column], weights, (0.05, 0.25, 0.5, 0.75, 0.95)
            ).tolist()
            relative = float(sd[number, column] / prior_sd[column]) if prior_sd[column] > 1e-12 else None
            is_learnt = relative is not None and relative < LEARNT_SD_RELATIVE
            summaries[name] = Summary(median, (lower, upper), (low, high), relative, is_learnt)
        tumours.append(summaries)
    return tuple(tumours)


def _scale(values: Floats) -> Floats:
    """Return values with the logarithms of depth, diameter and modulus in their place, by which the prior is spread."""
    scaled = values.copy()
    scaled[..., 2:5] = np.log(values[..., 2:5])
    return scaled


@dataclass(frozen=True)
class Region:
    """The smallest region that holds the place of a tumour with a probability (HPD region), in cells.

    Attributes
    ----------
    cells
        Which cells belong to it, shape (columns, rows).
    x_edges, y_edges
        Edges of the cells, m.
    """

    cells: Bools
    x_edges: Floats
    y_edges: Floats

    @property
    def area(self) -> float:
        """Area, m^2."""
        return float(self.cells.sum() * (self.x_edges[1] - self.x_edges[0]) * (self.y_edges[1] - self.y_edges[0]))

    def contains(self, x: float, y: float) -> bool:
        """Return whether a place lies in it."""
        column, row = (int(np.searchsorted(edges, value)) - 1 for edges, value in ((self.x_edges, x), (self.y_edges, y)))
        columns, rows = self.cells.shape
        return 0 <= column < columns and 0 <= row < rows and bool(self.cells[column, row])


def find_places(x: Floats, y: Floats) -> list[tuple[float, float]]:
    """Return the medians of the separate parts of the region of equally probable places (n,), m, the most probable first.

    A line of readings does not tell its two sides apart: the median of both is then no place.
    """
    region = _build_region(np.stack([x, y]), np.ones(len(x)), 0.9)
    labels, count = label(region.cells)
    columns = np.clip(np.searchsorted(region.x_edges, x) - 1, 0, len(labels) - 1)
    rows = np.clip(np.searchsorted(region.y_edges, y) - 1, 0, labels.shape[1] - 1)
    parts = [labels[columns, rows] == number for number in range(1, count + 1)]
    kept = sorted((part for part in parts if part.mean() >= MIN_PART), key=np.sum, reverse=True)
    if len(kept) < 2:
        return [(float(np.median(x)), float(np.median(y)))]
    return [(float(np.median(x[part])), float(np.median(y[part]))) for part in kept]


def find_region(prior: TumourPrior, points: Floats, weights: Floats, probability: float = 0.9) -> Region:
    """Return the smallest region that holds the place of a tumour with a probability.

    Parameters
    ----------
    prior
        Turns points into tumours.
    points, weights
        Of one tumour, shapes (n, d) and (n,).
    probability
        Of the place to lie within the region.
    """
    return _build_region(prior.transform(points)[:, :2].T, weights, probability)


def _build_region(places: Floats, weights: Floats, probability: float) -> Region:
    """Return the smallest region that holds weighted places (2, n), m, with a probability."""
    halves = (slice(0, None, 2), slice(1, None, 2))
    edges = [_build_edges(coordinates) for coordinates in places]
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    columns, rows = (np.searchsorted(lines, values) - 1 for lines, values in zip(edges, places, strict=True))
    cells = np.ravel_multi_index((columns, rows), shape, mode="clip")
    densities = []
    for half in halves:
        density = np.bincount(cells[half], weights[half], shape[0] * shape[1]).reshape(shape)
        densities.append(gaussian_filter(density, REGION_SMOOTHING_CELLS, mode="constant") / weights[half].sum())
    # each half of the sample is counted by the density of the other: cells that are dense by chance would count themselves
    scores = np.empty(len(weights))
    for half, density in zip(halves, densities[::-1], strict=True):
        scores[half] = density.ravel()[cells[half]]
    order = np.argsort(scores)[::-1]
    last = min(int(np.searchsorted(np.cumsum(weights[order]), probability * weights.sum())), len(order) - 1)
    return Region((densities[0] + densities[1]) / 2 >= scores[order[last]], edges[0], edges[1])


def _build_edges(coordinates: Floats) -> Floats:
    """Return the edges of cells about some coordinates, m."""
    low, high = float(coordinates.min()), float(coordinates.max())
    cells = int(np.clip((high - low) / REGION_CELL_M, 1, MAX_CELLS))
    half = max((high - low) / 2, REGION_CELL_M / 2)
    middle = (low + high) / 2
    return np.linspace(middle - half, middle + half, cells + 1)


def compute_plan(tumours: Floats, x: Floats, y: Floats) -> Floats:
    """Return the probability that a tumour lies below each point of a plan.

    Parameters
    ----------
    tumours
        Equally probable sets, shape (n, m, 5).
    x, y
        Coordinates of the plan's columns and rows, m.

    Returns
    -------
    Floats
        Probabilities, shape (len(y), len(x)).
    """
    covered = np.zeros((len(y), len(x)))
    for bodies in tumours:
        squared = (x - bodies[:, 0, None, None]) ** 2 + (y[:, None] - bodies[:, 1, None, None]) ** 2
        covered += np.any(squared < (bodies[:, 3, None, None] / 2) ** 2, axis=0)
    return covered / max(len(tumours), 1)


def compute_section(tumours: Floats, x: Floats, depth: Floats, y: float) -> Floats:
    """Return the probability that each point of the section at ``y`` lies in a tumour, shape (len(depth), len(x))."""
    inside = np.zeros((len(depth), len(x)))
    for bodies in tumours:
        squared = (x - bodies[:, 0, None, None]) ** 2 + (depth[:, None] - bodies[:, 2, None, None]) ** 2
        squared = squared + (y - bodies[:, 1, None, None]) ** 2
        inside += np.any(squared < (bodies[:, 3, None, None] / 2) ** 2, axis=0)
    return inside / max(len(tumours), 1)
