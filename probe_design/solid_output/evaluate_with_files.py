"""Evaluate a scene in three dimensions and write its fields: a VTU file, a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from geometry.common.errors import InputError
from geometry.common.files import check_writable_file
from geometry.scenes.scene import Scene
from solver.planning.load_check import with_warning
from solver.results.result import Result
from solver.solid.level import SolidLevel, indentation


def evaluated(
    scene: Scene, evaluator: str, accuracy: float, *, vtu: Path | None, picture: Path | None, tell: Callable[[str], None]
) -> Result:
    """Evaluate with ``solid`` and write its finest mesh with displacements and stresses at the scene's load.

    Args:
        scene: the scene.
        evaluator: "solid"; no other evaluator has a mesh of the whole scene.
        accuracy: relative.
        vtu: file for ParaView, or None.
        picture: a .png file, or None.
        tell: called with a line before each step.

    Raises:
        InputError: another evaluator, or a file name with another suffix.
        Refusal: see ``solver.solid.level.SolidEvaluator.solve``.
    """
    from probe_design.solid_output.vtu import draw_solid, write_vtu

    for key, path, suffix in (("vtu", vtu, ".vtu"), ("plot", picture, ".png")):
        if path is None:
            continue
        if evaluator != "solid":
            raise InputError("evaluator", evaluator, f"solid, for --{key}")
        if path.suffix.lower() != suffix:
            raise InputError(key, str(path), f"a file name that ends in {suffix}")
        check_writable_file(path, key)  # fail before the work, not after it
    start, level = perf_counter(), SolidLevel(tell=tell)
    solution = level.solved(scene, accuracy)
    result = level.answer_of(scene, solution, accuracy).result(level.name, scene, perf_counter() - start)
    lowered = indentation(scene, solution, 0)
    motion = np.array([lowered, lowered, scene.placement.tilt])
    if vtu is not None:
        tell(f"writing {vtu}")
        write_vtu(vtu, solution.states, motion)
    if picture is not None:
        tell(f"drawing {picture}")
        draw_solid(picture, solution.states, motion)
    return with_warning(result, scene, accuracy)
