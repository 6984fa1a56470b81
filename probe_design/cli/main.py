"""The command line: each command prints one table or one JSON object, and one line for a refusal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from probe_design.cli.arguments import NamedCommands
from probe_design.cli.catalogue import material, tissue
from probe_design.cli.estimate import estimate
from probe_design.cli.evaluate import curve, evaluate, plan, tolerances
from probe_design.cli.export import export
from probe_design.cli.hardware import calibrate, check, doctor, read
from probe_design.cli.load import load
from probe_design.cli.maps import detectability, scan
from probe_design.cli.optimize import optimize
from probe_design.cli.output import record_command_line
from probe_design.cli.rerun import rerun
from probe_design.cli.sweep import sweep
from probe_design.cli.tradeoff import tradeoff
from probe_design.process import interrupts

CONTEXT_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Interrupted(Exception):  # noqa: N818 - it is no error
    """Ctrl-C as an exception that click passes on unchanged; for a KeyboardInterrupt click prints an empty line."""


@contextmanager
def pass_interrupts_on() -> Iterator[None]:
    """Convert a KeyboardInterrupt to ``Interrupted``, which click passes on."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise Interrupted from interrupt


class MainGroup(NamedCommands):
    """The group of all commands."""

    @pass_interrupts_on()
    def make_context(self, *words: Any, **extra: Any) -> click.Context:
        """Parse the command line."""
        return super().make_context(*words, **extra)

    @pass_interrupts_on()
    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        return super().invoke(ctx)


@click.group(cls=MainGroup, context_settings=CONTEXT_SETTINGS)
@click.version_option(package_name="probe-design")
def cli() -> None:
    """Design, check and export tactile palpation probes.

    A scene file (TOML) describes a probe and the tissue that it is pressed on; README shows one.
    """


COMMANDS = (
    evaluate, plan, curve, load, scan, detectability, estimate, optimize, export, tradeoff, sweep, tissue, material, tolerances,
    read, calibrate, check, doctor, rerun,
)  # fmt: skip
for command in COMMANDS:
    cli.add_command(record_command_line(command))


def main() -> None:
    """Run the command line inside another program, which keeps its signal handlers; compare ``probe_design.__main__``."""
    sys.exit(run())


def run() -> int:
    """Run the command of the command line, and return the exit code; never print a traceback."""
    try:
        code = cli.main(prog_name="probe-design", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()  # a failure to write is reported here, not by Python while it exits
        return code if isinstance(code, int) else 0
    except click.exceptions.NoArgsIsHelpError as help_page:
        click.echo(help_page.format_message())
        return 0
    except BaseException as fault:
        # libraries may convert an interrupt to any other exception
        if isinstance(fault, KeyboardInterrupt | Interrupted | click.Abort) or interrupts.has_signal():
            return interrupts.report_end()
        return _report_fault(fault)


def _report_fault(fault: BaseException) -> int:
    """Print one line about an exception, and return the exit code; an unexpected one is reported as a defect."""
    if isinstance(fault, SystemExit):
        return int(fault.code or 0)
    if isinstance(fault, click.ClickException):
        return _fail(fault.format_message(), 2)
    if isinstance(fault, BrokenPipeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # otherwise Python prints another message while it exits
        return 1
    if isinstance(fault, OSError):
        return _fail(f"{fault.filename or 'output'}: {fault.strerror or fault}", 1)
    if isinstance(fault, MemoryError):
        smaller_requests = "a coarser --accuracy, fewer inclusions, points or designs"
        return _fail(
            f"memory = all that the system gives this process: allowed: more, or a question that takes less: {smaller_requests}",
            2,
        )
    from geometry.common.errors import ProbeError  # takes 0.2 s, which --help does not need
    from hw.common.errors import HardwareError

    if isinstance(fault, ProbeError | HardwareError):
        return _fail(str(fault), fault.exit_code)
    if os.environ.get("PROBE_DESIGN_DEBUG"):
        raise fault
    return _fail(f"a defect of the program: {type(fault).__name__}: {str(fault)[:200]}; PROBE_DESIGN_DEBUG=1 shows where", 1)


def _fail(text: str, code: int) -> int:
    """Print one line to standard error, and return the exit code."""
    from geometry.common.errors import to_one_line

    print("probe-design:", to_one_line(text), file=sys.stderr)
    return code
