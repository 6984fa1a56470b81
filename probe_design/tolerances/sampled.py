"""The budget beyond first order: many built probes by the closed form, their scatter and their Sobol indices.

One formula answers for samples and for slopes, so that what curvature and interplay add is told from the same model:

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
PARAMETERS = {
    "probe.inner_radius": ("inner_radius",), "probe.gap": ("gap",), "probe.outer_radius": ("outer_radius",),
    "probe.height": ("inner_height", "outer_height"), "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",), "probe.inner.youngs_modulus": ("inner_modulus",),
    "probe.inner.poisson_ratio": ("inner_poisson",), "probe.outer.youngs_modulus": ("outer_modulus",),
    "probe.outer.poisson_ratio": ("outer_poisson",),
}  # fmt: skip
LEVEL = 0.95  # of intervals
RESAMPLED = 300  # times, for the intervals of indices
EACH = 128  # points of one at least: a shorter sequence is no sample in ten dimensions
REPEATS = 8  # scrambled samples, whose differences tell the error of a standard deviation
STEP = 1e-30  # complex: exact to rounding


@dataclass(frozen=True)
class Sampled:
    """What samples of built probes say of each of ``OUTPUTS``; v variables.

    Attributes:
        slopes: dy/d eta by the closed form, shape (4, v).
        sd: standard deviations of the outputs, shape (4,).
        sd_error: half-widths of their 95 % intervals, shape (4,).
        first, total: Sobol indices, shape (4, v).
        first_interval, total_interval: 95 % by bootstrap, shape (4, v, 2).
        designs: how many were evaluated.
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
        """The q of eq. TO.2, shape (4,); 1 where nothing moves an output."""
        line = np.sqrt((self.slopes**2).sum(axis=1))
        return np.asarray(np.divide(self.sd, line, out=np.ones_like(line), where=line > 0), dtype=float)


def sampled(scene: Scene, variables: Sequence[Toleranced], samples: int, seed: int) -> Sampled | None:
    """Sample built probes, or return None where the formulas break down for some of them.

    Args:
        scene: by its outer radius; of a kind that ``closed-form`` takes.
        variables: v of them.
        samples: n, a power of 2: n (v + 2) designs tell the indices, n or 1024 the standard deviations.
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
    """First-order and total indices, shape (4, d), and their intervals, (4, d, 2); 0 for outputs that nothing moves."""
    found = sobol_indices(func=lambda eta: outputs(eta)[moving], n=samples, dists=[norm()] * d, rng=np.random.default_rng(seed))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what does not move an output there is nothing to resample: its interval is itself
        ends = found.bootstrap(confidence_level=LEVEL, n_resamples=RESAMPLED)
    parts = []
    for index, one in ((found.first_order, ends.first_order), (found.total_order, ends.total_order)):
        both = np.stack([one.confidence_interval.low, one.confidence_interval.high], axis=-1)
        parts += [_spread(moving, np.asarray(index)), _spread(moving, np.where(np.isfinite(both), both, index[..., None]))]
    return parts[0], parts[2], parts[1], parts[3]


def _spread(moving: Any, part: Floats) -> Floats:
    """Rows of the outputs that move, among all; 0 for the others."""
    whole = np.zeros((len(OUTPUTS), *part.shape[1:]))
    whole[moving] = part
    return whole


def _outputs(scene: Scene, variables: Sequence[Toleranced]) -> Callable[[Any], Any]:
    """Return eta, shape (v, n), real or complex -> ``OUTPUTS``, shape (4, n)."""
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
        with np.errstate(all="ignore"):  # designs that the formulas cannot answer are NaN
            matrix, slope = forces(shape, columns)
            return _read(matrix, slope, columns, gains)

    return outputs


def stay_open(gap: Any) -> Any:
    """Return gaps over the drawn one that stay above 0, of any shape, real or complex: g from 1 on, e^(g - 1) below.

    The hole stays where the inner block's radius is off, eq. TO.6, so that the blocks of some draws would overlap.
    """
    below = np.where(np.real(gap) < 1.0, gap, 1.0)
    return np.where(np.real(gap) < 1.0, np.exp(below - 1.0), gap)


def _read(matrix: Any, slope: Any, columns: Any, gains: Any) -> Any:
    """What is read of film forces, shape (n, 2, 2), through gains whose logarithms have shape (2, n)."""
    inner, gap, outer = columns[:3]
    totals, change = matrix.sum(axis=2).T, slope.sum(axis=2).T
    drawn = np.log(totals[0]) - np.log(totals[1]) + gains[0] - gains[1]
    areas = np.log(outer**2 - (inner + gap) ** 2) - 2 * np.log(inner)
    stiffness = np.log((totals * np.exp(gains)).sum(axis=0))
    return np.stack([drawn + areas, drawn, stiffness, change[0] / totals[0] - change[1] / totals[1]])
