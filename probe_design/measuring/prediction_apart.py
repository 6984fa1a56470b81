"""The prediction in a process of its own, whose memory is gone when the reading starts: what a logger of hours runs beside."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from geometry.common.child_process import Arrays, Failure, run_program
from geometry.common.resources import limited, limits
from geometry.scenes.scene import Scene
from probe_design.built_probe.reading import prediction
from solver.results.result import Result

LONG = 60.0  # s of a reading from which on that is worth the second which a process takes to begin
PATIENCE = 86_400.0  # s: the solver has limits of its own


def prediction_apart(scene: Scene, accuracy: float, linear: bool, frequency: float) -> Result:
    """Return ``reading.prediction``, none of whose memory stays; where there can be no process, it is made here.

    Raises:
        ProbeError: whatever ``reading.prediction`` raises.
    """
    question = pickle.dumps((scene, accuracy, linear, frequency, limits()))
    try:
        answer = run_program(Path(__file__), {"question": np.frombuffer(question, np.uint8)}, PATIENCE)["answer"]
    except Failure:  # a scene that is refused, too: it is refused again, by the error's own name
        return prediction(scene, accuracy, linear, frequency)
    result: Result = pickle.loads(answer.tobytes())
    return result


def run(arrays: Arrays) -> dict[str, np.ndarray]:
    """Answer in the child."""
    scene, accuracy, linear, frequency, held = pickle.loads(arrays["question"].tobytes())
    with limited(held):
        answer = prediction(scene, accuracy, linear, frequency)
    return {"answer": np.frombuffer(pickle.dumps(answer), np.uint8)}
