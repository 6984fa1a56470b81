"""The page: sliders and typed values, the section, outputs, curves and map, and long work in a worker."""

from __future__ import annotations

import asyncio
import html
import io
import json
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, ParamSpec, TypeVar

from fastapi import FastAPI
from nicegui import Client, context, events, ui

from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.explorer import quick
from probe_design.explorer.bench import Bench
from probe_design.explorer.bench_page import BenchPage
from probe_design.explorer.bench_settings import BenchSettings
from probe_design.explorer.charts_svg import draw_curves, draw_map
from probe_design.explorer.formats import FOLDER, format_number
from probe_design.explorer.section_svg import draw_section
from probe_design.explorer.session import KEPT_NAMES, Session
from probe_design.explorer.variables import Variable, get_value
from probe_design.explorer.worker import Worker
from probe_design.maps.sphere_effects import Thresholds
from solver.evaluators import AUTO, EVALUATOR_NAMES
from solver.results.result import Result

SLIDER_STEPS = 400  # of a slider from end to end
# loads that the slider of the force marks
LIMITS = (("linear_limit_load", "L", "linear elasticity holds up to"), ("gap_closure_load", "G", "the gap stays open up to"))


# one thread for the formulas of all pages, as each thread has work arrays of its own
COMPUTING_THREAD = ThreadPoolExecutor(1, "formulas")
P = ParamSpec("P")
T = TypeVar("T")


async def _compute(function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
    """Call a function in the thread of the formulas."""
    return await asyncio.get_running_loop().run_in_executor(COMPUTING_THREAD, partial(function, *arguments, **options))


def build_application(settings: BenchSettings, name: str) -> FastAPI:
    """Return the application: each tab of the design page has a design of its own, all of the bench page the same bench.

    Parameters
    ----------
    settings
        What was named at the start.
    name
        Its name on the pages.
    """
    bench = Bench(settings)

    @asynccontextmanager
    async def close_bench(application: FastAPI) -> AsyncIterator[None]:
        """End the bench's worker with the server."""
        yield
        bench.close()

    application = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=close_bench)

    @ui.page("/bench", title="Bench: " + name, response_timeout=20)
    def show_bench() -> None:
        """Build the bench page of one tab."""
        BenchPage(bench, name)

    @ui.page("/", title="Explorer: " + name, response_timeout=20)
    def show_page() -> None:
        """Build the page of one tab."""
        Page(settings.scene, name)

    ui.run_with(application, show_welcome_message=False, tailwind=False, dark=None, reconnect_timeout=10)
    return application


class Page:
    """One tab."""

    def __init__(self, start: Scene, name: str) -> None:
        self.session, self.worker, self.name = Session(start), Worker(), name
        self.noise = DEFAULT_NOISE
        self.checked: Result | None = None
        self.checked_scene: Scene | None = None
        self.kept: dict[str, tuple[dict[str, str], dict[str, quick.Reading]]] = {}
        self.result: Result | None = None
        self.readings: dict[str, quick.Reading] = {}
        self._pending, self._is_updating, self._is_quiet, self._drawings = False, False, False, 0
        self.client: Client = context.client
        self.client.on_delete(self.worker.cancel)
        ui.add_css((FOLDER / "explorer.css").read_text())
        ui.add_body_html(f"<script>{(FOLDER / 'explorer.js').read_text()}</script>")
        ui.on("explorer_move", self._move_tumour)
        ui.on("explorer_open", self._open_fragment)
        self._build()
        self.request_update()

    def _build(self) -> None:
        """Build header and columns."""
        dark = ui.dark_mode(None)
        with ui.element("header").classes("top"):
            ui.html(f"<h1>Explorer</h1><span>{html.escape(self.name)}</span>", sanitize=False)
            ui.link("Bench", "/bench").classes("page-link")
            actions: tuple[tuple[str, Callable[[], object]], ...] = (
                ("Undo", self._undo),
                ("Redo", self._redo),
                *((f"Keep {key}", partial(self._keep, key)) for key in KEPT_NAMES),
                ("Scene TOML", self._download_toml),
                ("SVG", self._download_svg),
                ("PNG", self._download_png),
                ("STEP", self._download_step),
                ("Dark/light", lambda: dark.set_value(not dark.value)),
            )
            for text, act in actions:
                ui.button(text, on_click=act).props("dense flat no-caps")
        self.status = ui.html("computing", sanitize=False).props('role="status" aria-live="polite"').classes("status")
        with ui.element("div").classes("columns"):
            with ui.element("section").classes("numbers"):
                self.sliders: dict[str, ui.slider] = {}
                self.inputs: dict[str, ui.input] = {}
                for variable in self.session.variables.values():
                    self._build_variable(variable)
                ui.number("noise of a reading, %", value=100 * self.noise, min=0.001, max=1000, on_change=self._set_noise).props(
                    "dense"
                )
            with ui.element("section").classes("picture"):
                self.section = ui.html("", sanitize=False)
                self.outputs = ui.html("", sanitize=False)
                self.limits = ui.html("", sanitize=False).classes("progress")
                with ui.row():
                    names = [AUTO, *EVALUATOR_NAMES]
                    self.evaluator = ui.select(names, value=AUTO, label="evaluator").props("dense").classes("evaluator")
                    ui.button("Check", on_click=self._check).props("no-caps")
                    ui.button("Cancel", on_click=self.worker.cancel).props("no-caps flat")
                self.progress = ui.html("", sanitize=False).props('role="status"').classes("progress")
            with ui.element("section").classes("charts"):
                ui.html("<h2>Tumours detected</h2>", sanitize=False)
                self.map = ui.html("", sanitize=False)
                ui.html("<h2>Each output against each number</h2>", sanitize=False)
                self.curves = ui.html("", sanitize=False)

    def _build_variable(self, variable: Variable) -> None:
        """Build slider and typed value of one number."""
        value = get_value(self.session.scene, variable.key) or 0.0
        with ui.element("div").classes("number"):
            ui.html(html.escape(variable.label), sanitize=False, tag="span")
            slider = ui.slider(min=0, max=SLIDER_STEPS, step=1, value=round(SLIDER_STEPS * variable.find_fraction(value)))
            slider.props(f'aria-label="{variable.label}" dense').on_value_change(partial(self._slide, variable))
            entry = ui.input(value=variable.format_value(value)).props(f'dense outlined aria-label="{variable.label}, value"')
            entry.on("change", partial(self._type, variable))
        self.sliders[variable.key], self.inputs[variable.key] = slider, entry

    # Events

    def _slide(self, variable: Variable, event: events.ValueChangeEventArguments[Any]) -> None:
        """Change a number by its slider."""
        if not self._is_quiet and isinstance(event.value, int | float):
            self._change({variable.key: variable.format_value(variable.find_value(event.value / SLIDER_STEPS))})

    def _type(self, variable: Variable) -> None:
        """Change a number by its text."""
        self._change({variable.key: str(self.inputs[variable.key].value)})

    def _move_tumour(self, event: events.GenericEventArguments) -> None:
        """Move a tumour to where it was dragged: {index, x, depth}, mm."""
        message = event.args
        try:
            index, x, depth = int(message["index"]), float(message["x"]), float(message["depth"])
        except (TypeError, KeyError, ValueError, OverflowError):
            self._say("a message of the page was not understood and is left out")
            return
        self._change({f"inclusion[{index}].x": f"{x:.3g} mm", f"inclusion[{index}].depth": f"{depth:.3g} mm"})

    def _open_fragment(self, event: events.GenericEventArguments) -> None:
        """Show the design that the address holds."""
        try:
            self.session.read_fragment(str(event.args))
        except ProbeError as refusal:
            self._say(f"the address is refused: {refusal}")
        self.request_update()

    def _change(self, entries: dict[str, str]) -> None:
        """Change numbers; a refusal is shown, and the last valid picture stays."""
        try:
            self.session.change(entries)
        except ProbeError as refusal:
            self._say(str(refusal))
            return
        self.request_update()

    def _undo(self) -> None:
        if self.session.undo():
            self.request_update()

    def _redo(self) -> None:
        if self.session.redo():
            self.request_update()

    def _keep(self, key: str) -> None:
        """Remember the present design."""
        if self.readings:
            self.kept[key] = dict(self.session.changes), self.readings
            self._show_outputs()

    def _set_noise(self, event: events.ValueChangeEventArguments[Any]) -> None:
        """Change the noise on which the map depends."""
        if isinstance(event.value, int | float) and event.value > 0:
            self.noise = event.value / 100
            self.request_update()

    # Updates

    def request_update(self) -> None:
        """Compute and draw again; changes that come meanwhile are drawn together afterwards."""
        self._pending = True
        if not self._is_updating:
            self._is_updating = True
            asyncio.get_running_loop().create_task(self._update())

    async def _update(self) -> None:
        """Draw until nothing is pending: first the quick quantities, then curves and map unless there is a newer design."""
        try:
            while self._pending:
                self._pending = False
                scene = self.session.scene
                if await self._compute_quantities(scene) and not self._pending:
                    await self._compute_charts(scene)
        finally:
            self._is_updating = False

    async def _compute_quantities(self, scene: Scene) -> bool:
        """Compute and show the outputs; False where the formulas refuse the design."""
        try:
            result = await _compute(quick.evaluate_quickly, scene)
            error = await _compute(quick.compute_sensitivity_error, scene)
        except ProbeError as refusal:
            self._say(str(refusal))
            self._show_numbers()
            return False
        self.result, self.readings = result, quick.list_readings(result, error)
        with self.client:
            self._show_numbers()
            self._show_outputs()
            self._show_limits(result)
            self.section.content = draw_section(scene)
            fragment = json.dumps(f"/#{self.session.fragment}" if self.session.fragment else "/")
            ui.run_javascript(f"history.replaceState(null, '', {fragment})")
        self._say("", list(result.warnings))
        return True

    async def _compute_charts(self, scene: Scene) -> None:
        """Compute and show curves and map."""
        variables = [item for item in self.session.variables.values() if not item.key.startswith("load.")]
        curves = await _compute(quick.compute_curves, scene, variables)
        names = ["ratio", "log_sensitivity", "stiffness"]
        if scene.probe.film is not None:
            names.append("charge_ratio")
        self.curves.content = draw_curves(curves, names)
        if self._pending:
            return
        try:
            detected = await _compute(quick.compute_map, scene, Thresholds(self.noise))
            picture = draw_map(detected, scene)
        except ProbeError as refusal:
            picture = f"<p>No map: {html.escape(str(refusal))}</p>"
        self._drawings += 1
        self.map.content = (
            f'{picture}<span hidden data-drawings="{self._drawings}"></span>'  # for those who wait for the last drawing
        )

    def _say(self, text: str, warnings: list[str] | None = None) -> None:
        """Show a refusal, or that the design is shown, with what evaluated it."""
        who = f"evaluated by {quick.EVALUATOR}, errors at 95 %" if self.result is not None else "computing"
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in warnings or [])
        refusal = f'<strong class="refusal">{html.escape(text)}</strong> The last valid design is shown. ' if text else ""
        self.status.content = f"{refusal}<span>{who}</span><ul>{notes}</ul>"

    def _show_numbers(self) -> None:
        """Set sliders and texts to the present design, without that counting as a change."""
        self._is_quiet = True
        try:
            for key, variable in self.session.variables.items():
                value = get_value(self.session.scene, key)
                if value is not None:
                    text, place = variable.format_value(value), round(SLIDER_STEPS * variable.find_fraction(value))
                    if variable.find_value((self.sliders[key].value or 0) / SLIDER_STEPS) != value:
                        self.sliders[key].value = place
                    self.inputs[key].value = text
        finally:
            self._is_quiet = False

    def _show_limits(self, result: Result) -> None:
        """State where linear elasticity ends and the gap may close, and mark it on the slider of the force."""
        marks, texts = [], []
        for name, sign, words in LIMITS:
            limit = getattr(result, name)
            for key, load in (("load.force", "force"), ("load.indentation", "indentation")):
                value, variable = getattr(limit, load, None), self.session.variables.get(key)
                if variable is not None and value is not None:
                    texts.append(f"{sign}: {words} {variable.format_value(float(f'{value:.3g}'))} ({limit.by})")
                    if variable.low <= value <= variable.high:
                        marks.append({"value": round(SLIDER_STEPS * variable.find_fraction(value)), "label": sign})
        self.limits.content = html.escape("; ".join(texts))
        for key in {"load.force", "load.indentation"} & self.sliders.keys():
            if marks or "marker-labels" in self.sliders[key].props:
                self.sliders[key].props["marker-labels"] = marks
                self.sliders[key].update()

    def _show_outputs(self) -> None:
        """Show the outputs, beside them those that were checked and kept."""
        checked = {} if self.checked is None else quick.list_readings(self.checked, None)
        is_old = self.checked_scene is not self.session.scene
        heads = ["", f"{quick.EVALUATOR}, 95 %"]
        if self.checked is not None:
            heads.append(f"{self.checked.evaluator}, {self.checked.error_kind}{' (of an earlier design)' if is_old else ''}")
        heads += [f"kept {key}" for key in self.kept]
        rows = []
        for name, reading in self.readings.items():
            columns = [reading, *([checked.get(name)] if self.checked is not None else [])]
            columns += [readings.get(name) for _, readings in self.kept.values()]
            cells = "".join(_write_cell(name, item, k == 0) for k, item in enumerate(columns))
            rows.append(f"<tr><th>{quick.LABELS[name]}</th>{cells}</tr>")
        head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
        self.outputs.content = f'<table class="outputs"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'

    # Long work and downloads

    async def _check(self) -> None:
        """Evaluate the present design in the worker, and show the result beside the quick one."""
        scene, evaluator = self.session.scene, str(self.evaluator.value)
        result = await self._work("evaluate", scene, evaluator)
        if isinstance(result, Result):
            self.checked, self.checked_scene = result, scene
            self._show_outputs()
            self.progress.content = f"checked by {result.evaluator} in {result.seconds:.2g} s"

    async def _work(self, kind: str, scene: Scene, evaluator: str = "") -> Any:
        """Return the result of the worker, or None where it is refused or cancelled, which the page then says."""
        self.progress.content = "working"
        async for state, content in self.worker.work(kind, scene, evaluator):
            if state == "result":
                return content
            self.progress.content = html.escape(str(content))
        return None

    def _download_toml(self) -> None:
        ui.download.content(scene_to_toml(self.session.scene), "scene.toml")

    def _download_svg(self) -> None:
        ui.download.content(draw_section(self.session.scene), "section.svg")

    async def _download_png(self) -> None:
        picture = io.BytesIO()
        figure = await asyncio.to_thread(self.session.scene.plot)
        await asyncio.to_thread(figure.savefig, picture, format="png")
        ui.download.content(picture.getvalue(), "section.png")

    async def _download_step(self) -> None:
        """Build the STEP file in the worker."""
        content = await self._work("step", self.session.scene)
        if isinstance(content, bytes):
            self.progress.content = "the STEP file is made"
            ui.download.content(content, "assembly.step")


def _write_cell(name: str, reading: quick.Reading | None, is_present: bool) -> str:
    """Return a cell with a number, its error and its unit; the present design's is marked, and holds all digits."""
    if reading is None or reading.value is None:
        return "<td>not known</td>"
    unit, factor = quick.UNITS.get(name, ("", 1.0))
    value, error = factor * reading.value, None if reading.error is None else factor * reading.error
    mark = f' data-output="{name}"' if is_present else ""
    return f'<td{mark} data-value="{reading.value!r}">{format_number(value, error)} {unit}</td>'
