"""The page: sliders and typed values, the section, outputs, curves and map, and long work in a worker."""

from __future__ import annotations

import asyncio
import html
import json
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI
from nicegui import Client, context, events, ui

from geometry.common.errors import InputError, ProbeError
from geometry.scenes.scene import Scene
from probe_design.data.noise import read_noise
from probe_design.explorer.bench import Bench
from probe_design.explorer.bench_page import BenchPage
from probe_design.explorer.bench_settings import BenchSettings
from probe_design.explorer.edges import find_edge_changes
from probe_design.explorer.formats import EVALUATOR, FOLDER, LABELS, UNITS, Reading, convert_decimal_comma, format_number
from probe_design.explorer.formulas import Formulas
from probe_design.explorer.limits import GAP_KEY, mark_gap, search_gap
from probe_design.explorer.long_work import LongWork
from probe_design.explorer.section_svg import draw_section
from probe_design.explorer.session import KEPT_NAMES, Session
from probe_design.explorer.variables import MAX_TEXT_LENGTH, Variable, get_value

if TYPE_CHECKING:
    from probe_design.explorer.limits import Limit

MAX_NAME_LENGTH = 20  # characters, of what can be dragged
GAP_MARK_DELAY_S = 0.4  # s that a design rests before the gap is searched that its load closes: three limits, 30 ms each
RECONNECT_S = 15.0  # s that a page of a busy machine may be silent before its design is dropped
SLIDER_STEPS = 400  # of a slider from end to end


def build_application(settings: BenchSettings, formulas: Formulas, start: Scene, name: str, evaluators: Sequence[str]) -> FastAPI:
    """Return the application: each tab of the design page has a design of its own, all of the bench page the same bench.

    Parameters
    ----------
    settings
        What was named at the start.
    formulas
        That compute for all pages.
    start
        Scene with which the design page begins.
    name
        Name of the file on the pages.
    evaluators
        With which a design can be checked, the default first.
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
        Page(settings, formulas, start, name, evaluators)

    # files are not packed: for the loopback that takes longer than it saves
    ui.run_with(application, show_welcome_message=False, tailwind=False, dark=None, reconnect_timeout=RECONNECT_S,
                gzip_middleware_factory=None)  # fmt: skip
    return application


class Page:
    """One tab."""

    def __init__(self, settings: BenchSettings, formulas: Formulas, start: Scene, name: str, evaluators: Sequence[str]) -> None:
        self.session, self.name, self.formulas, self.evaluators = Session(start), name, formulas, evaluators
        self.min_wall = None if settings.design is None else settings.design.limits.wall
        self.work = LongWork(self.session, settings.design, self._show_outputs, self.request_update)
        self.kept: dict[str, tuple[dict[str, str], dict[str, Reading]]] = {}
        self._warnings: list[str] = []
        self._accidents = len(formulas.accidents)  # before the last change
        self._drawn: Scene | None = None
        self.readings: dict[str, Reading] = {}
        self._pending, self._is_updating, self._is_quiet, self._drawings = False, False, False, 0
        self._gap_task: asyncio.Task[None] | None = None  # held, as a loop drops tasks that nobody holds
        self.client: Client = context.client
        self.client.on_delete(self.work.worker.cancel)
        self.client.on_delete(self._cancel_gap)
        ui.add_css((FOLDER / "explorer.css").read_text())
        ui.add_body_html(f"<script>{(FOLDER / 'explorer.js').read_text()}</script>")
        ui.on("explorer_move", self._move_tumour)
        ui.on("explorer_edge", self._move_edge)
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
                ("Dark/light", lambda: dark.set_value(not dark.value)),
            )
            for text, act in actions:
                ui.button(text, on_click=act).props("dense flat no-caps")
            self.work.build_downloads()
        self.status = ui.html("computing", sanitize=False).props('role="status" aria-live="polite"').classes("status")
        with ui.element("div").classes("columns"):
            with ui.element("section").classes("numbers"):
                self.sliders: dict[str, ui.slider] = {}
                self.inputs: dict[str, ui.input] = {}
                for variable in self.session.variables.values():
                    self._build_variable(variable)
                self.noise = ui.input("noise of a reading, %", value=f"{100 * self.work.noise:.6g}").props("dense")
                self.noise.on("change", self._set_noise)
            with ui.element("section").classes("picture"):
                self.section = ui.html("", sanitize=False)
                self.outputs = ui.html("", sanitize=False).classes("table")
                self.limits = ui.html("", sanitize=False).classes("progress")
                self.work.build(self.evaluators)
            with ui.element("section").classes("charts"):
                with ui.element("div"):
                    ui.html("<h2>Tumours detected</h2>", sanitize=False)
                    self.map = ui.html("", sanitize=False)
                with ui.element("div"):
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
        """Move a tumour to where it was dragged: {name, x, depth}, its index and mm."""
        if (place := self._read_place(event.args)) is not None:
            index, x, depth = place
            self._change({f"inclusion[{index}].x": f"{x:.3g} mm", f"inclusion[{index}].depth": f"{depth:.3g} mm"})

    def _move_edge(self, event: events.GenericEventArguments) -> None:
        """Move an edge of the blocks to where it was dragged: {name, x, depth}, one of ``list_edges`` and mm."""
        if (place := self._read_place(event.args)) is not None:
            try:
                self._change(find_edge_changes(self.session.scene, *place))
            except ProbeError as refusal:
                self._say(str(refusal))

    def _read_place(self, message: Any) -> tuple[str, float, float] | None:
        """Return what was dragged, x and depth, mm; None, which the page then says, for another message."""
        try:
            name, x, depth = str(message["name"]), float(message["x"]), float(message["depth"])
        except (TypeError, KeyError, ValueError, OverflowError):
            self._say("A message of the page was not understood and is left out.")
            return None
        return name[:MAX_NAME_LENGTH], x, depth

    def _open_fragment(self, event: events.GenericEventArguments) -> None:
        """Show the design that the address holds."""
        self.session.settle()
        try:
            self.session.read_fragment(str(event.args))
        except ProbeError as refusal:
            self._say(f"the address is refused: {refusal}")
        self.request_update()

    def _change(self, entries: dict[str, str]) -> None:
        """Change numbers; a refusal is shown, and the last valid picture stays."""
        self._accidents = len(self.formulas.accidents)
        self.session.propose(entries)
        self.request_update()

    def _undo(self) -> None:
        self.session.settle()
        if self.session.undo():
            self.request_update()

    def _redo(self) -> None:
        self.session.settle()
        if self.session.redo():
            self.request_update()

    def _keep(self, key: str) -> None:
        """Remember the present design."""
        if self.readings:
            self.kept[key] = dict(self.session.changes), self.readings
            self._show_outputs()

    def _set_noise(self) -> None:
        """Change the noise on which the map depends."""
        try:
            text = convert_decimal_comma(str(self.noise.value)).strip().removesuffix("%")[:MAX_TEXT_LENGTH]
            self.work.noise = read_noise("noise", f"{text} %")
        except InputError as refusal:
            self._say(str(refusal))
        else:
            self.request_update()

    # Updates

    def request_update(self) -> None:
        """Compute and draw again; changes that come meanwhile are drawn together afterwards."""
        self._pending = True
        if not self._is_updating:
            self._is_updating = True
            asyncio.get_running_loop().create_task(self._update())

    def _has_newer_design(self) -> bool:
        """Return whether a change has come since the drawing began."""
        return self._pending

    async def _update(self) -> None:
        """Draw until nothing is pending: first the outputs, then map, limits and curves unless there is a newer design."""
        try:
            while self._pending:
                self._pending = False
                refusal = self.session.settle()
                scene = self.session.scene
                if refusal and scene is self._drawn:
                    self._say(refusal)
                    self._show_numbers()
                elif await self._compute_quantities(scene, refusal) and not self._pending:
                    await self._compute_charts(scene, refusal)
                    self._drawn = scene
        finally:
            self._is_updating = False

    async def _compute_quantities(self, scene: Scene, refusal: str) -> bool:
        """Compute and show the outputs; False where the formulas refuse the design."""
        try:
            self.readings = await self.formulas.compute("outputs", scene)
        except ProbeError as fault:
            self._refuse(fault)
            return False
        with self.client:
            self._show_numbers()
            self._show_outputs()
            self.section.content = draw_section(scene)
            fragment = json.dumps(f"/#{self.session.fragment}" if self.session.fragment else "/")
            ui.run_javascript(f"history.replaceState(null, '', {fragment})")
        self._say(refusal)
        return True

    async def _compute_charts(self, scene: Scene, refusal: str) -> None:
        """Compute and show map, limits of the load and curves, unless there is a newer design."""
        try:
            picture = await self.formulas.compute("map", scene, self.work.noise)
        except ProbeError as fault:
            picture = f"<p>No map: {html.escape(str(fault))}</p>"
        self._drawings += 1  # for those who wait for this drawing
        self.map.content = f'{picture}<span hidden data-drawings="{self._drawings}"></span>'
        if self._has_newer_design():
            return
        variables = list(self.session.variables.values())
        try:
            self._warnings, limits, closure = await self.formulas.compute("limits", scene, self.min_wall, variables)
            self._show_limits(limits)
            self._say(refusal)
            if not self._has_newer_design():
                varied = [variable for variable in variables if not variable.key.startswith("load.")]
                self.curves.content = await self.formulas.compute("curves", scene, varied)
            self._gap_task = asyncio.get_running_loop().create_task(self._mark_gap(scene, limits, closure))
        except ProbeError as fault:
            self._refuse(fault)

    async def _mark_gap(self, scene: Scene, limits: list[Limit], closure: float | None) -> None:
        """Mark the gap that the load closes once the design has rested; each step is one request, as others come between."""
        variable = self.session.variables.get(GAP_KEY)
        if variable is None or not closure or not scene.load.force:
            return
        await asyncio.sleep(GAP_MARK_DELAY_S)
        search = search_gap(scene, closure, variable)
        try:
            design = next(search)
            while scene is self.session.scene:
                design = search.send(await self.formulas.compute("closure", design))
        except StopIteration as end:
            if end.value is not None and scene is self.session.scene:
                self._show_limits(mark_gap(limits, end.value))
        except ProbeError:  # the formulas refuse a design with another gap, which has no mark
            pass

    def _cancel_gap(self) -> None:
        """End the search of the gap, whose page is gone."""
        if self._gap_task is not None:
            self._gap_task.cancel()

    def _refuse(self, fault: ProbeError) -> None:
        """Show why nothing was computed."""
        self._say(str(fault))
        self._show_numbers()

    def _say(self, text: str) -> None:
        """Show a refusal, or that the design is shown, with what evaluated it."""
        who = f"evaluated by {EVALUATOR}, errors at 95 %" if self.readings else "computing"
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self._warnings)
        refusal = f'<strong class="refusal">{html.escape(text)}</strong> The last valid design is shown. ' if text else ""
        accidents = [f"{accident}; another one goes on" for accident in self.formulas.accidents[self._accidents :]]
        accident = f'<strong class="refusal">{html.escape(accidents[-1])}</strong> ' if accidents else ""
        self.status.content = f"{refusal}{accident}<span>{who}</span><ul>{notes}</ul>"

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

    def _show_limits(self, limits: list[Limit]) -> None:
        """State the limits, and mark each on the sliders of the numbers with which it binds."""
        self.limits.content = "; ".join(
            f"<span{'' if limit.is_kept else ' class=refusal'}>{limit.sign}: {html.escape(limit.text)}</span>" for limit in limits
        )
        for key, slider in self.sliders.items():
            variable = self.session.variables[key]
            marks = [
                {"value": round(SLIDER_STEPS * variable.find_fraction(limit.marks[key])), "label": limit.sign}
                for limit in limits if key in limit.marks
            ]  # fmt: skip
            if marks != slider.props.get("marker-labels", []):
                slider.props["marker-labels"] = marks
                slider.update()

    def _show_outputs(self) -> None:
        """Show the outputs, beside them those that were checked and kept."""
        others = [*self.work.list_columns(), *((f"kept {key}", readings) for key, (_, readings) in self.kept.items())]
        heads = ["output", f"{EVALUATOR}, 95 %", *(head for head, _ in others)]
        rows = []
        for name, reading in self.readings.items():
            columns = [reading, *(readings.get(name) for _, readings in others)]
            cells = "".join(_write_cell(name, item, k == 0) for k, item in enumerate(columns))
            rows.append(f"<tr><th>{LABELS[name]}</th>{cells}</tr>")
        head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
        self.outputs.content = f'<table class="outputs"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'


def _write_cell(name: str, reading: Reading | None, is_present: bool) -> str:
    """Return a cell with a number, its error and its unit; the present design's is marked, and holds all digits."""
    if reading is None or reading.value is None:
        return "<td>not known</td>"
    unit, factor = UNITS.get(name, ("", 1.0))
    value, error = factor * reading.value, None if reading.error is None else factor * reading.error
    mark = f' data-output="{name}"' if is_present else ""
    return f'<td{mark} data-value="{reading.value!r}">{format_number(value, error, unit)}</td>'
