"""Compute the prediction in a child process, so that its memory is free again when a long reading starts."""

from __future__ import annotations

from pathlib import Path

from geometry.common.resources import Limits, get_limits, use_limits
from geometry.processes.child import Failure
from geometry.processes.programs import run_program
from geometry.scenes.scene import Scene
from probe_design.built_probe.reading import predict_scene
from solver.results.result import Result

MIN_READING_S = 60.0  # s: a longer reading justifies the second that a process takes to start
TIME_LIMIT_S = 86_400.0  # s: the solver has its own limits
Arguments = tuple[Scene, float, bool, float]  # of ``predict_scene``


def predict_in_process(scene: Scene, accuracy: float, linear: bool, frequency: float) -> Result:
    """Return the result of ``reading.predict_scene`` from a child process; if that fails, compute it in this process.

    For the parameters see ``reading.predict_scene``.

    Raises
    ------
    ProbeError
        Any error of ``reading.predict_scene``.
    """
    arguments = scene, accuracy, linear, frequency
    try:
        result: Result = run_program(Path(__file__), (arguments, get_limits()), TIME_LIMIT_S)
    except Failure:  # also for a refused scene: computing it here raises the original error
        return predict_scene(*arguments)
    return result


def run(request: tuple[Arguments, Limits]) -> Result:
    """Compute the prediction in the child process: arguments of ``predict_scene``, and the limits of the solver."""
    arguments, limits = request
    with use_limits(limits):
        return predict_scene(*arguments)
