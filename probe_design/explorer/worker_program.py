"""Evaluate or optimise a design, or make its files, in a process of its own: the program of ``worker``."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from probe_design.explorer.formats import EVALUATOR, Reading
from probe_design.explorer.messages import Message, Put, stream_messages
from probe_design.explorer.quick import list_readings
from probe_design.populations.design_file import Design
from solver import evaluate
from solver.evaluators import AUTO


def run(request: tuple[str, Any, Any]) -> Iterator[Message]:
    """Yield ("progress", text) while it works, then ("result", content) or ("refused", reason).

    ``request`` is "evaluate" with a scene and an evaluator, "optimize" with a scene or design and the noise of a reading,
    "png", "step" or "workshop" with a scene and None.
    """
    kind, subject, option = request

    def work(put: Put) -> object:
        """Do what was asked for."""
        if kind == "evaluate":
            return _evaluate(subject, option, put)
        if kind == "optimize":
            return _optimize(subject, option, put)
        with tempfile.TemporaryDirectory() as folder:
            return BUILDERS[kind](subject, Path(folder), put)

    return stream_messages(work)


def _evaluate(scene: Scene, evaluator: str, put: Put) -> tuple[str, dict[str, Reading], float]:
    """Return the heading of an evaluator's values, these, and the seconds that they took."""
    result = evaluate(scene, evaluator, progress=lambda text: put("progress", text))
    return f"{result.evaluator}, {result.error_kind}", list_readings(result, None), result.seconds


def _optimize(subject: Scene | Design, noise: float, put: Put) -> dict[str, Any]:
    """Return the best design from here on, with the verdict of its verification."""
    from probe_design.design_search.optimum import Optimum
    from probe_design.design_search.population_study import optimize_for_population
    from probe_design.design_search.tumour_study import optimize_for_tumour

    def report(stage: str, done: int, total: int) -> None:
        """Put the progress of a stage."""
        put("progress", f"{stage}: {done} of {total}")

    optimum: Optimum[Any] = (
        optimize_for_tumour(subject, report, noise=noise)
        if isinstance(subject, Scene)
        else optimize_for_population(subject, report)
    )
    columns = []
    if optimum.winner is not None:
        for name in (EVALUATOR, AUTO):
            with suppress(ProbeError):  # the formulas need not cover what was verified by finite elements
                heading, readings, _ = _evaluate(optimum.scene, name, put)
                columns.append((f"optimised, {heading}", readings))
    return {
        "columns": columns,
        "improved": optimum.winner is not None,
        "scene": optimum.scene,
        "verdict": optimum.verdict,
        "warnings": optimum.warnings,
        "seconds": optimum.seconds["all"],
    }


def _draw_section(scene: Scene, folder: Path, put: Put) -> bytes:
    """Return the section as PNG."""
    put("progress", "picture")
    scene.plot().savefig(folder / "section.png")
    return (folder / "section.png").read_bytes()


def _build_step(scene: Scene, folder: Path, put: Put) -> bytes:
    """Return the assembly's STEP file."""
    from geometry.cad.export import export_parts

    put("progress", "solids")
    export_parts(scene.probe, folder, edge_radius=scene.contact.edge_radius)
    return (folder / "assembly.step").read_bytes()


def _build_workshop(scene: Scene, folder: Path, put: Put) -> bytes:
    """Return the files of `export` in one ZIP file."""
    from probe_design.workshop.package import export

    summary = export(scene, folder, progress=lambda text: put("progress", text))
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(summary.files):
            archive.write(file, file.relative_to(folder))
    return content.getvalue()


BUILDERS = {"png": _draw_section, "step": _build_step, "workshop": _build_workshop}
