"""Long work of a design page in a worker process: check, optimise, and the files of the workshop."""

from __future__ import annotations

import asyncio
import html
import io
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from probe_design.data.noise import DEFAULT_NOISE, MIN_NOISE
from probe_design.explorer import quick
from probe_design.explorer.computing import compute
from probe_design.explorer.section_svg import draw_section
from probe_design.explorer.session import Session
from probe_design.explorer.worker import Worker
from probe_design.populations.design_file import Design
from solver.evaluators import AUTO, EVALUATOR_NAMES
from solver.results.result import Result

Columns = list[tuple[str, dict[str, quick.Reading]]]


class LongWork:
    """What takes seconds to minutes, one piece at a time, with progress and cancel.

    Parameters
    ----------
    session
        The page's design.
    design
        Design file that was named at the start, whose population is optimised for; None: the scene's tumour.
    show
        Called when there are new columns of outputs.
    accept
        Called when the optimised design has become the present one.
    """

    def __init__(self, session: Session, design: Design | None, show: Callable[[], None], accept: Callable[[], None]) -> None:
        self.session, self.design, self.worker = session, design, Worker()
        self._show, self._request_update = show, accept
        self.noise = DEFAULT_NOISE if design is None else max(math.hypot(design.noise.white, design.noise.tilt), MIN_NOISE)
        self._checked: tuple[Scene, Result] | None = None
        self._optimum: tuple[Scene, dict[str, quick.Reading]] | None = None

    def build(self) -> None:
        """Build evaluator, buttons and progress."""
        with ui.row():
            names = [AUTO, *EVALUATOR_NAMES]
            self.evaluator = ui.select(names, value=AUTO, label="evaluator").props("dense").classes("evaluator")
            ui.button("Check", on_click=self._check).props("no-caps")
            ui.button("Optimise from here", on_click=self._optimize).props("no-caps")
            self.accept_button = ui.button("Accept", on_click=self._use_optimum).props("no-caps outline")
            self.accept_button.visible = False
            ui.button("Cancel", on_click=self.worker.cancel).props("no-caps flat")
        self.progress = ui.html("", sanitize=False).props('role="status"').classes("progress")

    def build_downloads(self) -> None:
        """Build the buttons of the downloads."""
        for text, act in (
            ("Scene TOML", self._download_toml), ("SVG", self._download_svg), ("PNG", self._download_png),
            ("STEP", partial(self._download_files, "step", "assembly.step")),
            ("Workshop", partial(self._download_files, "workshop", "workshop.zip")),
        ):  # fmt: skip
            ui.button(text, on_click=act).props("dense flat no-caps")

    def list_columns(self) -> Columns:
        """Return the outputs that were checked and optimised, with their headings."""
        columns: Columns = []
        if self._checked is not None:
            scene, result = self._checked
            old = "" if scene is self.session.scene else " (of an earlier design)"
            columns.append((f"{result.evaluator}, {result.error_kind}{old}", quick.list_readings(result, None)))
        if self._optimum is not None:
            columns.append((f"optimised, {quick.EVALUATOR}", self._optimum[1]))
        return columns

    def _get_scene(self) -> Scene:
        """Return the present design, with changes that wait for their drawing."""
        self.session.settle()
        return self.session.scene

    async def _check(self) -> None:
        """Evaluate the present design, and show the result beside the quick one."""
        scene = self._get_scene()
        result = await self._work("evaluate", scene, str(self.evaluator.value))
        if isinstance(result, Result):
            self._checked = scene, result
            self._show()
            self.progress.content = f"checked by {result.evaluator} in {result.seconds:.2g} s"

    async def _optimize(self) -> None:
        """Search for a better design from the present one, and show its outputs beside the quick ones."""
        scene = self._get_scene()
        subject = scene if self.design is None else self.design.model_copy(update={"scene": scene})
        optimum = await self._work("optimize", subject, self.noise)
        if optimum is None:
            return
        if optimum["improved"]:
            self._optimum = optimum["scene"], await compute(quick.evaluate_outputs, optimum["scene"])
            self.accept_button.visible = True
            self._show()
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in optimum["warnings"])
        self.progress.content = f"{html.escape(optimum['verdict'])} ({optimum['seconds']:.0f} s)<ul>{notes}</ul>"

    def _use_optimum(self) -> None:
        """Make the optimised design the present one."""
        if self._optimum is None:
            return
        try:
            left_out = self.session.adopt(self._optimum[0])
        except ProbeError as refusal:
            self.progress.content = html.escape(f"not accepted: {refusal}")
            return
        self._optimum, self.accept_button.visible = None, False
        self._request_update()
        notes = f", but for {', '.join(left_out)}, which the page does not vary" if left_out else ""
        self.progress.content = html.escape(f"the optimised design is accepted{notes}; Undo returns to the one before")

    async def _work(self, kind: str, subject: Scene | Design, option: object = None) -> Any:
        """Return the result of the worker, or None where it is refused or cancelled, which the page then says."""
        self.progress.content = "working"
        async for state, content in self.worker.work(kind, subject, option):
            if state == "result":
                return content
            self.progress.content = html.escape(str(content))
        return None

    def _download_toml(self) -> None:
        ui.download.content(scene_to_toml(self._get_scene()), "scene.toml")

    def _download_svg(self) -> None:
        ui.download.content(draw_section(self._get_scene()), "section.svg")

    async def _download_png(self) -> None:
        picture = io.BytesIO()
        figure = await asyncio.to_thread(self._get_scene().plot)
        await asyncio.to_thread(figure.savefig, picture, format="png")
        ui.download.content(picture.getvalue(), "section.png")

    async def _download_files(self, kind: str, name: str) -> None:
        """Build files of the present design in the worker."""
        content = await self._work(kind, self._get_scene())
        if isinstance(content, bytes):
            self.progress.content = f"{name} is made"
            ui.download.content(content, name)
