"""Long work of a design page in a worker process: check, optimise, and the files of the workshop."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from probe_design.data.noise import DEFAULT_NOISE, MIN_NOISE
from probe_design.explorer.formats import Reading
from probe_design.explorer.section_svg import draw_section
from probe_design.explorer.session import Session
from probe_design.explorer.worker import Worker
from probe_design.populations.design_file import Design

Columns = list[tuple[str, dict[str, Reading]]]


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
        self._checked: tuple[Scene, str, dict[str, Reading]] | None = None
        self._optimum: tuple[Scene, Columns] | None = None

    def build(self, evaluators: Sequence[str]) -> None:
        """Build evaluator, buttons and progress."""
        with ui.row().classes("work"):
            self.evaluator = ui.select(list(evaluators), value=evaluators[0], label="evaluator").props("dense")
            self.evaluator.classes("evaluator")
            ui.button("Check", on_click=self._check).props("no-caps")
            ui.button("Optimise from here", on_click=self._optimize).props("no-caps")
            self.accept_button = ui.button("Accept", on_click=self._use_optimum).props("no-caps outline")
            self.accept_button.visible = False
            ui.button("Cancel", on_click=self.worker.cancel).props("no-caps flat")
        self.progress = ui.html("", sanitize=False).props('role="status"').classes("progress")

    def build_downloads(self) -> None:
        """Build the buttons of the downloads."""
        for text, act in (
            ("Scene TOML", self._download_toml), ("SVG", self._download_svg),
            ("PNG", partial(self._download_files, "png", "section.png")),
            ("STEP", partial(self._download_files, "step", "assembly.step")),
            ("Workshop", partial(self._download_files, "workshop", "workshop.zip")),
        ):  # fmt: skip
            ui.button(text, on_click=act).props("dense flat no-caps")

    def list_columns(self) -> Columns:
        """Return the outputs that were checked and optimised, with their headings."""
        columns: Columns = []
        if self._checked is not None:
            scene, heading, readings = self._checked
            columns.append((heading if scene is self.session.scene else f"{heading} (of an earlier design)", readings))
        if self._optimum is not None:
            columns += self._optimum[1]
        return columns

    def _get_scene(self) -> Scene:
        """Return the present design, with changes that wait for their drawing."""
        self.session.settle()
        return self.session.scene

    async def _check(self) -> None:
        """Evaluate the present design, and show the result beside the quick one."""
        scene = self._get_scene()
        if (checked := await self._work("evaluate", scene, str(self.evaluator.value))) is not None:
            heading, readings, seconds = checked
            self._checked = scene, heading, readings
            self._show()
            self.progress.content = html.escape(f"checked by {heading.partition(',')[0]} in {seconds:.2g} s")

    async def _optimize(self) -> None:
        """Search for a better design from the present one, and show its outputs beside the quick ones."""
        scene = self._get_scene()
        subject = scene if self.design is None else self.design.model_copy(update={"scene": scene})
        optimum = await self._work("optimize", subject, self.noise)
        if optimum is None:
            return
        if optimum["improved"]:
            self._optimum = optimum["scene"], optimum["columns"]
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
        self.progress.content, result = "working", None
        async for state, content in self.worker.work(kind, subject, option):
            if state == "result":
                result = content
            else:
                self.progress.content = html.escape(str(content))
        return result

    def _download_toml(self) -> None:
        ui.download.content(scene_to_toml(self._get_scene()), "scene.toml")

    def _download_svg(self) -> None:
        ui.download.content(draw_section(self._get_scene()), "section.svg")

    async def _download_files(self, kind: str, name: str) -> None:
        """Build files of the present design in the worker."""
        content = await self._work(kind, self._get_scene())
        if isinstance(content, bytes):
            self.progress.content = f"{name} is made"
            ui.download.content(content, name)
