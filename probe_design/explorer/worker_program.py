"""Evaluate or optimise a design, or make its files, in a process of its own: the program of ``worker``."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geometry.scenes.scene import Scene
from probe_design.explorer.messages import Message, Put, stream_messages
from probe_design.populations.design_file import Design
from solver import evaluate


def run(request: tuple[str, Any, Any]) -> Iterator[Message]:
    """Yield ("progress", text) while it works, then ("result", content) or ("refused", reason).

    ``request`` is "evaluate" with a scene and an evaluator, "optimize" with a scene or design and the noise of a reading,
    "step" or "workshop" with a scene and None.
    """
    kind, subject, option = request

    def work(put: Put) -> object:
        """Do what was asked for."""
        if kind == "evaluate":
            return evaluate(subject, option, progress=lambda text: put("progress", text))
        if kind == "optimize":
            return _optimize(subject, option, put)
        with tempfile.TemporaryDirectory() as folder:
            return (_build_step if kind == "step" else _build_workshop)(subject, Path(folder), put)

    return stream_messages(work)


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
    return {
        "improved": optimum.winner is not None, "scene": optimum.scene, "verdict": optimum.verdict, "warnings": optimum.warnings,
        "seconds": optimum.seconds["all"],
    }  # fmt: skip


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
