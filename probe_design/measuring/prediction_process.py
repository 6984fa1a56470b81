"""Compute the prediction in a child process, so that its memory is free again when a long reading starts."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from geometry.common.child_process import Arrays, Failure, run_program
from geometry.common.resources import get_limits, use_limits
from geometry.scenes.scene import Scene
from probe_design.built_probe.reading import predict_scene
from solver.results.result import Result

MIN_READING_S = 60.0  # s: a longer reading justifies the second that a process takes to start
TIME_LIMIT_S = 86_400.0  # s: the solver has its own limits


def predict_in_process(scene: Scene, accuracy: float, linear: bool, frequency: float) -> Result:
    """Return ``reading.predict_scene`` from a child process; if no process can be started, compute it in this one.

    Raises:
        ProbeError: any error of ``reading.predict_scene``.
    """
    question = pickle.dumps((scene, accuracy, linear, frequency, get_limits()))
    try:
        answer = run_program(Path(__file__), {"question": np.frombuffer(question, np.uint8)}, TIME_LIMIT_S)["answer"]
    except Failure:  # also for a refused scene: computing it here raises the original error
        return predict_scene(scene, accuracy, linear, frequency)
    result: Result = pickle.loads(answer.tobytes())
    return result


def run(arrays: Arrays) -> dict[str, np.ndarray]:
    """Compute the prediction in the child process."""
    scene, accuracy, linear, frequency, process_limits = pickle.loads(arrays["question"].tobytes())
    with use_limits(process_limits):
        answer = predict_scene(scene, accuracy, linear, frequency)
    return {"answer": np.frombuffer(pickle.dumps(answer), np.uint8)}
