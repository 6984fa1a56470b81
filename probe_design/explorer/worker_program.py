"""Evaluate a design, or make its STEP file, in a process of its own: the program of ``worker``."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene


def run(request: tuple[str, Scene, str]) -> Iterator[tuple[str, Any]]:
    """Yield ("progress", text) while it works, then ("result", Result or bytes) or ("refused", reason).

    ``request`` is "evaluate" with a scene and an evaluator, or "step" with a scene.
    """
    queue: SimpleQueue[tuple[str, Any]] = SimpleQueue()
    kind, scene, evaluator = request

    def work() -> None:
        """Put the messages into the queue."""
        try:
            if kind == "step":
                queue.put(("result", _build_step(scene)))
            else:
                from solver import evaluate

                queue.put(("result", evaluate(scene, evaluator, progress=lambda text: queue.put(("progress", text)))))
        except ProbeError as refusal:
            queue.put(("refused", str(refusal)))
        except Exception as fault:
            queue.put(("refused", f"{type(fault).__name__}: {fault}"))

    Thread(target=work, daemon=True).start()
    while True:
        message = queue.get()
        yield message
        if message[0] != "progress":
            return


def _build_step(scene: Scene) -> bytes:
    """Return the assembly's STEP file."""
    from geometry.cad.export import export_parts

    with tempfile.TemporaryDirectory() as folder:
        export_parts(scene.probe, Path(folder), edge_radius=scene.contact.edge_radius)
        return Path(folder, "assembly.step").read_bytes()
