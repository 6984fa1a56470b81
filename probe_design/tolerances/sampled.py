"""Scatter and Sobol indices beyond first order, from samples of built probes with the closed form.

Samples and derivatives come from the same model, so that their quotient q measures what nonlinearity and interactions add. With
y an output, x the uncertain numbers as functions of standard normal variables eta (eq. TO.1):

    q = sd(y(x(eta))) / (sum_j (dy/d eta_j)^2)^(1/2),   dy/d eta_j by complex steps.   (TO.2)
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, qmc, sobol_indices, t

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.tolerances.variables import GAINS, Toleranced
from solver.closed_form.designs import PROBE, forces, parameters

OUTPUTS = ("ln_ratio", "ln_ratio_over_drawn_areas", "ln_stiffness", "log_sensitivity")
PARAMETERS = {  # parameters of the closed form that each uncertain number changes
    "probe.inner_radius": ("inner_radius",), "probe.gap": ("gap",), "probe.outer_radius": ("outer_radius",),
    "probe.height": ("inner_height", "outer_height"), "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",), "probe.inner.youngs_modulus": ("inner_modulus",),
    "probe.inner.poisson_ratio": ("inner_poisson",), "probe.outer.youngs_modulus": ("outer_modulus",),
    "probe.outer.poisson_ratio": ("outer_poisson",),
}  # fmt: skip
LEVEL = 0.95  # of all intervals
RESAMPLED = 300  # for the intervals of indices
EACH = 128  # points: a shorter Sobol sequence samples ten dimensions poorly
REPEATS = 8  # scrambled sequences, whose differences give the error of a standard deviation
STEP = 1e-30  # complex: exact to rounding


@dataclass(frozen=True)
class Sampled:
    """Statistics of the four ``OUTPUT_NAMES`` over samples of built probes; v variables.

    Attributes:
        derivatives: dy/d eta of the closed form, shape (4, v).
        sd: standard deviations of the outputs, shape (4,).
        sd_error: half-widths of their 95 % intervals, shape (4,).
        first, total: Sobol indices, shape (4, v).
        first_interval, total_interval: 95 % bootstrap intervals, shape (4, v, 2).
        designs: number of designs evaluated.
    """

    slopes: Floats
    sd: Floats
    sd_error: Floats
    first: Floats
    total: Floats
    first_interval: Floats
    total_interval: Floats
    designs: int

    @property
    def bend(self) -> Floats:
        """The q of eq. TO.2, shape (4,); 1 for an output that no variable affects."""
        line = np.sqrt((self.slopes**2).sum(axis=1))
        return np.asarray(np.divide(self.sd, line, out=np.ones_like(line), where=line > 0), dtype=float)


def sampled(scene: Scene, variables: Sequence[Toleranced], samples: int, seed: int) -> Sampled | None:
    """Sample built probes with the closed form; return None if it has no finite result for some of them.

    Args:
        scene: given by its outer radius; one that ``closed-form`` can evaluate.
        variables: the v uncertain numbers.
        samples: n, a power of 2. Indices use n (v + 2) designs, standard deviations max(n, 1024).
        seed: of the scrambled Sobol sequences.
    """
    outputs, d = _outputs(scene, variables), len(variables)
    slopes = outputs(1j * STEP * np.eye(d)).imag / STEP
    each = max(samples // REPEATS, EACH)
    draws = [norm.ppf(qmc.Sobol(d, rng=[seed, k]).random(each)).T for k in range(REPEATS)]
    parts = [outputs(draw) for draw in draws]
    if not all(np.isfinite(part).all() for part in parts) or not np.isfinite(slopes).all():
        return None
    sds = np.array([part.std(axis=1, ddof=1) for part in parts])
    half = t.ppf((1 + LEVEL) / 2, REPEATS - 1) * sds.std(axis=0, ddof=1) / np.sqrt(REPEATS)
    first, total, first_interval, total_interval = _indices(outputs, sds.mean(axis=0) > 0, d, samples, seed)
    if not (np.isfinite(first).all() and np.isfinite(total).all()):
        return None
    sd = np.sqrt((sds**2).mean(axis=0))
    return Sampled(slopes, sd, half, first, total, first_interval, total_interval, designs=samples * (d + 2) + REPEATS * each)


def _indices(
    outputs: Callable[[Any], Any], moving: Any, d: int, samples: int, seed: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Compute first-order and total indices (4, d) and their intervals (4, d, 2); 0 for outputs that no variable affects."""
    found = sobol_indices(func=lambda eta: outputs(eta)[moving], n=samples, dists=[norm()] * d, rng=np.random.default_rng(seed))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variable without effect gives NaN: its interval is its index
        ends = found.bootstrap(confidence_level=LEVEL, n_resamples=RESAMPLED)
    parts = []
    for index, one in ((found.first_order, ends.first_order), (found.total_order, ends.total_order)):
        both = np.stack([one.confidence_interval.low, one.confidence_interval.high], axis=-1)
        parts += [_spread(moving, np.asarray(index)), _spread(moving, np.where(np.isfinite(both), both, index[..., None]))]
    return parts[0], parts[2], parts[1], parts[3]


def _spread(moving: Any, part: Floats) -> Floats:
    """Expand rows of the affected outputs to all outputs; 0 for the others."""
    whole = np.zeros((len(OUTPUTS), *part.shape[1:]))
    whole[moving] = part
    return whole


def _outputs(scene: Scene, variables: Sequence[Toleranced]) -> Callable[[Any], Any]:
    """Return the function eta, shape (v, n), real or complex -> the four outputs, shape (4, n)."""
    shape, nominal = parameters(scene)

    def outputs(eta: Any) -> Any:
        columns = np.repeat(nominal[:, None], eta.shape[1], axis=1).astype(eta.dtype)
        gains = np.zeros((2, eta.shape[1]), dtype=eta.dtype)
        for one, row in zip(variables, eta, strict=True):
            if one.kind == "gain":
                gains[GAINS.index(one.name)] = np.log(one.drawn(row))
            for key in PARAMETERS.get(one.name, ()):
                columns[PROBE.index(key)] = one.drawn(row)
        radius, gap = PROBE.index("inner_radius"), PROBE.index("gap")
        columns[gap] = stay_open((columns[gap] - columns[radius] + nominal[radius]) / nominal[gap]) * nominal[gap]
        with np.errstate(all="ignore"):  # designs without a result become NaN
            matrix, slope = forces(shape, columns)
            return _read(matrix, slope, columns, gains)

    return outputs


def stay_open(gap: Any) -> Any:
    """Map relative gaps (gap over drawn gap) to positive ones: g for g >= 1, e^(g - 1) below; any shape, real or complex.

    The hole's radius is independent of the inner block's, eq. TO.6, so that the blocks of some draws would overlap.
    """
    below = np.where(np.real(gap) < 1.0, gap, 1.0)
    return np.where(np.real(gap) < 1.0, np.exp(below - 1.0), gap)


def _read(matrix: Any, slope: Any, columns: Any, gains: Any) -> Any:
    """Compute the four outputs from film forces, shape (n, 2, 2), and logarithms of the gains, shape (2, n)."""
    inner, gap, outer = columns[:3]
    totals, change = matrix.sum(axis=2).T, slope.sum(axis=2).T
    drawn = np.log(totals[0]) - np.log(totals[1]) + gains[0] - gains[1]
    areas = np.log(outer**2 - (inner + gap) ** 2) - 2 * np.log(inner)
    stiffness = np.log((totals * np.exp(gains)).sum(axis=0))
    return np.stack([drawn + areas, drawn, stiffness, change[0] / totals[0] - change[1] / totals[1]])
