"""Find the variable, or the two variables, that would explain a probe's deviation from its prediction.

A variable that deviates by e from the drawing shifts d = ln rho measured - ln rho predicted by (J - G S) e (PC.2): J is its
effect on the probe's ln rho; the calibration, which assumed the drawing, is wrong by -S e, with its derivatives S, and G as in
eq. PC.1. One e is fitted for each variable alone, e = D^T C^-1 d / D^T C^-1 D, D = J - G S (PC.3), where C includes the
tolerances of all others. Then all of them are fitted again with changed designs, since large changes are not linear. If none
explains the deviation, pairs are tried, starting from each variable's own best design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import chdtrc

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BlockPredictions
from probe_design.probe_check.changed_designs import GAIN_NAME, Changes, Fit, fit_changes, predict_chi_square
from probe_design.probe_check.deviation import SIGNIFICANCE_LEVEL, Deviation
from solver.results.evaluator import ProgressCallback, ignore_progress

# difference of chi-squares, 2 standard deviations, below which two explanations cannot be distinguished
INDISTINGUISHABLE_CHI_SQUARE = 4.0
MAX_RELATIVE_SD = 1.0  # standard deviation relative to the value above which a variable is not determined
MAX_FITTED_PAIRS = 6  # pairs that are fitted with changed designs, the best by linear theory


@dataclass(frozen=True)
class Explanation:
    """One variable that may differ from the drawing.

    Attributes
    ----------
    variable
        Key of the scene file, ``reference.youngs_modulus`` (of all blocks) or ``relative gain``.
    change
        Its difference from the drawing, SI; relative for the last two.
    uncertainty
        Standard deviation of ``change``.
    nominal
        As drawn; 1 for the last two.
    chi_square
        Of the remaining deviation.
    p_value
        Of ``chi_square``.
    explains
        Whether the remaining deviation is not significant.
    """

    variable: str
    change: float
    uncertainty: float
    nominal: float
    chi_square: float
    p_value: float
    explains: bool


@dataclass(frozen=True)
class VariablePair:
    """Two variables that may differ together; chi-square and p-value are those of both, also in ``first`` and ``second``."""

    first: Explanation
    second: Explanation
    chi_square: float
    p_value: float
    explains: bool

    @property
    def variables(self) -> tuple[str, str]:
        """Names of both variables."""
        return self.first.variable, self.second.variable


def compute_explanations(deviation: Deviation, predictions: BlockPredictions) -> tuple[tuple[Explanation, ...], tuple[str, ...]]:
    """Fit each variable alone by linear theory.

    Returns
    -------
    tuple
        The explanations by variables that the readings determine, best first, and the names of the other variables.
    """
    derivatives = dict(zip(predictions.variables, predictions.derivatives.T, strict=True))
    derivatives |= {GAIN_NAME: np.ones(len(deviation.logs))}
    nominal = dict(zip(predictions.variables, predictions.nominal.tolist(), strict=True)) | {GAIN_NAME: 1.0}
    fits = [
        _fit_variable(deviation, name, derivative - deviation.get_bias(name), nominal[name])
        for name, derivative in derivatives.items()
    ]
    good = [explanation for explanation in fits if explanation.uncertainty < MAX_RELATIVE_SD * explanation.nominal]
    unresolved = tuple(explanation.variable for explanation in fits if explanation not in good)
    return tuple(sorted(good, key=lambda explanation: explanation.chi_square)), unresolved


def fit_variables(
    scene: Scene,
    bench: Bench,
    deviation: Deviation,
    predictions: BlockPredictions,
    names: Sequence[str],
    *,
    progress: ProgressCallback = ignore_progress,
) -> tuple[Fit, ...]:
    """Fit each of the named variables alone with changed designs, best first; ``progress`` is called with a line at each."""
    fits = []
    for k, name in enumerate(names, 1):
        progress(f"what would explain it: {name}, {k} of {len(names)}")
        fits.append(fit_changes(Changes.from_drawing(scene, bench, predictions, name), deviation))
    return tuple(sorted(fits, key=lambda fit: fit.chi_square))


def fit_pairs(
    deviation: Deviation,
    predictions: BlockPredictions,
    fits: Sequence[Fit],
    *,
    progress: ProgressCallback = ignore_progress,
) -> tuple[VariablePair, ...]:
    """Fit the most promising pairs of variables with changed designs, best first.

    Two variables can always explain two readings, so that there are no pairs for fewer than three blocks.

    Parameters
    ----------
    deviation
        Of all blocks.
    predictions
        For the probe as drawn.
    fits
        Of single variables, from which the pairs start.
    progress
        Called with a line of text at each step.
    """
    if len(deviation.logs) < 3:
        return ()
    starts: dict[frozenset[str], tuple[float, Fit, str]] = {}  # of a pair of names, from the better of both variables' fits
    for first_fit, second_name in product(fits, [name for fit in fits for name in fit.changes.names]):
        pair = frozenset((*first_fit.changes.names, second_name))
        if len(pair) == 2:
            start = predict_chi_square(first_fit, deviation, second_name), first_fit, second_name
            starts[pair] = min(start, starts.get(pair, start), key=lambda entry: entry[0])
    promising = sorted(starts.values(), key=lambda entry: entry[0])[:MAX_FITTED_PAIRS]
    pairs = []
    for k, (_, first_fit, second_name) in enumerate(promising, 1):
        progress(f"which two would: {first_fit.changes.names[0]} and {second_name}, {k} of {len(promising)}")
        pairs.append(_build_pair(fit_changes(first_fit.changes.add_variable(predictions, second_name), deviation), deviation))
    return tuple(sorted(pairs, key=lambda pair: pair.chi_square))


def list_indistinguishable(explained: Sequence[Explanation]) -> tuple[str, ...]:
    """List the variables of the best explanation, the first one given, and of those that the readings do not distinguish."""
    max_chi_square = explained[0].chi_square + INDISTINGUISHABLE_CHI_SQUARE
    return tuple(explanation.variable for explanation in explained if explanation.chi_square < max_chi_square)


def build_explanation(fit: Fit, deviation: Deviation, index: int = 0) -> Explanation:
    """Build the explanation by one of a fit's variables, that of this index."""
    nominal, freedom = float(fit.changes.nominal[index]), len(deviation.logs) - len(fit.changes.names)
    change, uncertainty = float(fit.changes.values[index]) - nominal, float(fit.uncertainties[index])
    return _explain(fit.changes.names[index], change, uncertainty, nominal, chi_square=fit.chi_square, freedom=freedom)


def _build_pair(fit: Fit, deviation: Deviation) -> VariablePair:
    """Build the explanation by both variables of a fit."""
    first, second = (build_explanation(fit, deviation, index) for index in (0, 1))
    return VariablePair(first, second, first.chi_square, first.p_value, first.explains)


def _fit_variable(deviation: Deviation, name: str, shift: Floats, nominal: float) -> Explanation:
    """Fit one variable by eq. PC.3, and compute the remaining chi-square.

    Parameters
    ----------
    deviation
        Of all blocks.
    name, nominal
        The variable and its value as drawn, SI.
    shift
        D of eq. PC.3, the change of the deviation per unit of the variable, shape (k,).
    """
    model, freedom = deviation.build_errors(name).add_unknowns(shift[:, None], np.array([np.inf])), len(deviation.logs) - 1
    change, uncertainty = model.compute_posterior_mean(deviation.difference)[0], model.compute_posterior_sd(np.ones(1))
    chi_square = float(model.compute_chi_square(deviation.difference))
    return _explain(name, float(change), float(uncertainty), nominal, chi_square=chi_square, freedom=freedom)


def _explain(name: str, change: float, uncertainty: float, nominal: float, *, chi_square: float, freedom: int) -> Explanation:
    """Build an explanation; a fit without degrees of freedom explains everything, with the p-value 1."""
    p_value = float(chdtrc(freedom, chi_square)) if freedom > 0 else 1.0
    return Explanation(name, change, uncertainty, nominal, chi_square, p_value, explains=p_value >= SIGNIFICANCE_LEVEL)
