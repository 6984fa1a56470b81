"""The evaluators by name."""

from __future__ import annotations

from importlib import import_module
from typing import cast

from geometry.common import quick_scipy  # noqa: F401 - before any module that imports SciPy
from geometry.common.errors import InputError, describe_choices
from geometry.scenes.scene import Scene
from geometry.scenes.units import read_fraction
from solver.linalg.workspace import Workspace, get_workspace, use_workspace
from solver.results.evaluator import Evaluator, ProgressCallback

AUTO, CONTACT = "auto", "contact"
DEFAULT_ACCURACY = 0.01  # relative: a reading's noise is about as large
EVALUATOR_NAMES = ("published", "closed-form", "equivalent-inclusion", "axisymmetric", "contact", "solid")
"""Names of the evaluators; each is made by the module ``solver/<name>/evaluator.py``."""


def evaluator(name: str, progress: ProgressCallback | None = None, workspace: Workspace | None = None) -> Evaluator:
    """Return the evaluator of a given name; its module is imported only now, which keeps the start-up short.

    Parameters
    ----------
    name
        The evaluator's name.
    progress
        Called with a line of text before each long piece of work; evaluators without any ignore it.
    workspace
        Where it keeps meshes and factors; by default the current one, usually the process's.

    Raises
    ------
    InputError
        No evaluator has that name.
    """
    if name not in EVALUATOR_NAMES:
        raise InputError("evaluator", name, describe_choices(name, (AUTO, *EVALUATOR_NAMES)))
    module = import_module(f"solver.{name.replace('-', '_')}.evaluator")
    with use_workspace(get_workspace() if workspace is None else workspace):
        return cast(Evaluator, module.create_evaluator(progress))


def check_accuracy(accuracy: float | str) -> float:
    """Return the accuracy, a number or a text such as "1 %"; raise ``InputError`` unless it is between 0 and 1."""
    allowed = "a number above 0 and below 1, such as 0.01 or '1 %'"
    number = read_fraction("accuracy", accuracy, allowed)
    if not 0 < number < 1:
        raise InputError("accuracy", accuracy, allowed)
    return number


def choose_accuracy(scene: Scene, accuracy: float | None) -> float:
    """Return the accuracy given, else the scene's ``reading.accuracy``, else ``DEFAULT_ACCURACY``; checked to be in 0 to 1."""
    return check_accuracy(accuracy if accuracy is not None else scene.reading.accuracy or DEFAULT_ACCURACY)
