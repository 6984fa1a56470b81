"""The command `sweep`: evaluate thousands of designs, each once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from probe_design.cli.arguments import FILE_NAME, replace_limits
from probe_design.cli.output import print_json


@click.command()
@click.argument("sweep", metavar="SWEEP", type=FILE_NAME)
@click.option("-o", "--output", type=FILE_NAME, required=True, help="Folder for store, log and results.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler to run on, such as tcp://host:8786.")
@click.option("--workers", type=click.IntRange(1, 1024), help="Processes on this computer.  [default: one for each processor]")
@click.option("--time", help="Time limit of a design.  [default: the file's time_limit, or 120 s]")
@click.option("--memory", help="Memory limit of a design.  [default: the file's memory_limit, or 2 GB]")
@click.option("--retry-failed", is_flag=True, help="Evaluate designs again that failed.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def sweep(
    sweep: Path, output: Path, scheduler: str | None, workers: int | None, time: str | None, memory: str | None,
    retry_failed: bool, as_json: bool,
) -> None:  # fmt: skip
    """Evaluate every design of SWEEP, a TOML file of variables, and store each row as soon as it is computed.

    After any interruption the same command continues where it ended; no row is computed twice. A design that is refused or fails
    is stored too, with the reason. A design that a limit stopped is evaluated again under a larger limit.
    """
    from geometry.common.files import check_writable
    from probe_design.sweeps.file import read_sweep
    from probe_design.sweeps.run import sweep as run
    from probe_design.terminal.console import write_message
    from probe_design.terminal.sweep_bar import show_sweep

    parsed_sweep = read_sweep(sweep)
    parsed_sweep = replace(parsed_sweep, limits=replace_limits(parsed_sweep.limits, time=time, memory=memory))
    check_writable(output)
    with show_sweep() as progress:
        result = run(
            parsed_sweep,
            output,
            scheduler=scheduler,
            workers=workers,
            progress=progress,
            retry_failed=retry_failed,
            notice=write_message,
        )
    files = _write_files(output)
    if as_json:
        print_json(result.as_dict() | {"files": [str(file) for file in files]})
        return
    print(
        f"{result.designs} designs: {result.ok} ok, {result.refused} refused, {result.failed} failed; {result.answered} "
        "evaluated now"
    )
    write_message(f"wrote {', '.join(file.name for file in files)} to {output}")


def _write_files(folder: Path) -> list[Path]:
    """Write CSV, and Parquet and a summary page if the libraries for them are installed; return the files."""
    from geometry.common.errors import MissingLibrary
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
