"""Evaluate probes for a population: with the closed form in a search, and by finite elements for the verification.

``score`` uses the closed form and the tumours of a search. ``verify`` uses equivalent-inclusion with reflections, and tumours
that were not used in any search. Both evaluate the same detector. Its reference tumours, computed with the closed form, are
others of the population, so that it is never tested on tumours that it knows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from geometry.scenes.scene import Scene
from probe_design.populations.closed_form_scan import ClosedFormScan
from probe_design.populations.control_variate import ControlSignals
from probe_design.populations.design_file import Design
from probe_design.populations.examination import Examination
from probe_design.populations.inclusion_scan import compute_inclusion_readings
from probe_design.populations.judgement import Judgement
from probe_design.populations.population import ScenePopulation

Progress = Callable[[int, int], None]
DETECTOR_TUMOURS = 256  # reference tumours of the detector
EVALUATORS = ("closed-form", "equivalent-inclusion")


def examine(
    scene: Scene, design: Design, *, samples: int | None = None, unseen: bool = False, progress: Progress | None = None
) -> Examination:
    """Compute the readings over a population: by the closed form over the design's draw, or by finite elements over another.

    Both ratio and stiffness are computed, whichever of them the protocol reads.

    Parameters
    ----------
    scene
        The design's scene, perhaps with another probe and load.
    design
        Design with population and protocol.
    samples
        Number of tumours; default: that of the design.
    unseen
        Whether to use finite elements, and tumours that were not used in a search.
    progress
        Called by finite elements with the number of tissues done and the number of all.

    Raises
    ------
    InputError
        The population does not fit the tissue, or the probe would leave it.
    Refusal
        The evaluators cannot model the scene.
    """
    start, population, protocol = (
        perf_counter(),
        ScenePopulation.from_scene(scene, design.population),
        design.protocol.with_both_channels,
    )
    draw = population.draw_tumours(samples, unseen=unseen)
    names = (
        "object",
        *(name for name, value_range in population.ranges.items() if not value_range.is_single and name != "object"),
    )
    first, reflected, control = None, np.arange(len(draw)), None
    if unseen:
        inclusion_results = compute_inclusion_readings(draw, protocol, names, noise=design.noise, progress=progress)
        readings, reflected = inclusion_results.best, inclusion_results.reflected
        first = inclusion_results.first if len(reflected) < len(draw) else None
        control = ControlSignals.from_draw(scene, protocol, population, draw) if len(draw) > 1 else None
    else:
        readings = ClosedFormScan.from_draw(draw, protocol).compute_readings(scene, names)
    known = replace(population, seed=population.seed + 1).draw_tumours(DETECTOR_TUMOURS)
    reference = ClosedFormScan.from_draw(known, protocol).compute_readings(scene).signal
    seconds = perf_counter() - start
    return Examination(population, draw, readings, reference, EVALUATORS[unseen], seconds, reflected, first, control)


def verify(
    scene: Scene, design: Design, *, samples: int | None = None, seed: int = 0, progress: Progress | None = None
) -> Judgement:
    """Verify a scene's probe under its load by equivalent-inclusion with reflections, on tumours not used in a search.

    Parameters
    ----------
    scene
        The design's scene, perhaps with another probe and load.
    design
        Design with population, protocol, noise and statistic.
    samples
        Number of tumours; default: that of the design.
    seed
        Seed of the draws of noise; the design has the seed of the tumours.
    progress
        Called with the number of tissues done and the number of all.

    Raises
    ------
    InputError
        The population does not fit the tissue, or the probe would leave it.
    Refusal
        The evaluators cannot model the scene.
    """
    return examine(scene, design, samples=samples, unseen=True, progress=progress).evaluate_all_channels(design, seed)


def score(scene: Scene, design: Design, *, samples: int | None = None, seed: int = 0) -> Judgement:
    """Evaluate a scene's probe by the closed form on the design's draw; arguments and exceptions as in ``verify``."""
    return examine(scene, design, samples=samples).evaluate(design, seed)
