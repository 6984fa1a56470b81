"""Estimate gains only from readings that agree with each other and with the bench, or explain why they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.errors import InputError, Words
from geometry.common.percent import format_percent
from hw.common.samples import FILM_NAMES
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, compute_inner_fractions
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from probe_design.built_probe.load_plausibility import describe_remedy
from probe_design.built_probe.swapped_connections import (
    MAX_DEVIATION_SD,
    READ_AGAIN,
    Swap,
    check_films,
    compute_max_fraction_error,
    find_swaps,
)

MIN_P_VALUE = 0.001  # p-value below which the readings contradict each other
CERTAIN_P_VALUE = 1e-9  # p-value below which one wrong reading is more likely than a probe that differs from its drawing
FREE_LOG_RATIO_BOUND = 10.0  # bound on ln(F_inner / F_outer) of a block of which nothing is assumed
TOUCHING_SD = 2.0  # standard deviations of cross-talk and leak from which a pin or ring gives a warning: 1 in 20 good ones
BONDED_FILM_FACTORS = 0.4, 25.0  # of a film's charge over d33 times its force: rigid bonds give 0.55, thin films on tape 20
MAX_LEAK_SD = 8.0  # standard deviations likewise above which the readings contradict each other


def estimate_consistent_gains(
    observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench
) -> tuple[Gains, tuple[str, ...]]:
    """Estimate the gains from readings that agree; return them with warnings on leaks and on blocks that were left out.

    If only the blocks contradict their predictions, the gains follow from pin, ring and force channel, which need no predictions:
    the probe may differ from its drawing, which ``check`` tests.

    Parameters
    ----------
    observations
        One for each reading.
    predictions
        For those on tissue, in their order.
    bench
        Tolerances.

    Raises
    ------
    InputError
        A film is dead or of reversed polarity, readings contradict each other (with the exchange that would explain it), the
        references do not determine the gains, or a gain is far from what the bench states for its channel.
    """
    expected = compute_inner_fractions(predictions.log_ratios, [item.reference for item in observations])
    film_sds = np.sqrt([np.diag(item.covariance) for item in observations])
    check_films(np.array([item.films for item in observations]), expected, film_sds)
    _check_force(observations, bench)
    observations, leak_warnings = _widen_leaks(observations, bench)
    try:
        gains = estimate_gains(observations, predictions, bench)
    except InputError as error:
        _check_swaps(observations, predictions, bench, str(error.value))
        raise
    if gains.p_value >= MIN_P_VALUE:
        return _check_plausible(gains, bench), leak_warnings
    misfit = f"chi-square {gains.chi_square:.3g} for {gains.degrees_of_freedom} degrees of freedom, p = {gains.p_value:.1g}"
    _check_swaps(observations, predictions, bench, misfit)
    odd_references = _find_odd_references(observations, predictions, bench)
    gains_without_blocks = _estimate_without_blocks(observations, predictions, bench)
    is_pin_or_ring_wrong = bool(odd_references) and all(item.on != "tissue" for item in odd_references)
    if gains_without_blocks is None or (is_pin_or_ring_wrong and gains.p_value < CERTAIN_P_VALUE):
        raise _build_contradiction(misfit, odd_references)
    warning = f"{misfit}: the blocks contradict their predictions; gains follow from pin, ring and force alone; run check"
    warning += "".join(f"; without the reading on the {item.name} the others agree" for item in odd_references)
    return gains_without_blocks, (warning, *leak_warnings)


def _check_force(observations: Sequence[Observation], bench: Bench) -> None:
    """Refuse readings whose films' sums are all too large, or all too small, against the force channel.

    As a single faulty film would not change all of them alike, the force channel or a unit is wrong.
    """
    if bench.force is None or any(observation.force is None for observation in observations):
        return
    sums, forces = np.array([(observation.films.sum(), observation.force) for observation in observations], dtype=float).T
    ratios = sums / np.maximum(forces, np.finfo(float).tiny)
    tolerance = MAX_DEVIATION_SD * (np.hypot(bench.channels.gain, bench.force.tolerance) + bench.channels.cross_talk)
    if np.all(ratios > 1 + tolerance) or np.all(ratios < 1 - tolerance):
        median = float(np.median(ratios))
        remedy = f"is the force channel plugged in, its sensitivity right? {describe_remedy(median)}"
        low, high = BONDED_FILM_FACTORS
        if low < median < high:
            remedy += (
                "; bonded films give 0.5 to 20 times d33 times their force: name their bonds in [probe.film], and read charges"
            )
        raise InputError(
            "reading", Words(f"{median:.3g} of the force channel on both films"), f"1 to {format_percent(tolerance)}: {remedy}"
        )


def _widen_leaks(observations: Sequence[Observation], bench: Bench) -> tuple[list[Observation], tuple[str, ...]]:
    """Return the observations, the leak of each pin or ring raised to the fraction in the other film's channel; and warnings.

    A leak is the fraction of a pin's or ring's load that the other block carries. A ``leak`` that the bench states is raised only
    if cross-talk and leak together do not explain the fraction; then a warning reports it.
    """
    widened, warnings, assumed = [], [], []
    for observation in observations:
        reference = observation.reference
        if reference.on == "tissue":
            widened.append(observation)
            continue
        other_film = {"inner": 1, "outer": 0}[reference.on]
        other_fraction = float(abs(observation.films[other_film] / observation.films.sum()))
        expected_sd = float(np.hypot(bench.channels.cross_talk, reference.leak_sd))
        is_touching = TOUCHING_SD * expected_sd < other_fraction < MAX_LEAK_SD * expected_sd
        is_unstated = reference.leak is None
        if is_touching:
            text = f"{format_percent(other_fraction)} of what the {reference.name} shows is in the other film's channel"
            deviation = f"{other_fraction / expected_sd:.2g} standard deviations of cross-talk and leak"
            warnings.append(f"{text}, {deviation}: does it touch both blocks?")
        if is_touching or (is_unstated and reference.leak_sd < other_fraction <= TOUCHING_SD * expected_sd):
            reference = reference.model_copy(update={"leak": other_fraction})
        if is_unstated:
            assumed.append(reference)
        widened.append(replace(observation, reference=reference))
    if assumed:
        names, max_leak = " and ".join(item.name for item in assumed), 100 * max(item.leak_sd for item in assumed)
        warnings.append(
            f"the bench does not state what fraction of their load {names} put on the other block: up to {max_leak:.1g} % (1 sd) "
            "counts in ratio and gains; if it was inspected, write leak = 0.002, say, in the bench: check then detects more"
        )
    return widened, tuple(warnings)


def _estimate_if_agreeing(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench) -> Gains | None:
    """Return the gains if the readings determine them and agree with each other, else None."""
    try:
        gains = estimate_gains(observations, predictions, bench)
    except InputError:
        return None
    return gains if gains.p_value >= MIN_P_VALUE else None


def _check_swaps(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench, misfit: str) -> None:
    """Raise ``InputError`` if exchanged cables or references would explain why readings contradict each other.

    ``misfit`` describes the contradiction in words; the other parameters are those of ``estimate_consistent_gains``.
    """
    references = [item.reference for item in observations]

    def agrees(swap: Swap) -> bool:
        """Return whether the readings agree with each other and with the bench once a swap is undone."""
        gains = _estimate_if_agreeing(_undo_swap(observations, swap), predictions, bench)
        return gains is not None and not _list_strange_gains(gains, bench)

    films, expected = np.array([item.films for item in observations]), compute_inner_fractions(predictions.log_ratios, references)
    swaps = find_swaps(films, expected, compute_max_fraction_error(bench), agrees)
    if swaps:
        names = ", or ".join(item.describe(references) for item in swaps)
        raise InputError("reading", Words(misfit), f"readings that agree; these do if exchanged are: {names}; {READ_AGAIN}")


def _undo_swap(observations: Sequence[Observation], swap: Swap) -> list[Observation]:
    """Return the readings with an exchange undone, in the references' order."""
    reading_by_reference = dict(zip(swap.order, observations, strict=True))
    return [
        replace(
            reading_by_reference[k],
            reference=observation.reference,
            load_factor=observation.load_factor,
            films=swap.restore_channels(reading_by_reference[k].films),
            covariance=swap.restore_channels(reading_by_reference[k].covariance),
        )
        for k, observation in enumerate(observations)
    ]


def _estimate_without_blocks(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench) -> Gains | None:
    """Estimate the gains from pin, ring and force channel, if these agree with each other and with the films' sums on blocks.

    The sum of both films' forces on a block needs no prediction. If it agrees with the force channel, the contradiction comes
    from the probe, and neither from a drifting force channel nor from a film that warms. None is returned if they do not agree,
    or if readings of pin, ring or force channel are missing.
    """
    pin_and_ring = [item for item in observations if item.reference.on != "tissue"]
    if not pin_and_ring or any(item.force is None for item in observations):
        return None
    free_blocks = tuple(replace(block, bound=FREE_LOG_RATIO_BOUND) for block in predictions.blocks)
    gains = _estimate_if_agreeing(pin_and_ring, replace(predictions, blocks=()), bench)
    agreeing_sums = _estimate_if_agreeing(observations, replace(predictions, blocks=free_blocks), bench)
    return None if gains is None or agreeing_sums is None or _list_strange_gains(gains, bench) else gains


def _find_odd_references(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench) -> list[Reference]:
    """Find each reference without whose reading all others agree with each other, with the predictions and with the bench."""
    odd_references, block_index = [], 0  # index of the prediction for the present observation, if it is on tissue
    for k, observation in enumerate(observations):
        blocks = list(predictions.blocks)
        if observation.reference.on == "tissue":
            del blocks[block_index]
            block_index += 1
        remaining = [*observations[:k], *observations[k + 1 :]]
        gains = _estimate_if_agreeing(remaining, replace(predictions, blocks=tuple(blocks)), bench)
        if gains is not None and gains.degrees_of_freedom > 0 and not _list_strange_gains(gains, bench):
            odd_references.append(observation.reference)
    return odd_references


def _build_contradiction(misfit: str, odd_references: Sequence[Reference]) -> InputError:
    """Build the error for readings that contradict each other, with the reference to read again if one is wrong."""
    remedy = "readings that agree with each other and with the predictions; no exchange of cables or references explains these"
    if odd_references:
        names = ", or on the ".join(reference.name for reference in odd_references)
        remedy += f"; without the reading on the {names} the others agree: read it again"
    if not odd_references or any(reference.on != "tissue" for reference in odd_references):
        remedy += "; with a force channel, pin and ring alone calibrate a probe that is not as drawn, and check finds the cause"
    return InputError("reading", Words(misfit), remedy)


def _list_strange_gains(gains: Gains, bench: Bench) -> list[str]:
    """List the gains that differ from nominal by more than the bench allows, as texts; both, if only their mean does.

    If no known load has confirmed the force channel, the gains are compared as if the bench stated its sensitivity correctly.
    """
    scale = gains.force_scale
    values, stated = np.diag(gains.matrix), gains
    if not scale.confirmed:
        values, stated = values / scale.factor, gains.remove_force_scale_error()
    sds = np.hypot(bench.channels.gain, np.sqrt(np.diag(stated.covariance)[[0, 3]]))
    if not gains.absolute:  # the outer gain is the unit
        sds = np.hypot(sds, bench.channels.gain)
    deviations = (values - 1) / sds
    strange = [
        f"{name} {value:.3g}"
        for name, value, deviation in zip(FILM_NAMES, values, deviations, strict=True)
        if abs(deviation) > MAX_DEVIATION_SD
    ]
    if not strange and abs(deviations.sum()) / np.sqrt(2) > MAX_DEVIATION_SD:  # sqrt(2): sd of a sum of two unit deviations
        return ["both alike {:.3g} and {:.3g}".format(*values)]
    return strange


def _check_plausible(gains: Gains, bench: Bench) -> Gains:
    """Return the gains unchanged. Raises ``InputError`` if they differ from nominal by more than the bench allows."""
    strange = _list_strange_gains(gains, bench)
    if not strange:
        return gains
    place = "the force channel's sensitivity" if "alike" in strange[0] else "film, cable, amplifier"
    allowed = f"1 to {format_percent(bench.channels.gain, 6)}, by channels.gain of the bench: look at {place}"
    raise InputError("gain", Words(f"{', '.join(strange)} of nominal"), allowed)
