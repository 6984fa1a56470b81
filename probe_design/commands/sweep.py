"""The command `sweep`: evaluate thousands of designs, each once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from geometry.common.errors import MissingLibrary
from probe_design.commands.fields import Memory, Time, replace_limits
from probe_design.commands.output import print_json
from probe_design.commands.request import Option, Request


class SweepRequest(Request):
    """Evaluate every design of SWEEP, a TOML file of variables, and store each row as soon as it is computed.

    After any interruption the same command continues where it ended; no row is computed twice. A design that is refused or fails
    is stored too, with the reason. A design that a limit stopped is evaluated again under a larger limit.
    """

    sweep: Annotated[Path, Option("File of a sweep.", is_argument=True)]
    output: Annotated[Path, Option("Folder for store, log and results.", "-o/--output")]
    scheduler: Annotated[str | None, Option("Dask scheduler to run on, such as tcp://host:8786.", metavar="ADDRESS")] = None
    workers: Annotated[
        int | None, Field(ge=1, le=1024), Option("Processes on this computer.", left_out="one for each processor")
    ] = None
    time: Annotated[Time | None, Option("Time limit of a design.", left_out="the file's time_limit, or 120 s")] = None
    memory: Annotated[Memory | None, Option("Memory limit of a design.", left_out="the file's memory_limit, or 2 GB")] = None
    retry_failed: Annotated[bool, Option("Evaluate designs again that failed.")] = False

    def run(self) -> None:
        """Evaluate the designs that have no row yet, and write the tables."""
        from geometry.common.files import check_writable
        from probe_design.sweeps.file import read_sweep
        from probe_design.sweeps.run import sweep
        from probe_design.terminal.console import write_message
        from probe_design.terminal.sweep_bar import show_sweep

        parsed_sweep = read_sweep(self.sweep)
        parsed_sweep = replace(parsed_sweep, limits=replace_limits(parsed_sweep.limits, self.time, self.memory))
        check_writable(self.output)
        with show_sweep() as progress:
            result = self.call(sweep, specification=parsed_sweep, progress=progress, notice=write_message)
        files = _write_files(self.output)
        if self.as_json:
            print_json(result.as_dict() | {"files": [str(file) for file in files]})
            return
        print(
            f"{result.designs} designs: {result.ok} ok, {result.refused} refused, {result.failed} failed; {result.answered} "
            "evaluated now"
        )
        write_message(f"wrote {', '.join(file.name for file in files)} to {self.output}")


def _write_files(folder: Path) -> list[Path]:
    """Write CSV, and Parquet and a summary page if the libraries for them are installed; return the files."""
    from probe_design.sweeps.results import write_csv, write_parquet
    from probe_design.sweeps.summary_page import write_page
    from probe_design.terminal.console import write_message

    files = [write_csv(folder, folder / "results.csv")]
    for write, name in ((write_parquet, "results.parquet"), (write_page, "summary.html")):
        try:
            files.append(write(folder, folder / name))
        except MissingLibrary as missing:
            write_message(f"without {name}: {missing}")
    return files
