"""The command `explore`: a local page on which a designer sees what each dimension does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from geometry.common.errors import MissingLibrary
from probe_design.commands.request import Option, Request


class ExploreRequest(Request):
    """Open a local page with a slider for each dimension, modulus and load, and at once what the probe would do.

    The page is served on this computer alone. The first line of output is its address, with a token that the browser exchanges
    for a cookie. Ctrl-C ends it. The numbers are those of `evaluate --evaluator closed-form`, with their errors; Check evaluates
    the design by another evaluator. Without a file, the built-in design is shown. Needs the extra explore:
    pip install 'probe-design[explore]'.

    \b
    probe-design explore examples/scene.toml
    probe-design explore --port 8000 --no-browser
    """  # noqa: D301

    scene: Annotated[Path | None, Option("File of a scene or design.", is_argument=True, metavar="[SCENE | DESIGN]")] = None
    port: Annotated[int, Field(ge=0, le=65535), Option("Port of 127.0.0.1; 0: any that is free.")] = 0
    no_browser: Annotated[bool, Option("Print the address, and open no browser.")] = False

    def run(self) -> None:
        """Read the file, and serve the page until Ctrl-C."""
        from probe_design.populations.design_file import Design, read_design_source

        source = read_design_source(self.scene)
        start = source.scene if isinstance(source, Design) else source
        try:
            from probe_design.explorer.page import build_application
            from probe_design.explorer.server import serve
        except ImportError as fault:
            raise MissingLibrary(f"{fault.name} is not installed: pip install 'probe-design[explore]' brings it") from None
        name = "built-in design" if self.scene is None else self.scene.name
        serve(build_application(start, name), self.port, not self.no_browser)
