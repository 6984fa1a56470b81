"""Scatter and Sobol indices beyond first order, from samples of built probes with the closed form.

Ratios are those of the films' charges where the scene reads charges. Samples and derivatives come from the same model, so that
their quotient q measures what nonlinearity and interactions add. With y an output, x the uncertain numbers as functions of
standard normal variables eta (eq. TO.1):

    q = sd(y(x(eta))) / (sum_j (dy/d eta_j)^2)^(1/2),   dy/d eta_j by complex steps.   (TO.2)
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import bootstrap, norm, qmc, sobol_indices, t

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.variables import BLOCK_NAMES, find_film_part
from probe_design.tolerancing.film_numbers import (
    TAPE_COEFFICIENT_PER_K,
    TEMPERATURE_NAME,
    list_shared_moduli,
    list_tape_moduli,
)
from probe_design.tolerancing.uncertain_numbers import GAIN_NAMES, UncertainNumber
from solver.closed_form.designs import PROBE_PARAMETERS, Shape, build_parameters, compute_products
from solver.closed_form.film_membrane import FILM_PARAMETERS
from solver.results.film_charges import reads_film_states

OUTPUT_NAMES = ("ln_ratio", "ln_ratio_over_drawn_areas", "ln_stiffness", "log_sensitivity")
DESIGN_PARAMETERS = {  # parameters of the closed form that each uncertain number changes
    "probe.inner_radius": ("inner_radius",), "probe.gap": ("gap",), "probe.outer_radius": ("outer_radius",),
    "probe.height": ("inner_height", "outer_height"), "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",), "probe.inner.youngs_modulus": ("inner_modulus",),
    "probe.inner.poisson_ratio": ("inner_poisson",), "probe.outer.youngs_modulus": ("outer_modulus",),
    "probe.outer.poisson_ratio": ("outer_poisson",),
}  # fmt: skip
FILM_PARAMETER_NAMES = {
    "thickness": "thickness", "youngs_modulus": "modulus", "poisson_ratio": "poisson", "electrode_inset": "inset",
    "d31": "lateral_charge", "d32": "lateral_charge", "d33": "normal_charge",
}  # fmt: skip
LATERAL_KEYS = (".d31", ".d32")
CONFIDENCE_LEVEL = 0.95  # of all intervals
BOOTSTRAP_RESAMPLES = 300  # for the intervals of indices
MIN_SEQUENCE_LENGTH = 128  # points: a shorter Sobol sequence samples ten dimensions poorly
SOBOL_SEQUENCES = 8  # scrambled sequences, whose differences give the error of a standard deviation
COMPLEX_STEP = 1e-30  # complex: exact to rounding


@dataclass(frozen=True)
class SampleStatistics:
    """Statistics of the four ``OUTPUT_NAMES`` over samples of built probes; v variables.

    Attributes
    ----------
    derivatives
        dy/d eta of the closed form, shape (4, v).
    sd
        Standard deviations of the outputs, shape (4,).
    sd_error
        Half-widths of their 95 % intervals, shape (4,).
    indices
        Sobol indices, ``first`` and ``total``, shape (4, v); their 95 % bootstrap intervals, ``first_interval`` and
        ``total_interval``, shape (4, v, 2).
    designs
        Number of designs evaluated.
    """

    derivatives: Floats
    sd: Floats
    sd_error: Floats
    indices: dict[str, Floats]
    designs: int

    def get_indices(self, output: int, variable: int) -> JsonObject:
        """Return the indices of one output and variable, and their intervals, by name; none where no variable affects it."""
        if self.sd[output] == 0:
            return {}
        values = {name: part[output, variable].tolist() for name, part in self.indices.items()}
        return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}

    @property
    def curvature_factor(self) -> Floats:
        """The q of eq. TO.2: sampled over linear standard deviation of each output, (4,); 1 if no variable affects it."""
        linear_sd = np.sqrt((self.derivatives**2).sum(axis=1))
        return np.asarray(np.divide(self.sd, linear_sd, out=np.ones_like(linear_sd), where=linear_sd > 0), dtype=float)


def sample_probes(scene: Scene, variables: Sequence[UncertainNumber], samples: int, seed: int) -> SampleStatistics | None:
    """Sample built probes with the closed form; return None if it has no finite result for some of them.

    Parameters
    ----------
    scene
        Given by its outer radius; one that ``closed-form`` can evaluate.
    variables
        The v uncertain numbers.
    samples
        n, a power of 2. Indices use n (v + 2) designs, standard deviations max(n, 1024).
    seed
        Of the scrambled Sobol sequences.
    """
    compute_outputs, d = build_output_function(scene, variables), len(variables)
    derivatives = compute_outputs(1j * COMPLEX_STEP * np.eye(d)).imag / COMPLEX_STEP
    sequence_length = max(samples // SOBOL_SEQUENCES, MIN_SEQUENCE_LENGTH)
    draws = [norm.ppf(qmc.Sobol(d, rng=[seed, k]).random(sequence_length)).T for k in range(SOBOL_SEQUENCES)]
    parts = [compute_outputs(draw) for draw in draws]
    if not all(np.isfinite(part).all() for part in parts) or not np.isfinite(derivatives).all():
        return None
    sds = np.array([part.std(axis=1, ddof=1) for part in parts])
    half_widths = t.ppf((1 + CONFIDENCE_LEVEL) / 2, SOBOL_SEQUENCES - 1) * sds.std(axis=0, ddof=1) / np.sqrt(SOBOL_SEQUENCES)
    indices = _compute_indices(compute_outputs, sds.mean(axis=0) > 0, d, samples, seed)
    if not (np.isfinite(indices["first"]).all() and np.isfinite(indices["total"]).all()):
        return None
    sd = np.sqrt((sds**2).mean(axis=0))
    return SampleStatistics(
        derivatives,
        sd,
        half_widths,
        indices,
        designs=samples * (d + 2) + SOBOL_SEQUENCES * sequence_length,
    )


def _compute_indices(
    compute_outputs: Callable[[Any], Any], is_affected: Any, d: int, samples: int, seed: int
) -> dict[str, Floats]:
    """Compute Sobol indices, shape (4, d), and their intervals, shape (4, d, 2), by name.

    Parameters
    ----------
    compute_outputs
        Returns the four outputs, shape (4, n), at eta of shape (d, n).
    is_affected
        Which outputs the variables affect, shape (4,); the others have indices of 0.
    d
        Number of variables.
    samples
        A power of 2.
    seed
        Of the random numbers.
    """
    evaluations: list[Floats] = []

    def record_and_estimate(f_A: Floats, f_B: Floats, f_AB: Floats) -> tuple[Floats, Floats]:
        """Keep the outputs of scipy's samples for the bootstrap, and return the indices."""
        evaluations.extend((f_A, f_B, f_AB))
        return _estimate_indices(f_A, f_B, f_AB)

    sampled = sobol_indices(
        func=lambda eta: compute_outputs(eta)[is_affected],
        n=samples,
        dists=[norm()] * d,  # type: ignore[list-item]  # the stubs want a function of one number
        method=record_and_estimate,
        rng=np.random.default_rng(seed),
    )
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variable without effect gives NaN: its interval is its index
        interval = bootstrap(  # scipy's own for Sobol indices takes no seed
            [np.arange(samples)],
            lambda rows: np.array(_estimate_indices(*(part[..., rows] for part in evaluations))),
            confidence_level=CONFIDENCE_LEVEL,
            n_resamples=BOOTSTRAP_RESAMPLES,
            rng=np.random.default_rng(seed),
        ).confidence_interval
    indices = {}
    for k, (name, index) in enumerate((("first", sampled.first_order), ("total", sampled.total_order))):
        ends = np.stack([np.asarray(interval.low)[k], np.asarray(interval.high)[k]], axis=-1)
        indices[name], indices[f"{name}_interval"] = np.zeros((len(OUTPUT_NAMES), d)), np.zeros((len(OUTPUT_NAMES), d, 2))
        indices[name][is_affected] = index
        indices[f"{name}_interval"][is_affected] = np.where(np.isfinite(ends), ends, index[..., None])
    return indices


def _estimate_indices(f_A: Floats, f_B: Floats, f_AB: Floats) -> tuple[Floats, Floats]:
    """Return first-order and total Sobol indices, shapes (outputs, d).

    ``f_A`` and ``f_B`` are the outputs at two independent samples A and B, shape (outputs, n); ``f_AB`` those at A with one
    variable taken from B, for each of d variables, shape (d, outputs, n). The means of the outputs are zero.

    Source: table 2, (b) and (f), of Saltelli et al., Comput. Phys. Commun. 181 (2010) 259.
    """
    variance = np.var([f_A, f_B], axis=(0, -1))
    first = np.mean(f_B * (f_AB - f_A), axis=-1) / variance
    total = 0.5 * np.mean((f_A - f_AB) ** 2, axis=-1) / variance
    return first.T, total.T


def build_output_function(scene: Scene, variables: Sequence[UncertainNumber]) -> Callable[[Any], Any]:
    """Return the function that computes the four outputs, shape (4, n), at eta of shape (v, n), real or complex."""
    shape, draw_parameters = build_draw_function(scene, variables)
    read = slice(2, 4) if reads_film_states(scene) else slice(0, 2)

    def compute_outputs(eta: Any) -> Any:
        """Return the outputs of n built probes."""
        columns, gains = draw_parameters(eta)
        with np.errstate(all="ignore"):  # designs without a result become NaN
            products, derivatives = compute_products(shape, columns)
            stiffness = (products[:, :2].sum(axis=2).T * np.exp(gains)).sum(axis=0)
            return _compute_readings(products[:, read], derivatives[:, read], stiffness, columns, gains)

    return compute_outputs


def build_draw_function(scene: Scene, variables: Sequence[UncertainNumber]) -> tuple[Shape, Callable[[Any], tuple[Any, Any]]]:
    """Return the closed form's shape and the function that draws built probes at eta of shape (v, n), real or complex.

    It returns the closed form's parameters, shape (parameters, n), and the logarithms of the films' gains, shape (2, n).
    """
    shape, nominal = build_parameters(scene)
    parameters = {variable.name: list_parameters(scene, variable.name, len(nominal)) for variable in variables}

    def draw_parameters(eta: Any) -> tuple[Any, Any]:
        """Return the parameters and gains of n built probes."""
        columns = np.repeat(nominal[:, None], eta.shape[1], axis=1).astype(eta.dtype)
        gains = np.zeros((2, eta.shape[1]), dtype=eta.dtype)
        for variable, row in zip(variables, eta, strict=True):
            drawn = variable.draw(row)
            for index in parameters[variable.name]:
                if variable.kind == "temperature":
                    columns[index] = columns[index] * np.exp(-TAPE_COEFFICIENT_PER_K * drawn)  # eq. TO.7
                elif variable.name.endswith(LATERAL_KEYS):  # the parameter is (d31 + d32) / 2
                    columns[index] = columns[index] + (drawn - variable.value) / 2
                else:
                    columns[index] = columns[index] * (drawn / variable.value)
            if variable.kind == "gain":
                gains[GAIN_NAMES.index(variable.name)] = np.log(drawn)
        radius, gap = PROBE_PARAMETERS.index("inner_radius"), PROBE_PARAMETERS.index("gap")
        # the gap is the hole's radius less the inner block's, both of which vary on their own (eq. TO.6)
        columns[gap] = keep_gap_open((columns[gap] - columns[radius] + nominal[radius]) / nominal[gap]) * nominal[gap]
        return columns, gains

    return shape, draw_parameters


def list_parameters(scene: Scene, name: str, count: int) -> list[int]:
    """List the indices of the closed form's parameters, ``count`` in all, that an uncertain number changes; none for gains."""
    if name == TEMPERATURE_NAME:
        return sorted({index for key in list_tape_moduli(scene) for index in list_parameters(scene, key, count)})
    if shared := list_shared_moduli(scene).get(name, ()):
        return sorted({index for key in shared for index in list_parameters(scene, key, count)})
    part, blocks = find_film_part(scene.probe.film, name)
    if not blocks:
        return [PROBE_PARAMETERS.index(key) for key in DESIGN_PARAMETERS.get(name, ())]
    prefix = "" if part == "film" else f"{part.removeprefix('bond_to_')}_bond_"
    within = FILM_PARAMETERS.index(prefix + FILM_PARAMETER_NAMES[name.rpartition(".")[2]])
    start = count - len(BLOCK_NAMES) * len(FILM_PARAMETERS)  # those of the films are the last
    return [start + BLOCK_NAMES.index(block) * len(FILM_PARAMETERS) + within for block in blocks]


def keep_gap_open(gap: Any) -> Any:
    """Map relative gaps (gap over drawn gap) to positive ones: g for g >= 1, e^(g - 1) below; any shape, real or complex.

    The hole's radius is independent of the inner block's, eq. TO.6, so that the blocks of some draws would overlap.
    """
    closing_gap = np.where(np.real(gap) < 1.0, gap, 1.0)
    return np.where(np.real(gap) < 1.0, np.exp(closing_gap - 1.0), gap)


def _compute_readings(products: Any, derivatives: Any, stiffness: Any, columns: Any, gains: Any) -> Any:
    """Compute the four outputs of n built probes, shape (4, n).

    Parameters
    ----------
    products
        Film forces, or charges, in the base states (one block's base displaced by one unit, the other held), shape (n, 2, 2):
        film, state.
    derivatives
        Of ``products`` with respect to ln E_object.
    stiffness
        Of both films together, each with its gain, shape (n,).
    columns
        Parameters of the designs; inner radius, gap and outer radius are the first three.
    gains
        Logarithms of the films' gains, shape (2, n).
    """
    inner, gap, outer = columns[:3]
    totals, change = products.sum(axis=2).T, derivatives.sum(axis=2).T
    # of one sign each, so that their magnitudes have the same derivatives
    signs = np.sign(np.real(totals))
    ln_read_ratio = np.log(signs[0] * totals[0]) - np.log(signs[1] * totals[1]) + gains[0] - gains[1]
    areas = np.log(outer**2 - (inner + gap) ** 2) - 2 * np.log(inner)
    return np.stack([ln_read_ratio + areas, ln_read_ratio, np.log(stiffness), change[0] / totals[0] - change[1] / totals[1]])
