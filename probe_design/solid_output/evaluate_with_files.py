"""Evaluate a scene in three dimensions and write its fields: a VTU file, a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from geometry.common.errors import InputError
from geometry.common.files import check_writable_file
from geometry.scenes.scene import Scene
from probe_design.solid_output.vtu import write_vtu
from solver.planning.load_check import add_load_warning
from solver.results.result import Result
from solver.solid.evaluator import SolidEvaluator, compute_indentation


def evaluate_with_files(
    scene: Scene, evaluator: str, accuracy: float, *, vtu: Path | None, picture: Path | None, progress: Callable[[str], None]
) -> Result:
    """Evaluate with ``solid`` and write its finest mesh with displacements and stresses at the scene's load.

    Parameters
    ----------
    scene
        The scene.
    evaluator
        "solid"; no other evaluator has a mesh of the whole scene.
    accuracy
        Relative, on the ratio.
    vtu
        File for ParaView, or None.
    picture
        A .png file, or None.
    progress
        Called with a line before each step.

    Raises
    ------
    InputError
        Another evaluator, or a file name with another suffix.
    Refusal
        See ``solver.solid.evaluator.SolidEvaluator.solve``.
    """
    for key, path, suffix in (("vtu", vtu, ".vtu"), ("plot", picture, ".png")):
        if path is None:
            continue
        if evaluator != "solid":
            raise InputError("evaluator", evaluator, f"solid, for --{key}")
        if path.suffix.lower() != suffix:
            raise InputError(key, str(path), f"a file name that ends in {suffix}")
        check_writable_file(path, key)  # fail before the work, not after it
    start, solid_evaluator = perf_counter(), SolidEvaluator(progress=progress)
    solution = solid_evaluator.solve_forces(scene, accuracy)
    result = solid_evaluator.build_solution(scene, solution, accuracy).build_result(
        solid_evaluator.name, scene, perf_counter() - start
    )
    descent = compute_indentation(scene, solution, 0)  # m
    motion = np.array([descent, descent, scene.placement.tilt])
    if vtu is not None:
        progress(f"writing {vtu}")
        write_vtu(vtu, solution.states, motion)
    if picture is not None:
        from probe_design.solid_output.figure import draw_solid

        progress(f"drawing {picture}")
        draw_solid(picture, solution.states, motion)
    return add_load_warning(result, scene, accuracy)
