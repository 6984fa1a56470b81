"""An estimate: what readings say about one unknown, as numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from probe_design.estimation.intervals import Piece
from probe_design.estimation.strength import Interval
from solver.results.notebook import Notebook
from solver.results.result import Decision

WIDEST = {"youngs_modulus": 100.0, "diameter": 4.0, "depth": 4.0, "thickness": 4.0}
OPEN: Interval = (None, None)


@dataclass(frozen=True)
class Estimate(Notebook):
    """What readings say, SI units; an end of an interval is None where it is open.

    Attributes:
        unknown: youngs_modulus, diameter or depth of the target, or the key of a number of the tissue.
        noise: relative standard deviation of each ratio that was read.
        value: of the unknown; None where it is not identifiable.
        interval: 95 %.
        interval_of_noise: the same for a model without error, all nuisances being known.
        nuisances: what is known roughly of the scene: relative standard deviations by its keys.
        interval_if_known: what the interval would be if the nuisances were known; None without any.
        pieces: the values that the readings leave, where they are not all of the interval.
        identifiable: see above.
        reason: why not, or None.
        depth: fitted together with the strength if there are several places, else the scene's, or the estimate.
        depth_interval: 95 %; None where the depth is the scene's.
        strength: eq. ES.1 of ``probe_design.estimation.strength``, m^3.
        strength_interval: 95 %; None where size, modulus and so the strength are the scene's.
        p_value: how probable a worse fit is if scene and noise are right.
        error_estimate: bound on the relative error of the evaluator's ratio at the best fit; None where there is none.
        evaluator, seconds, plan, warnings: see ``solver.results.result.Result``.
    """

    unknown: str
    noise: tuple[float, ...]
    value: float | None
    interval: Interval
    interval_of_noise: Interval
    nuisances: dict[str, float]
    interval_if_known: Interval | None
    pieces: tuple[tuple[float, float], ...]
    identifiable: bool
    reason: str | None
    depth: float | None
    depth_interval: Interval | None
    strength: float | None
    strength_interval: Interval | None
    p_value: float | None
    error_estimate: float | None
    evaluator: str
    seconds: float
    plan: tuple[Decision, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design estimate``."""
        fields = asdict(self)
        return {self.unknown: fields.pop("value")} | fields


def identifiable(interval: Interval, unknown: str) -> bool:
    """Whether an interval is bounded and narrow enough to call the unknown told."""
    low, high = interval
    return low is not None and high is not None and high <= widest(unknown) * low


def widest(unknown: str) -> float:
    """Return by which factor the ends of an unknown's interval may be apart for it to be told."""
    return WIDEST[unknown.rpartition(".")[2]]


def hull(pieces: tuple[Piece, ...]) -> Interval:
    """Return the ends of all pieces together, None where they are open or where there are none."""
    if not pieces:
        return OPEN
    return None if pieces[0].low_open else pieces[0].low, None if pieces[-1].high_open else pieces[-1].high


def several(pieces: tuple[Piece, ...]) -> tuple[tuple[float, float], ...]:
    """Return the ends of the pieces where they are more than one."""
    return tuple((piece.low, piece.high) for piece in pieces) if len(pieces) > 1 else ()
