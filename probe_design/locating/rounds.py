"""Rounds of adaptive importance sampling: draws of one proposal after the other, each fitted to the rounds before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.common.arrays import Floats
from probe_design.locating.samples import Evaluate, compute_effective_size, compute_log_prior, log_sum_exp

KEPT_ROUNDS = 8  # to which a proposal is fitted: earlier ones were drawn farther from the posterior


class Proposal(Protocol):
    """A density from which importance sampling draws."""

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D)."""
        ...

    def compute_log_density(self, z: Floats) -> Floats:
        """Return ln q at logits (n, D), shape (n,)."""
        ...


@dataclass(frozen=True)
class Round:
    """Draws of a proposal.

    Attributes
    ----------
    proposal
        From which they were drawn.
    z
        Logits, shape (n, D).
    log_target
        Ln of likelihood and prior, shape (n,).
    log_weights
        Ln of likelihood and prior over the proposal, shape (n,).
    """

    proposal: Proposal
    z: Floats
    log_target: Floats
    log_weights: Floats

    @property
    def size(self) -> float:
        """Effective sample size."""
        return compute_effective_size(self.log_weights)


@dataclass(frozen=True)
class Rounds:
    """The last rounds, as one sample of the mixture of their proposals, to fit the next proposal to.

    What one round met and the next one missed keeps its weight (Cornuet and others, Adaptive multiple importance sampling,
    Scandinavian Journal of Statistics 39, 2012). An evidence of this sample would be too low, as proposals lie where earlier
    rounds met large weights: that of the last round by itself has no bias.

    Attributes
    ----------
    parts
        The rounds, at most ``KEPT_ROUNDS``.
    """

    parts: tuple[Round, ...] = ()

    def add(self, part: Round) -> Rounds:
        """Return the rounds with one more."""
        return Rounds((*self.parts, part)[-KEPT_ROUNDS:])

    def join(self) -> tuple[Floats, Floats]:
        """Return the logits of all rounds, (n, D), and ln of likelihood and prior over the mixture of their proposals, (n,)."""
        if len(self.parts) == 1:
            return self.parts[0].z, self.parts[0].log_weights
        z = np.concatenate([part.z for part in self.parts])
        shares = np.log([len(part.z) / len(z) for part in self.parts])
        densities = [part.proposal.compute_log_density(z) for part in self.parts]
        log_target = np.concatenate([part.log_target for part in self.parts])
        return z, log_target - log_sum_exp(np.stack(densities, axis=1) + shares)


def weigh(evaluate: Evaluate, proposal: Proposal, count: int, rng: np.random.Generator) -> Round:
    """Return draws of a proposal with their weights."""
    z = proposal.draw(count, rng)
    log_target = evaluate(z) + compute_log_prior(z)
    return Round(proposal, z, log_target, log_target - proposal.compute_log_density(z))
