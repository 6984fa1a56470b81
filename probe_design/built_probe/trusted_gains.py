"""Estimate gains only from readings that agree, or explain why they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import Shares, inner_shares
from probe_design.built_probe.exchanges import FAR, READ_AGAIN, Misplacement, check_films, explaining, share_doubt
from probe_design.built_probe.gain_matrix import Gains, Observed, estimated
from probe_design.built_probe.load_checks import remedy

UNLIKELY = 0.001  # p-value below which the readings contradict each other
ANYTHING = 10.0  # bound on ln(F_inner / F_outer) of a block of which nothing is assumed
TOUCHES = 2.0  # standard deviations of cross-talk and leak together from which a pin or ring gives a warning: 1 in 20 good ones
MOST_STRAYED = 8.0  # standard deviations likewise above which the readings contradict each other
CERTAIN = 1e-9  # p-value below which one wrong reading is more likely than a probe that differs from its drawing


def trusted(observed: Sequence[Observed], shares: Shares, bench: Bench) -> tuple[Gains, tuple[str, ...]]:
    """Estimate the gains from readings that agree; return them with notes on the readings that were left out.

    If only the blocks contradict their predictions, the gains follow from pin, ring and force channel, which need no predictions:
    the probe may differ from its drawing, which ``check`` tests.

    Args:
        observed: one for each reading.
        shares: predictions for those that are on tissue, in their order.
        bench: tolerances.

    Raises:
        InputError: a film is dead or of reversed polarity, readings contradict each other (with the exchange that would explain
            it), the references do not determine the gains, or a gain is far from what the bench states for its channel.
    """
    films, expected = np.array([one.films for one in observed]), _expected(observed, shares)
    check_films(films, expected, np.sqrt([np.diag(one.covariance) for one in observed]))
    _check_force(observed, bench)
    observed, straying = _loosened(observed, bench)
    gains, fault = _attempt(observed, shares, bench)
    if gains is not None and gains.p_value >= UNLIKELY:
        return _plausible(gains, bench), straying
    _check_exchanges(observed, shares, bench, fault or _misfit(gains))
    if gains is None:
        raise fault or AssertionError
    alone, odd = _without_predictions(observed, shares, bench), _odd_ones(observed, shares, bench)
    blamed = gains.p_value < CERTAIN and bool(odd) and all(one.on != "tissue" for one in odd)
    if alone is None or _strange(alone, bench) or blamed:
        raise _contradiction(_misfit(gains), odd)
    note = f"{_misfit(gains)}: the blocks contradict their predictions; gains follow from pin, ring and force alone; run check"
    note += "".join(f"; without the reading on the {one.name} the others agree" for one in odd)
    return alone, (note, *straying)


def _expected(observed: Sequence[Observed], shares: Shares) -> Floats:
    """Return the inner film's expected shares of the load, shape (n,)."""
    return inner_shares(shares.log_ratios, [one.reference for one in observed])


def _check_force(observed: Sequence[Observed], bench: Bench) -> None:
    """Refuse readings that all differ from the force channel in the same way: a common cause, not a film, is wrong."""
    if bench.force is None or any(one.force is None for one in observed):
        return
    films, forces = np.array([(one.films.sum(), one.force) for one in observed], dtype=float).T
    ratios = films / np.maximum(forces, np.finfo(float).tiny)
    doubt = FAR * (np.hypot(bench.channels.gain, bench.force.tolerance) + bench.channels.cross_talk)
    if np.all(ratios > 1 + doubt) or np.all(ratios < 1 - doubt):
        middle = float(np.median(ratios))
        allowed = f"1 to {100 * doubt:.2g} %: is the force channel plugged in, its sensitivity right? {remedy(middle)}"
        raise InputError("reading", Words(f"{middle:.3g} of the force channel on both films"), allowed)


def _loosened(observed: Sequence[Observed], bench: Bench) -> tuple[list[Observed], tuple[str, ...]]:
    """Raise the leak of a pin or ring to what the other channel shows; warn if cross-talk and leak do not explain it.

    A ``leak`` stated by the bench is used until a pin or ring shows more than it and cross-talk explain.
    """
    found, notes = [], []
    for one in observed:
        strays, share = one.reference.strays, _in_other_channel(one)
        allowed = float(np.hypot(bench.channels.cross_talk, strays))
        touches = TOUCHES * allowed < share < MOST_STRAYED * allowed
        if touches:
            text = f"{100 * share:.2g} % of what the {one.reference.name} shows is in the other film's channel"
            notes.append(f"{text}, {share / allowed:.2g} standard deviations of cross-talk and leak: does it touch both blocks?")
        if touches or (_is_guessed(one.reference) and strays < share <= TOUCHES * allowed):
            one = replace(one, reference=one.reference.model_copy(update={"leak": share}))
        found.append(one)
    guessed = [one.reference for one, given in zip(found, observed, strict=True) if _is_guessed(given.reference)]
    if guessed:
        names, most = " and ".join(one.name for one in guessed), 100 * max(one.strays for one in guessed)
        notes.append(
            f"the bench does not state what fraction of their load {names} put on the other block: up to {most:.1g} % (1 sd) "
            "counts in ratio and gains; if it was inspected, write leak = 0.002, say, in the bench: check then detects more"
        )
    return found, tuple(notes)


def _is_guessed(reference: Reference) -> bool:
    """Whether a pin's or ring's leak is the default, not one that the bench states."""
    return reference.on != "tissue" and reference.leak is None


def _in_other_channel(one: Observed) -> float:
    """Return the fraction of a reading on a pin or ring in the channel of the block that it should not touch; 0 on tissue."""
    other = {"inner": 1, "outer": 0}.get(one.reference.on)
    return 0.0 if other is None else float(abs(one.films[other] / one.films.sum()))


def _attempt(observed: Sequence[Observed], shares: Shares, bench: Bench) -> tuple[Gains | None, InputError | None]:
    """Return the gains and None, or None and the error."""
    try:
        return estimated(observed, shares, bench), None
    except InputError as fault:
        return None, fault


def _misfit(gains: Gains | None) -> str:
    assert gains is not None
    return f"chi-square {gains.chi_square:.3g} for {gains.freedom} degrees of freedom, p = {gains.p_value:.1g}"


def _check_exchanges(observed: Sequence[Observed], shares: Shares, bench: Bench, fault: InputError | str) -> None:
    """Raise ``InputError`` if exchanged cables or references explain the readings."""
    references = [one.reference for one in observed]

    def agrees(exchange: Misplacement) -> bool:
        gains, _ = _attempt(_undone(observed, exchange), shares, bench)
        return gains is not None and gains.p_value >= UNLIKELY and not _strange(gains, bench)

    films = np.array([one.films for one in observed])
    found = explaining(films, _expected(observed, shares), share_doubt(bench), agrees)
    if found:
        names = ", or ".join(one.told(references) for one in found)
        value = Words(fault if isinstance(fault, str) else fault.value)
        raise InputError("reading", value, f"readings that agree; these do if exchanged are: {names}; {READ_AGAIN}")


def _undone(observed: Sequence[Observed], exchange: Misplacement) -> list[Observed]:
    """Return the readings with an exchange undone, in the references' order."""
    right, references = exchange.mended, [one.reference for one in observed]
    at = dict(zip(exchange.order, observed, strict=True))
    return [
        replace(at[k], reference=one, films=right(at[k].films), covariance=right(at[k].covariance))
        for k, one in enumerate(references)
    ]


def _without_predictions(observed: Sequence[Observed], shares: Shares, bench: Bench) -> Gains | None:
    """Estimate the gains from pin, ring and force channel, if these agree with each other and with the films' sums on blocks.

    The sum needs no prediction: it excludes that a drifting force channel or a warming film is the cause, not the probe.
    """
    alone = [one for one in observed if one.reference.on != "tissue"]
    if not alone or any(one.force is None for one in observed):
        return None
    anything = replace(shares, blocks=tuple(replace(one, bound=ANYTHING) for one in shares.blocks))
    fits = [_attempt(alone, replace(shares, blocks=()), bench)[0], _attempt(observed, anything, bench)[0]]
    return fits[0] if all(one is not None and one.p_value >= UNLIKELY for one in fits) else None


def _odd_ones(observed: Sequence[Observed], shares: Shares, bench: Bench) -> list[Reference]:
    """Find the references each of which, if left out, leaves readings that agree."""
    found, places = [], iter(range(len(shares.blocks)))
    for k, one in enumerate(observed):
        place = next(places) if one.reference.on == "tissue" else None
        kept = tuple(block for at, block in enumerate(shares.blocks) if at != place)
        gains, _ = _attempt([*observed[:k], *observed[k + 1 :]], replace(shares, blocks=kept), bench)
        if gains is not None and gains.freedom > 0 and gains.p_value >= UNLIKELY and not _strange(gains, bench):
            found.append(one.reference)
    return found


def _contradiction(misfit: str, odd: Sequence[Reference]) -> InputError:
    remedy = "readings that agree with each other and with the predictions; no exchange of cables or references explains these"
    if odd:
        names = ", or on the ".join(one.name for one in odd)
        remedy += f"; without the reading on the {names} the others agree: read it again"
    if not odd or any(one.on != "tissue" for one in odd):
        remedy += "; with a force channel, pin and ring alone calibrate a probe that is not as drawn, and check finds the cause"
    return InputError("reading", Words(misfit), remedy)


def _strange(gains: Gains, bench: Bench) -> list[str]:
    """List the gains that differ from nominal by more than the bench allows, with the force sensor as stated or confirmed."""
    scale = gains.force_scale
    factor = 1.0 if scale.confirmed else scale.factor
    covariance = gains.covariance if scale.confirmed else gains.covariance - scale.covariance
    spread = np.hypot(bench.channels.gain, np.sqrt(np.diag(covariance)[[0, 3]]))
    if not gains.absolute:  # the outer gain is the unit
        spread = np.hypot(spread, bench.channels.gain)
    pairs = zip(("inner", "outer"), np.diag(gains.matrix) / factor, spread, strict=True)
    found = [f"{name} {value:.3g}" for name, value, sd in pairs if abs(value - 1) > FAR * sd]
    together = float(np.sum((np.diag(gains.matrix) / factor - 1) / spread) / np.sqrt(2))
    return found or (["both alike {:.3g} and {:.3g}".format(*np.diag(gains.matrix) / factor)] if abs(together) > FAR else [])


def _plausible(gains: Gains, bench: Bench) -> Gains:
    strange = _strange(gains, bench)
    if not strange:
        return gains
    look = "look at the force channel's sensitivity" if "alike" in strange[0] else "look at film, cable, amplifier"
    allowed = f"1 to {100 * bench.channels.gain:g} %, by channels.gain of the bench: {look}"
    raise InputError("gain", Words(f"{', '.join(strange)} of nominal"), allowed)
