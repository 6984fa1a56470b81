"""The command `explore`: local pages for the design of a probe and for its bench."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from geometry.common.errors import InputError, MissingLibrary, Words
from geometry.common.files import check_writable
from probe_design.commands.evaluate import EVALUATOR_NAMES
from probe_design.commands.fields import Calibration
from probe_design.commands.request import Option, Request

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene
    from probe_design.explorer.bench_settings import BenchSettings
    from probe_design.explorer.formulas import Formulas
    from probe_design.populations.design_file import Design


class ExploreRequest(Request):
    """Open local pages: a slider for each number of the design, and the bench with live readings and the map of tumours.

    The pages are served on this computer alone. The first line of output is the address, with a token that the browser exchanges
    for a cookie. Ctrl-C ends the command. The numbers are those of `evaluate --evaluator closed-form`, with their errors; Check
    evaluates the design by another evaluator. Without a file, the built-in design is shown. Needs the extra explore:
    pip install '.[explore]'.

    The bench page reads a virtual probe, and the device and recordings named here. With a DESIGN file it locates tumours after
    each reading, as `survey` does. -o DIR keeps every recording and the readings; a device needs it.

    \b
    probe-design explore examples/scene.toml
    probe-design explore examples/scans/one-clear.toml --hide examples/scans/hidden.toml -o out
    probe-design explore DESIGN.toml --device usb --calibration probe.toml -o out
    probe-design explore --port 8000 --no-browser
    """  # noqa: D301

    scene: Annotated[Path | None, Option("File of a scene or design.", is_argument=True, metavar="[SCENE | DESIGN]")] = None
    port: Annotated[int, Field(ge=0, le=65535), Option("Port of 127.0.0.1; 0: any that is free.")] = 0
    no_browser: Annotated[bool, Option("Print the address, and open no browser.")] = False
    output: Annotated[
        Path | None, Option("Folder for recordings, readings and maps.", "-o/--output", left_out="a temporary one")
    ] = None
    device: Annotated[str | None, Option("Probe of the bench page: usb, usb:SERIAL, serial:PORT or visa:RESOURCE.")] = None
    replay: Annotated[tuple[Path, ...], Option("Recording that the bench page may read; may be repeated.")] = ()
    column: Annotated[tuple[str, ...], Option("Columns of such a file, or channels of an oscilloscope, as for `read`.")] = ()
    rate: Annotated[str | None, Option("Samples per second of a device, or of a file without times, '10 kHz'.")] = None
    bench: Annotated[Path | None, Option("TOML file of load, amplifier and references.")] = None
    calibration: Calibration = None
    hide: Annotated[
        Path | None, Option("File of the tumours that the virtual tissue holds.", left_out="drawn from the population by --seed")
    ] = None
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), Option("Seed of the virtual tissue and of the map.")] = 0

    def run(self) -> None:
        """Read the files, and serve the pages until Ctrl-C."""
        from probe_design.explorer.formulas import Formulas

        if self.device is not None and self.output is None:
            raise InputError("output", Words("missing"), "-o DIR beside --device: recordings of a probe are always kept")
        with Formulas() as formulas:  # which load meanwhile
            self._serve(formulas)

    def _serve(self, formulas: Formulas) -> None:
        """Read the files, and serve the pages until Ctrl-C."""
        from probe_design.explorer.quick_nicegui import hide_libraries
        from probe_design.explorer.server import announce, serve
        from probe_design.populations.design_file import Design, read_design_source

        source = read_design_source(self.scene)
        design = source if isinstance(source, Design) else None
        settings = self._build_settings(source.scene if isinstance(source, Design) else source, design)
        if missing := [name for name in ("nicegui", "fastapi", "uvicorn") if find_spec(name) is None]:
            raise MissingLibrary(f"{missing[0]} is not installed: pip install '.[explore]' brings it")
        start, name = settings.scene, "built-in design" if self.scene is None else self.scene.name
        if design is not None and not start.inclusion:
            from probe_design.design_search.population_study import build_middle_scene

            start = build_middle_scene(design)  # without a tumour, sensitivity and map would have no meaning
        with announce(self.port, not self.no_browser) as (listener, token):
            with hide_libraries():
                from probe_design.explorer.page import build_application

            serve(build_application(settings, formulas, start, name, EVALUATOR_NAMES), listener, token)

    def _build_settings(self, scene: Scene, design: Design | None) -> BenchSettings:
        """Return what was named at the start. Raises ``InputError`` where it is not allowed."""
        from hw.files.columns import ColumnMap, read_rate
        from probe_design.built_probe.bench import read_builtin_bench
        from probe_design.built_probe.hidden_tumours import read_hidden_tumours
        from probe_design.explorer.bench_settings import BenchSettings

        bench, calibration = read_builtin_bench(), None
        if self.bench is not None or self.calibration is not None:
            from probe_design.commands.hardware_sources import HardwareSetup
            from probe_design.commands.scan_recordings import use_calibration

            setup = HardwareSetup.from_scene(scene, self.bench, self.calibration)
            bench, calibration = setup.bench, setup.calibration
            design = None if design is None else use_calibration(design, self.calibration)
        for path in self.replay:
            if not path.is_file():
                raise InputError("replay", str(path), "a file that is there")
        if self.output is not None:
            check_writable(self.output)
        return BenchSettings(
            scene,
            bench,
            design,
            calibration,
            device=self.device,
            recordings=self.replay,
            rate=None if self.rate is None else read_rate(self.rate),
            columns=ColumnMap.from_texts(self.column),
            hidden=None if self.hide is None else read_hidden_tumours(self.hide, scene),
            seed=self.seed,
            folder=self.output,
        )
