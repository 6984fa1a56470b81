"""Uncertainty budget of a probe as built: the scatter of its readings, its sources, and the tolerances that it needs.

To first order, with t_j the standard deviation of the uncertain number x_j, y an output, a_j the contribution of x_j to y and
share_j its share of the variance of y:

    sd(y)^2 = sum_j a_j^2,   a_j = t_j dy/dx_j,   share_j = a_j^2 / sd(y)^2.   (TO.4)

Module ``sample_statistics`` estimates how much nonlinearity and interactions add. If number j alone were uncertain, a standard
deviation x of the output would allow it x / |dy/dx_j|. For all of them together, the standard deviations tau_j with
sum_j (tau_j dy/dx_j)^2 = x^2 that minimise the cost sum_j t_j / tau_j (the cost rises as tau_j falls below the workshop's usual
t_j) are

    tau_j = t_j x |a_j|^(-2/3) / (sum_k |a_k|^(2/3))^(1/2).   (TO.5)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, import_extra
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Observable
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import express_by_outer_radius
from probe_design.tolerancing.derivatives import choose_evaluator, compute_derivatives
from probe_design.tolerancing.loaded_check import compute_load_errors
from probe_design.tolerancing.sample_statistics import OUTPUT_NAMES, SampleStatistics, sample_probes
from probe_design.tolerancing.uncertain_numbers import UncertainNumber, list_uncertain_numbers
from solver import evaluator
from solver.closed_form.evaluator import ClosedForm
from solver.contact.evaluator import ContactEvaluator
from solver.planning.load_check import add_load_warning, is_load_linear
from solver.planning.load_limits import build_load_rule
from solver.results.record import Record
from solver.results.result import Result
from solver.results.warnings import select_notes

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

NOMINAL_ACCURACY = 1e-3  # of the finite elements that give the outputs and their derivatives
LOAD_ACCURACY = 0.01  # a load for which linear elasticity is less accurate than this gives a warning
BUDGET_COLUMNS = ("derivative", "contribution", "share")  # of each number and output, in tables
SAMPLE_LIMITS = (64, 65536)  # lowest and highest number of samples
DERIVATIVE_ERROR_FACTOR = 5.0  # error of derivatives over that of the ratio: the bound that DESIGN states for the log-sensitivity


@dataclass(frozen=True)
class BudgetPart:
    """The effect of one uncertain number on one output.

    Attributes
    ----------
    derivative
        dy/dx, per SI unit of the number.
    contribution
        |a_j|, eq. TO.4.
    share
        Share of the output's variance, to first order.
    first, total
        Sobol indices; None without samples.
    first_interval, total_interval
        95 % intervals of the indices.
    """

    derivative: float
    contribution: float
    share: float
    first: float | None = None
    total: float | None = None
    first_interval: tuple[float, float] | None = None
    total_interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class BudgetLine(UncertainNumber):
    """One line of the budget: an uncertain number and its effects.

    Attributes
    ----------
    held
        tau_j of eq. TO.5, SI: the standard deviation needed for the requested one of ln ratio; None if the number is exact or
        has no effect.
    alone
        The standard deviation allowed if all other numbers were exact.
    outputs
        The number's effect on each output, by name.
    """

    held: float | None
    alone: float | None
    outputs: dict[str, BudgetPart]


@dataclass(frozen=True)
class OutputScatter:
    """The scatter of one output between built probes.

    Attributes
    ----------
    sd
        Standard deviation to first order.
    sampled
        ``sd`` times q of eq. TO.2, which includes nonlinearity and interactions; None without samples.
    sampled_error
        Half-width of the 95 % interval of ``sampled``, by the finite number of samples.
    error_estimate
        Bound on the relative error of ``sd``: |q - 1|, the sampling error and that of the derivatives; None without samples, or
        if the evaluator warns that its log-sensitivity is less accurate.
    """

    sd: float
    sampled: float | None
    sampled_error: float | None
    error_estimate: float | None


@dataclass(frozen=True, repr=False)
class ToleranceBudget(Record):
    """An uncertainty budget, SI units.

    Attributes
    ----------
    evaluator
        Name of the evaluator that computed the derivatives.
    seconds
        Wall clock.
    ratio
        Standard deviation of ln ratio to which ``held`` and ``alone`` refer.
    observable
        What readings, and so all ratios here, are the ratio of: "charge" or "stress".
    nominal
        Results of the probe as drawn: ratio and log_sensitivity, of what is read, and stiffness (N/m).
    outputs
        Scatter by output: ``ln_ratio`` over the built areas, as in ``evaluate``; ``ln_ratio_over_drawn_areas``, as
        measured when the built areas are not known; ``ln_stiffness``, of both films together; ``log_sensitivity``, absolute.
    lines
        The budget, the largest share of ln_ratio first.
    samples
        Number of designs evaluated with the closed form.
    warnings
        One line each.
    """

    evaluator: str
    seconds: float
    ratio: float
    observable: Observable
    nominal: dict[str, float | None]
    outputs: dict[str, OutputScatter]
    lines: tuple[BudgetLine, ...]
    samples: int
    warnings: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame of the budget: for each number its kind, standard deviation, and share of ln ratio's variance."""
        dataset = self.to_dataset()
        part = dataset[["kind", "sd", "held", "alone"]]
        effects = {name: dataset[name].sel(output="ln_ratio", drop=True) for name in BUDGET_COLUMNS}
        frame: pd.DataFrame = part.assign(effects).to_dataframe()
        return frame

    def to_dataset(self) -> xr.Dataset:
        """Return derivative, contribution and share by number and output, and each number's standard deviations, for xarray."""
        xarray = import_extra("xarray")
        rows = [[line.outputs[output] for output in OUTPUT_NAMES] for line in self.lines]
        columns = {name: [getattr(line, name) for line in self.lines] for name in ("kind", "sd", "held", "alone")}
        dataset: xr.Dataset = xarray.Dataset(
            {name: ("number", np.array(values, dtype=None if name == "kind" else float)) for name, values in columns.items()}
            | {name: (("number", "output"), [[getattr(part, name) for part in row] for row in rows]) for name in BUDGET_COLUMNS},
            coords={"number": [line.name for line in self.lines], "output": list(OUTPUT_NAMES)},
            attrs=self.collect_numbers() | {"warnings": list(self.warnings)},
        )
        return dataset


def compute_budget(
    scene: Scene, ratio: float = 0.01, *, bench: Bench | None = None, materials: Mapping[str, str] = MappingProxyType({}),
    given: Mapping[str, object] = MappingProxyType({}), samples: int = 1024, seed: int = 0,
) -> ToleranceBudget:  # fmt: skip
    """Compute the uncertainty budget of a scene's probe as built.

    Beyond linear elasticity results and derivatives are those of ``contact``.

    Parameters
    ----------
    scene
        One that ``axisymmetric`` or ``equivalent-inclusion`` can evaluate.
    ratio
        Allowed standard deviation of ln ratio, 0.01 for 1 %.
    bench
        See ``probe_design.tolerancing.uncertain_numbers.list_uncertain_numbers``.
    materials
        Names in the catalogue of the materials of the blocks "inner" and "outer", for the scatter of their moduli.
    given
        Standard deviations by name, see ``list_uncertain_numbers``.
    samples
        A power of 2 from 64 to 65536; see ``sample_probes``.
    seed
        Of the samples.

    Raises
    ------
    InputError
        A number is out of range, or see ``list_uncertain_numbers``.
    Refusal
        No such evaluator takes the scene, ``contact`` does not reach its load, or a film is not under pressure.
    """
    start = perf_counter()
    _check_request(ratio, samples)
    scene = split_heights(express_by_outer_radius(scene))
    variables, evaluator_name = list_uncertain_numbers(scene, bench, materials, given), choose_evaluator(scene)
    rule = build_load_rule(scene)
    is_loaded = not is_load_linear(scene, rule, LOAD_ACCURACY, promise=scene.target is not None)
    if is_loaded:
        evaluator_name = ContactEvaluator.name
        result = ContactEvaluator().evaluate(scene, LOAD_ACCURACY)
    else:
        result = add_load_warning(evaluator(evaluator_name).evaluate(scene, NOMINAL_ACCURACY), scene, LOAD_ACCURACY, rule)
    read = result.reading
    if result.ratio is None or result.ratio <= 0 or read.ratio is None or read.ratio <= 0 or read.error is None:
        raise InputError("load", "ratio", "a scene whose films are both pressed")
    derivatives = compute_derivatives(scene, variables, NOMINAL_ACCURACY, result if is_loaded else None)
    contributions = derivatives * [item.sd for item in variables]
    refusal = ClosedForm().refusal(scene)
    statistics = sample_probes(scene, variables, samples, seed) if refusal is None else None
    notes = tuple(str(item) for item in result.warnings)
    if statistics is None:
        reason = f"closed-form takes {refusal}" if refusal else "the closed form has no result for some built probes"
        notes = (*notes, f"no samples: {reason}")
    load_errors: Floats | None = np.zeros(len(OUTPUT_NAMES))
    if is_loaded and statistics is not None:
        load_errors = compute_load_errors(scene, variables, contributions, statistics, result, accuracy=LOAD_ACCURACY)
        if load_errors is None:
            text = "the error of the scatter is null: contact does not reach this load with a probe one sd of ln ratio off"
            notes = (*notes, text)
    return ToleranceBudget(
        evaluator=evaluator_name,
        seconds=perf_counter() - start,
        ratio=ratio,
        observable=scene.observable,
        nominal={"ratio": read.ratio, "stiffness": result.stiffness, "log_sensitivity": read.log_sensitivity},
        outputs=_build_scatter(contributions, statistics, result, load_errors),
        lines=_build_lines(variables, derivatives, statistics, ratio),
        samples=0 if statistics is None else statistics.designs,
        warnings=notes,
    )


def split_heights(scene: Scene) -> Scene:
    """Return the scene with separate heights of the blocks, which are made separately; unchanged with an elastic base."""
    height = scene.probe.height
    if height is None or not scene.probe.base.rigid:
        return scene
    probe = scene.probe.model_dump(exclude_unset=True, exclude={"height"}) | {"inner_height": height, "outer_height": height}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe})


def allocate_tolerances(sds: Floats, contributions: Floats, allowed: float) -> Floats:
    """Return the standard deviations tau of minimum cost, eq. TO.5, shape (v,); infinite for numbers without contribution.

    Parameters
    ----------
    sds
        Usual standard deviations t, shape (v,).
    contributions
        a of eq. TO.4, shape (v,).
    allowed
        Standard deviation x of the output.
    """
    is_used = contributions != 0
    magnitude = np.abs(contributions[is_used])
    allocated = np.full(len(sds), np.inf)
    allocated[is_used] = sds[is_used] * allowed * magnitude ** (-2 / 3) / np.sqrt((magnitude ** (2 / 3)).sum())
    return allocated


def _check_request(ratio: float, samples: int) -> None:
    """Raise ``InputError`` for a ratio or a number of samples that is not allowed."""
    if not 0 < ratio < 1:
        raise InputError("ratio", ratio, "a number above 0 and below 1, such as 0.01")
    if not SAMPLE_LIMITS[0] <= samples <= SAMPLE_LIMITS[1] or samples & (samples - 1):  # zero for powers of 2 only
        raise InputError("samples", samples, f"a power of 2 from {SAMPLE_LIMITS[0]} to {SAMPLE_LIMITS[1]}")


def _build_scatter(
    contributions: Floats, statistics: SampleStatistics | None, result: Result, load_errors: Floats | None
) -> dict[str, OutputScatter]:
    """Build the scatter of the outputs that the scene has, by name.

    Parameters
    ----------
    contributions
        a of eq. TO.4, shape (4, v).
    statistics
        Of the samples, or None.
    result
        Of the probe as drawn.
    load_errors
        What the load may change of ``statistics``, relative, shape (4,); None where it is unknown.
    """
    scatters, model_error = {}, DERIVATIVE_ERROR_FACTOR * (result.reading.error or 0.0)
    is_vague = bool(select_notes(result.warnings, "sensitivity"))
    for k, name in enumerate(OUTPUT_NAMES):
        if name == "log_sensitivity" and result.reading.log_sensitivity is None:
            continue
        sd = float(np.sqrt((contributions[k] ** 2).sum()))
        if statistics is None or statistics.sd[k] == 0:
            scatters[name] = OutputScatter(sd, None, None, None)
            continue
        factor = float(statistics.curvature_factor[k])
        error = factor * float(statistics.sd_error[k] / statistics.sd[k])
        bound = None
        # a log-sensitivity beyond the requested accuracy has such derivatives, too
        if load_errors is not None and not (is_vague and name == "log_sensitivity"):
            bound = abs(factor - 1) + error + model_error + float(load_errors[k])
        scatters[name] = OutputScatter(sd, sd * factor, sd * error, bound)
    return scatters


def _build_lines(
    variables: tuple[UncertainNumber, ...], derivatives: Floats, statistics: SampleStatistics | None, ratio: float
) -> tuple[BudgetLine, ...]:
    """Build the lines of the budget, the largest contribution to ln ratio first.

    ``derivatives`` are those of the outputs, shape (4, v); ``ratio`` is the allowed standard deviation of ln ratio.
    """
    sds = np.array([variable.sd for variable in variables])
    contributions = derivatives * sds
    variances = (contributions**2).sum(axis=1)
    allocated = allocate_tolerances(sds, contributions[0], ratio)
    lines = []
    for j, variable in enumerate(variables):
        parts = {
            name: BudgetPart(
                derivative=float(derivatives[k, j]),
                contribution=abs(float(contributions[k, j])),
                share=float(contributions[k, j] ** 2 / variances[k]) if variances[k] else 0.0,
                **({} if statistics is None else statistics.get_indices(k, j)),
            )
            for k, name in enumerate(OUTPUT_NAMES)
        }
        held = float(allocated[j]) if contributions[0, j] else None
        alone = float(ratio / abs(derivatives[0, j])) if derivatives[0, j] else None
        lines.append(BudgetLine(**vars(variable), held=held, alone=alone, outputs=parts))
    return tuple(sorted(lines, key=lambda line: -line.outputs[OUTPUT_NAMES[0]].contribution))
