"""Build the tables of readings that the inference looks up."""

from __future__ import annotations

from collections.abc import Sequence

from geometry.scenes.scene import Scene
from probe_design.locating.prior import ForwardModel, TumourPrior
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.tumour_ranges import TumourRanges


def build_models(prior: TumourPrior, scenes: Sequence[Scene]) -> tuple[ForwardModel, ...]:
    """Return the table of each scene, a load on the tissue, over the tumours of a prior, from the cache where built before.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene or its load, or the population does not fit the tissue.
    """
    depth, diameter, modulus = ((min(part.values), max(part.values)) for part in prior.ranges[2:])
    ranges = TumourRanges(depth, diameter, modulus, prior.poisson_ratio, prior.least_cover)
    return tuple(read_or_build_table(scene, ranges) for scene in scenes)
