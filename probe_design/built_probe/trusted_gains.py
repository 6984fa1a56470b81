"""Estimate gains only from readings that agree, or explain why they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, compute_inner_shares
from probe_design.built_probe.exchanges import (
    MAX_DEVIATION_SD,
    READ_AGAIN,
    Misplacement,
    check_films,
    compute_share_doubt,
    find_exchanges,
)
from probe_design.built_probe.gain_matrix import Gains, Observation, estimate_gains
from probe_design.built_probe.load_checks import describe_remedy

MIN_P_VALUE = 0.001  # p-value below which the readings contradict each other
FREE_LOG_RATIO_BOUND = 10.0  # bound on ln(F_inner / F_outer) of a block of which nothing is assumed
TOUCHING_SD = (
    2.0  # standard deviations of cross-talk and leak together from which a pin or ring gives a warning: 1 in 20 good ones
)
MAX_LEAK_SD = 8.0  # standard deviations likewise above which the readings contradict each other
CERTAIN_P_VALUE = 1e-9  # p-value below which one wrong reading is more likely than a probe that differs from its drawing


def estimate_trusted_gains(
    observed: Sequence[Observation], shares: BlockPredictions, bench: Bench
) -> tuple[Gains, tuple[str, ...]]:
    """Estimate the gains from readings that agree; return them with notes on the readings that were left out.

    If only the blocks contradict their predictions, the gains follow from pin, ring and force channel, which need no predictions:
    the probe may differ from its drawing, which ``check`` tests.

    Parameters
    ----------
    observed
        One for each reading.
    shares
        Predictions for those that are on tissue, in their order.
    bench
        tolerances.

    Raises
    ------
    InputError
        A film is dead or of reversed polarity, readings contradict each other (with the exchange that would explain it), the
        references do not determine the gains, or a gain is far from what the bench states for its channel.
    """
    films, expected = np.array([item.films for item in observed]), _compute_expected_shares(observed, shares)
    check_films(films, expected, np.sqrt([np.diag(item.covariance) for item in observed]))
    _check_force(observed, bench)
    observed, straying = _loosen_leaks(observed, bench)
    gains, fault = _try_estimate(observed, shares, bench)
    if gains is not None and gains.p_value >= MIN_P_VALUE:
        return _check_plausible(gains, bench), straying
    _check_exchanges(observed, shares, bench, fault or _describe_misfit(gains))
    if gains is None:
        raise fault or AssertionError
    gains_without_blocks, odd_references = (
        _estimate_without_predictions(observed, shares, bench),
        _find_odd_references(observed, shares, bench),
    )
    blames_references = (
        gains.p_value < CERTAIN_P_VALUE and bool(odd_references) and all(item.on != "tissue" for item in odd_references)
    )
    if gains_without_blocks is None or _list_strange_gains(gains_without_blocks, bench) or blames_references:
        raise _build_contradiction(_describe_misfit(gains), odd_references)
    note = (
        f"{_describe_misfit(gains)}: the blocks contradict their predictions; gains follow from pin, ring and force "
        "alone; run check"
    )
    note += "".join(f"; without the reading on the {item.name} the others agree" for item in odd_references)
    return gains_without_blocks, (note, *straying)


def _compute_expected_shares(observed: Sequence[Observation], shares: BlockPredictions) -> Floats:
    """Return the inner film's expected shares of the load, shape (n,)."""
    return compute_inner_shares(shares.log_ratios, [observation.reference for observation in observed])


def _check_force(observed: Sequence[Observation], bench: Bench) -> None:
    """Refuse readings that all differ from the force channel in the same way: a common cause, not a film, is wrong."""
    if bench.force is None or any(observation.force is None for observation in observed):
        return
    films, forces = np.array([(observation.films.sum(), observation.force) for observation in observed], dtype=float).T
    ratios = films / np.maximum(forces, np.finfo(float).tiny)
    doubt = MAX_DEVIATION_SD * (np.hypot(bench.channels.gain, bench.force.tolerance) + bench.channels.cross_talk)
    if np.all(ratios > 1 + doubt) or np.all(ratios < 1 - doubt):
        median = float(np.median(ratios))
        allowed = f"1 to {100 * doubt:.2g} %: is the force channel plugged in, its sensitivity right? {describe_remedy(median)}"
        raise InputError("reading", Words(f"{median:.3g} of the force channel on both films"), allowed)


def _loosen_leaks(observed: Sequence[Observation], bench: Bench) -> tuple[list[Observation], tuple[str, ...]]:
    """Raise the leak of a pin or ring to what the other channel shows; warn if cross-talk and leak do not explain it.

    A ``leak`` stated by the bench is used until a pin or ring shows more than it and cross-talk explain.
    """
    observations, notes = [], []
    for item in observed:
        leak_sd, share = item.reference.leak_sd, _compute_other_channel_share(item)
        allowed = float(np.hypot(bench.channels.cross_talk, leak_sd))
        touches = TOUCHING_SD * allowed < share < MAX_LEAK_SD * allowed
        if touches:
            text = f"{100 * share:.2g} % of what the {item.reference.name} shows is in the other film's channel"
            notes.append(f"{text}, {share / allowed:.2g} standard deviations of cross-talk and leak: does it touch both blocks?")
        if touches or (_has_guessed_leak(item.reference) and leak_sd < share <= TOUCHING_SD * allowed):
            item = replace(item, reference=item.reference.model_copy(update={"leak": share}))
        observations.append(item)
    guessed = [item.reference for item, given in zip(observations, observed, strict=True) if _has_guessed_leak(given.reference)]
    if guessed:
        names, max_leak = " and ".join(item.name for item in guessed), 100 * max(item.leak_sd for item in guessed)
        notes.append(
            f"the bench does not state what fraction of their load {names} put on the other block: up to {max_leak:.1g} % (1 sd) "
            "counts in ratio and gains; if it was inspected, write leak = 0.002, say, in the bench: check then detects more"
        )
    return observations, tuple(notes)


def _has_guessed_leak(reference: Reference) -> bool:
    """Whether a pin's or ring's leak is the default, not one that the bench states."""
    return reference.on != "tissue" and reference.leak is None


def _compute_other_channel_share(observation: Observation) -> float:
    """Return the fraction of a reading on a pin or ring in the channel of the block that it should not touch; 0 on tissue."""
    other_film = {"inner": 1, "outer": 0}.get(observation.reference.on)
    return 0.0 if other_film is None else float(abs(observation.films[other_film] / observation.films.sum()))


def _try_estimate(
    observed: Sequence[Observation], shares: BlockPredictions, bench: Bench
) -> tuple[Gains | None, InputError | None]:
    """Return the gains and None, or None and the error."""
    try:
        return estimate_gains(observed, shares, bench), None
    except InputError as fault:
        return None, fault


def _estimate_agreeing(observed: Sequence[Observation], shares: BlockPredictions, bench: Bench) -> Gains | None:
    """Return the gains if the readings agree with each other and with what the bench states, else None."""
    gains, _ = _try_estimate(observed, shares, bench)
    return None if gains is None or gains.p_value < MIN_P_VALUE or _list_strange_gains(gains, bench) else gains


def _describe_misfit(gains: Gains | None) -> str:
    assert gains is not None
    return f"chi-square {gains.chi_square:.3g} for {gains.freedom} degrees of freedom, p = {gains.p_value:.1g}"


def _check_exchanges(observed: Sequence[Observation], shares: BlockPredictions, bench: Bench, fault: InputError | str) -> None:
    """Raise ``InputError`` if exchanged cables or references explain the readings."""
    references = [item.reference for item in observed]

    def agrees(exchange: Misplacement) -> bool:
        return _estimate_agreeing(_undo_exchange(observed, exchange), shares, bench) is not None

    films = np.array([item.films for item in observed])
    exchanges = find_exchanges(films, _compute_expected_shares(observed, shares), compute_share_doubt(bench), agrees)
    if exchanges:
        names = ", or ".join(item.describe(references) for item in exchanges)
        value = Words(fault if isinstance(fault, str) else fault.value)
        raise InputError("reading", value, f"readings that agree; these do if exchanged are: {names}; {READ_AGAIN}")


def _undo_exchange(observed: Sequence[Observation], exchange: Misplacement) -> list[Observation]:
    """Return the readings with an exchange undone, in the references' order."""
    restore, references = exchange.restore_channels, [reference.reference for reference in observed]
    observation_by_reference = dict(zip(exchange.order, observed, strict=True))
    return [
        replace(
            observation_by_reference[k],
            reference=reference,
            films=restore(observation_by_reference[k].films),
            covariance=restore(observation_by_reference[k].covariance),
        )
        for k, reference in enumerate(references)
    ]


def _estimate_without_predictions(observed: Sequence[Observation], shares: BlockPredictions, bench: Bench) -> Gains | None:
    """Estimate the gains from pin, ring and force channel, if these agree with each other and with the films' sums on blocks.

    The sum needs no prediction: it excludes that a drifting force channel or a warming film is the cause, not the probe.
    """
    pin_and_ring = [item for item in observed if item.reference.on != "tissue"]
    if not pin_and_ring or any(item.force is None for item in observed):
        return None
    free_shares = replace(shares, blocks=tuple(replace(item, bound=FREE_LOG_RATIO_BOUND) for item in shares.blocks))
    fits = [_try_estimate(pin_and_ring, replace(shares, blocks=()), bench)[0], _try_estimate(observed, free_shares, bench)[0]]
    return fits[0] if all(item is not None and item.p_value >= MIN_P_VALUE for item in fits) else None


def _find_odd_references(observed: Sequence[Observation], shares: BlockPredictions, bench: Bench) -> list[Reference]:
    """Find the references each of which, if left out, leaves readings that agree."""
    odd_references, places = [], iter(range(len(shares.blocks)))
    for k, observation in enumerate(observed):
        place = next(places) if observation.reference.on == "tissue" else None
        remaining_blocks = tuple(block for index, block in enumerate(shares.blocks) if index != place)
        gains = _estimate_agreeing([*observed[:k], *observed[k + 1 :]], replace(shares, blocks=remaining_blocks), bench)
        if gains is not None and gains.freedom > 0:
            odd_references.append(observation.reference)
    return odd_references


def _build_contradiction(misfit: str, odd_references: Sequence[Reference]) -> InputError:
    remedy = "readings that agree with each other and with the predictions; no exchange of cables or references explains these"
    if odd_references:
        names = ", or on the ".join(reference.name for reference in odd_references)
        remedy += f"; without the reading on the {names} the others agree: read it again"
    if not odd_references or any(reference.on != "tissue" for reference in odd_references):
        remedy += "; with a force channel, pin and ring alone calibrate a probe that is not as drawn, and check finds the cause"
    return InputError("reading", Words(misfit), remedy)


def _list_strange_gains(gains: Gains, bench: Bench) -> list[str]:
    """List the gains that differ from nominal by more than the bench allows, with the force sensor as stated or confirmed."""
    scale = gains.force_scale
    factor = 1.0 if scale.confirmed else scale.factor
    covariance = gains.covariance if scale.confirmed else gains.covariance - scale.covariance
    spread = np.hypot(bench.channels.gain, np.sqrt(np.diag(covariance)[[0, 3]]))
    if not gains.absolute:  # the outer gain is the unit
        spread = np.hypot(spread, bench.channels.gain)
    pairs = zip(("inner", "outer"), np.diag(gains.matrix) / factor, spread, strict=True)
    strange = [f"{name} {value:.3g}" for name, value, sd in pairs if abs(value - 1) > MAX_DEVIATION_SD * sd]
    together = float(np.sum((np.diag(gains.matrix) / factor - 1) / spread) / np.sqrt(2))
    return strange or (
        ["both alike {:.3g} and {:.3g}".format(*np.diag(gains.matrix) / factor)] if abs(together) > MAX_DEVIATION_SD else []
    )


def _check_plausible(gains: Gains, bench: Bench) -> Gains:
    strange = _list_strange_gains(gains, bench)
    if not strange:
        return gains
    look = "look at the force channel's sensitivity" if "alike" in strange[0] else "look at film, cable, amplifier"
    allowed = f"1 to {100 * bench.channels.gain:g} %, by channels.gain of the bench: {look}"
    raise InputError("gain", Words(f"{', '.join(strange)} of nominal"), allowed)
