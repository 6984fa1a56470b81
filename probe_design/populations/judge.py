"""Probes judged for a population: by formulas for a search, and verified by finite elements on tumours that no search has seen.

``score`` asks the formulas, for a search, of the tumours that it has drawn; ``verify`` asks equivalent-inclusion with
reflections, of tumours that no search has seen. Both judge the same detector: it knows other tumours of the population by the
formulas, so that the tumours it is tried on are none of those it knows.
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
DETECTOR_TUMOURS = 256  # tumours that the detector knows
EVALUATORS = ("closed-form", "equivalent-inclusion")


def examine(
    scene: Scene, design: Design, *, samples: int | None = None, unseen: bool = False, progress: Progress | None = None
) -> Examination:
    """Read a scan over a population: by the formulas over the design's own draw, or by finite elements over an unseen one.

    Ratio and stiffness are both read, whichever of them the protocol asks for.

    Args:
        scene: the design's scene, perhaps with another probe and load.
        design: population and protocol.
        samples: tumours; left out: as many as the design says.
        unseen: whether to take finite elements and tumours that no search has seen.
        progress: called with tissues done and all, by finite elements.

    Raises:
        InputError: the population does not fit the tissue, or the probe would leave it.
        Refusal: the evaluators cannot take the scene.
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
    """Judge a scene's probe under its load on tumours that no search has seen, by equivalent-inclusion with reflections.

    Args:
        scene: the design's scene, perhaps with another probe and load.
        design: population, protocol, noise and statistic.
        samples: tumours; left out: as many as the design says.
        seed: of the noise's draws; the tumours' is the design's.
        progress: called with tissues done and all.

    Raises:
        InputError: the population does not fit the tissue, or the probe would leave it.
        Refusal: the evaluators cannot take the scene.
    """
    return examine(scene, design, samples=samples, unseen=True, progress=progress).evaluate_all_channels(design, seed)


def score(scene: Scene, design: Design, *, samples: int | None = None, seed: int = 0) -> Judgement:
    """Judge a scene's probe by the formulas on the design's own draw; arguments and refusals as of ``verify``."""
    return examine(scene, design, samples=samples).evaluate(design, seed)
