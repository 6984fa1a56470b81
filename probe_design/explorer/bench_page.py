"""The bench page: live waveform and numbers of the probe, recordings, and the map of tumours after each reading."""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

from nicegui import Client, context, ui

from geometry.common.errors import InputError
from geometry.scenes.units import MM_PER_M, read_number
from probe_design.estimation.measurements import POSITION_QUANTITY
from probe_design.explorer.bench import Bench
from probe_design.explorer.bench_settings import VIRTUAL, DiscardRequest, PressRequest
from probe_design.explorer.formats import FOLDER, convert_decimal_comma, format_number

DEFAULT_SECONDS = 5.0  # of a reading: 25 periods of the built-in bench's load
MAX_SECONDS = 3600.0
MAX_HUM_RATIO = 10.0  # of the load's amplitude, from which the mains are a warning, as for `doctor`
MAP_TEXT = (
    "The tissue from above. Colour: the probability that some part of a tumour lies below. Numbers: presses in their order. "
    "Star: where to press next. Dashed circles: tumours that the virtual tissue hides."
)


class BenchPage:
    """One tab of the bench page; all tabs show the same bench."""

    def __init__(self, bench: Bench, name: str) -> None:
        self.bench, self.name = bench, name
        self.client: Client = context.client
        self.client.on_delete(bench.listen(self._hear))
        ui.add_css((FOLDER / "explorer.css").read_text())
        ui.add_body_html(f"<script>{(FOLDER / 'bench.js').read_text()}</script>")
        self._build()
        self._show_state()
        self._show_numbers()
        bench.start()

    def _build(self) -> None:
        """Build header, controls, waveform, numbers and map."""
        dark = ui.dark_mode(None)
        with ui.element("header").classes("top"):
            ui.html(f"<h1>Bench</h1><span>{html.escape(self.name)}</span>", sanitize=False)
            ui.link("Design", "/").classes("page-link")
            ui.button("Dark/light", on_click=lambda: dark.set_value(not dark.value)).props("dense flat no-caps")
        self.status = ui.html("", sanitize=False).props('role="status" aria-live="polite"').classes("status")
        with ui.element("div").classes("bench-columns"):
            with ui.element("section"):
                with ui.row().classes("controls"):
                    sources = list(self.bench.settings.sources)
                    self.source = ui.select(sources, value=sources[0], label="source").props("dense").classes("evaluator")
                    self.seconds = self._build_entry("seconds", f"{DEFAULT_SECONDS:g}")
                    self.x, self.y = self._build_entry("x, mm", "0"), self._build_entry("y, mm", "0")
                    self.blank = ui.checkbox("tumour-free tissue (baseline)")
                with ui.row().classes("controls"):
                    ui.button("Record", on_click=lambda: self._press(keep=True)).props("no-caps")
                    ui.button("Watch", on_click=lambda: self._press(keep=False)).props("no-caps outline")
                    ui.button("Stop", on_click=self.bench.stop).props("no-caps flat")
                ui.html('<p class="clipping refusal" hidden>Clipping: a channel is at the end of its range. Press less.</p>',
                        sanitize=False)  # fmt: skip
                ui.html('<canvas class="waveform" role="img" aria-label="live voltages of the films and of the force">'
                        "</canvas>", sanitize=False)  # fmt: skip
                self.numbers = ui.html("", sanitize=False)
            with ui.element("section"):
                ui.html("<h2>Where tumours lie</h2>", sanitize=False)
                self.advice = ui.html("", sanitize=False).props('role="status"')
                self.map = ui.html("", sanitize=False)
                ui.html("<h2>Readings</h2>", sanitize=False)
                self.presses = ui.html("", sanitize=False)
                self.discard = ui.button("Discard the last reading", on_click=lambda: self._request(DiscardRequest()))
                self.discard.props("dense flat no-caps").visible = False

    @staticmethod
    def _build_entry(label: str, value: str) -> ui.input:
        """Build a typed number."""
        return ui.input(label, value=value).props(f'dense aria-label="{label}"').classes("entry")

    def _press(self, keep: bool) -> None:
        """Start a reading that is kept, or shown alone."""
        source = str(self.source.value)
        try:
            seconds: float | None = read_number("seconds", convert_decimal_comma(str(self.seconds.value)), "seconds above 0")
            if not 0.1 <= (seconds or 0.0) <= MAX_SECONDS:
                raise InputError("seconds", str(self.seconds.value), f"0.1 to {MAX_SECONDS:g}")
            x, y = (
                POSITION_QUANTITY.read(key, f"{read_number(key, convert_decimal_comma(str(entry.value)), 'mm')!r} mm")
                for key, entry in (("x", self.x), ("y", self.y))
            )
        except InputError as refusal:
            self._say(str(refusal))
            return
        if source.startswith("replay:") or (not keep and source != VIRTUAL):
            seconds = None  # a recording to its end, a device until it is stopped
        self._request(PressRequest(source, seconds if keep else None, keep, (x, y), bool(self.blank.value), Path()))

    def _request(self, request: PressRequest | DiscardRequest) -> None:
        """Pass on a request, unless the bench is busy."""
        if not self.bench.request(request):
            self._say("A reading is going on, or the map is computed: wait, or press Stop.")

    def _hear(self, kind: str, content: Any) -> None:
        """Show a message of the bench."""
        if kind == "waveform":
            self.client.run_javascript(f"drawWaveform({content})")
        elif kind == "numbers":
            self._show_numbers()
        elif kind == "result":
            self._show_state()
        elif kind == "refused":
            self._say(str(content))
        elif kind == "progress":
            self.status.content = html.escape(str(content))
        elif kind == "idle" and not self.bench.status:
            self._show_ready()

    def _say(self, text: str) -> None:
        """Show a refusal."""
        self.status.content = f'<strong class="refusal">{html.escape(text)}</strong>'

    def _show_numbers(self) -> None:
        """Show the numbers of the latest samples."""
        numbers = self.bench.numbers
        if numbers is None:
            self.numbers.content = ""
            return
        charges, sds = numbers["charges"], numbers["charges_sd"]
        rows = [
            ("ratio", numbers["ratio"], numbers["ratio_uncertainty"], "", 1.0),
            ("charge inner", charges[0], sds[0], "pC", 1e12),
            ("charge outer", charges[1], sds[1], "pC", 1e12),
            ("force of both films", numbers["force"], numbers["force_uncertainty"], "mN", 1e3),
            ("force by its channel", numbers["reference_force"], None, "mN", 1e3),
        ]
        cells = "".join(_write_number(*row) for row in rows)
        hum = "none detected"
        if numbers["mains"] is not None:
            hum = f"{1e3 * numbers['hum']:.2g} mV at {numbers['mains']:.4g} Hz"
        warnings = list(numbers["warnings"])
        if numbers["mains"] is not None and numbers["hum_ratio"] > MAX_HUM_RATIO:
            warnings.insert(0, f"mains hum is {numbers['hum_ratio']:.2g} times the signal: check shields and grounding")
        if numbers["saturated"]:
            warnings.insert(0, "clipping: press less, or take a larger feedback capacitance")
        notes = "".join(f"<li>{html.escape(text)}</li>" for text in warnings)
        self.numbers.content = (
            f'<table class="outputs"><tbody>{cells}<tr><th>load</th><td>{numbers["frequency"]:.4g} Hz, {numbers["cycles"]:.3g} '
            f"cycles</td></tr><tr><th>mains hum</th><td>{hum}</td></tr></tbody></table><ul>{notes}</ul>"
            "<p>± is one standard deviation; among the readings that of pressing counts, too.</p>"
        )

    def _show_state(self) -> None:
        """Show readings, map and the next place."""
        state = self.bench.state
        if state is None:
            self.status.content = html.escape(self.bench.status or "preparing")
            return
        if self.bench.settings.design is None:
            self.advice.content = "<p>No map: start the command with a design file, which says what tumours to expect.</p>"
        else:
            self._show_map(state)
        rows = "".join(_write_press(press) for press in state["presses"])
        head = "<tr><th>press</th><th>place</th><th>ratio</th><th>recording</th></tr>"
        self.discard.visible = bool(state["presses"])
        self.presses.content = f'<table class="outputs"><thead>{head}</thead><tbody>{rows}</tbody></table>'
        self._show_ready()

    def _show_ready(self) -> None:
        """State how many readings there are, and where they are kept."""
        count = len((self.bench.state or {"presses": []})["presses"])
        where = f"in {self.bench.folder}" if self.bench.settings.folder else "until the command ends; -o DIR keeps them"
        self.status.content = html.escape(f"ready; {count} readings; recordings are kept {where}")

    def _show_map(self, state: dict[str, Any]) -> None:
        """Show the map, and where to press next, which is filled in."""
        (x, y), none = state["next"], state["probability"][0]
        self.x.value, self.y.value, self.blank.value = f"{MM_PER_M * x:.4g}", f"{MM_PER_M * y:.4g}", state["blank"]
        place = "over tumour-free tissue, for the baseline reading" if state["blank"] else _format_place(x, y)
        text = f"You may stop: {state['stop']}. Else press next" if state["stop"] else "Press next"
        self.advice.content = (
            f'<p>Probability of no tumour: <b data-bench="none" data-value="{none!r}">{none:.2g}</b>. '
            f'{html.escape(text)} <b data-bench="next" data-value="{html.escape(json.dumps([x, y]))}">{place}</b>.</p>'
        )
        picture = base64.b64encode(state["map"]).decode()
        self.map.content = (
            f'<img class="plan" data-presses="{len(state["presses"])}" alt="probability of a tumour below each point" '
            f'src="data:image/png;base64,{picture}"><p class="progress">{MAP_TEXT}</p>'
        )


def _format_place(x: float, y: float) -> str:
    """Return a place as a text."""
    return f"x = {MM_PER_M * x:.1f} mm, y = {MM_PER_M * y:.1f} mm"


def _write_number(name: str, value: float | None, sd: float | None, unit: str, factor: float) -> str:
    """Return the row of a number with its standard deviation, both SI; ``factor`` converts them to the unit."""
    text = "not known"
    if value is not None:
        text = format_number(factor * value, None if sd is None else factor * sd, unit)
    return f'<tr><th>{name}</th><td data-bench="{name}" data-value="{value!r}">{text}</td></tr>'


def _write_press(press: dict[str, Any]) -> str:
    """Return the row of a reading."""
    place = "baseline" if press["blank"] else _format_place(press["x"], press["y"])
    ratio = format_number(press["ratio"], press["ratio"] * press["noise"])
    return (
        f'<tr><th>{press["number"]}</th><td>{place}</td><td data-reading="{press["number"]}" data-value="{press["ratio"]!r}">'
        f"{ratio}</td><td>{html.escape(Path(press['file']).name)}</td></tr>"
    )
