"""Build the tables of readings that the inference looks up."""

from __future__ import annotations

from collections.abc import Sequence

from geometry.common.errors import InputError, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from probe_design.locating.prior import ForwardModel, TumourPrior
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.tumour_ranges import MIN_COVER_PER_DIAMETER, TumourRanges


def build_models(prior: TumourPrior, scenes: Sequence[Scene]) -> tuple[ForwardModel, ...]:
    """Return the table of each scene, a load on the tissue, over the tumours of a prior, from the cache where built before.

    Raises
    ------
    InputError
        Tumours of the population lie in two layers.
    Refusal
        The evaluator cannot model the scene or its load, or the population does not fit the tissue.
    """
    depth, diameter, modulus = ((min(part.values), max(part.values)) for part in prior.ranges[2:])
    # the population's cover is counted from the surface, the table's from the interface above the tumours
    ceiling = max((face for face in prior.scene.tissue.interfaces if face <= depth[1]), default=0.0)
    cover = max(prior.least_cover - ceiling, 0.0)
    highest = ceiling - (0.5 + MIN_COVER_PER_DIAMETER) * diameter[0]  # of the smallest tumour in the layers above
    if max(depth[0], diameter[0] / 2 + max(prior.least_cover, MIN_COVER_PER_DIAMETER * diameter[0])) <= highest:
        deepest = ceiling - (0.5 + MIN_COVER_PER_DIAMETER) * diameter[1]  # that the largest may lie at
        lowest = ceiling + (0.5 + MIN_COVER_PER_DIAMETER) * diameter[0]
        allowed = (
            f"depths within one layer, as tumours above and below the interface at {format_mm(ceiling)} are not predicted "
            f"together: up to {format_mm(deepest)}, or from {format_mm(lowest)} on"
        )
        raise InputError("population.depth", Words(f"{format_mm(depth[0])} to {format_mm(depth[1])}"), allowed)
    ranges = TumourRanges(depth, diameter, modulus, prior.poisson_ratio, cover)
    return tuple(read_or_build_table(scene, ranges) for scene in scenes)
