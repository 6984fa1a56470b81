"""The command line: each command prints one table or one JSON object, and one line for a refusal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from probe_design.commands.names import COMMANDS, GROUP_HELP
from probe_design.process import interrupts

CONTEXT_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Interrupted(Exception):  # noqa: N818 - it is no error
    """An interrupt (Ctrl-C) as an exception that click passes on unchanged; at a KeyboardInterrupt click prints a line."""


@contextmanager
def pass_interrupts_on() -> Iterator[None]:
    """Convert a KeyboardInterrupt to ``Interrupted``, which click passes on."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise Interrupted from interrupt


class CommandGroup(click.Group):
    """A group whose commands are imported when they are used. An unknown command is refused with the list of known ones."""

    def __init__(self, prefix: str = "", **options: Any) -> None:
        """Keep ``prefix``, the words before the commands' names in ``COMMANDS``, such as "tissue "; pass ``options`` to click."""
        super().__init__(**options)
        self._prefix = prefix

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in their order in the help text."""
        names = (name.removeprefix(self._prefix) for name in COMMANDS if name.startswith(self._prefix))
        return [name for name in names if name and " " not in name]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a name, built from its request at the first call, or None if there is no such command."""
        full_name = f"{self._prefix}{cmd_name}"
        if cmd_name not in self.list_commands(ctx):
            return None
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        command = COMMANDS[full_name]
        if command.request:
            from probe_design.commands.options import build_command

            self.commands[cmd_name] = build_command(cmd_name, command.load_request(), command.summary)
        else:
            self.commands[cmd_name] = CommandGroup(
                f"{full_name} ", name=cmd_name, help=GROUP_HELP[full_name], short_help=command.summary
            )
        return self.commands[cmd_name]

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find a command by its name, or raise a usage error that lists the known commands."""
        if self.get_command(ctx, args[0]) is not None:
            return super().resolve_command(ctx, args)
        kind = "command" if ctx.parent is None else ctx.info_name
        from geometry.common.errors import describe_choices

        raise click.UsageError(f"{kind} = {args[0]!r}: allowed: {describe_choices(args[0], self.list_commands(ctx))}")

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands under the headings of their groups, one line each."""
        names = self.list_commands(ctx)
        for group in dict.fromkeys(COMMANDS[f"{self._prefix}{name}"].group for name in names):
            rows = [(name, COMMANDS[f"{self._prefix}{name}"]) for name in names]
            width = max(map(len, names))
            with formatter.section(group or "Commands"):
                formatter.write_dl([(name.ljust(width), row.summary) for name, row in rows if row.group == group])


class MainGroup(CommandGroup):
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
@click.version_option(package_name="palpation-probe-design")  # geometry.provenance.block has the name, too
@click.option(
    "--install-completion",
    is_flag=False,
    flag_value="",
    metavar="[SHELL]",
    expose_value=False,
    is_eager=True,
    callback=lambda context, _, shell: _install_completion(context, shell),
    help="Complete commands at the Tab key in bash, fish or zsh.",
)
def cli() -> None:
    """Design, check and export tactile palpation probes.

    A scene file (TOML) describes a probe and the tissue that it is pressed on; README shows one.
    """


def _install_completion(context: click.Context, shell: str | None) -> None:
    """Install the completion of a shell and exit, where the option was given."""
    if shell is None or context.resilient_parsing:
        return
    from probe_design.commands.completion import install_completion

    click.echo(install_completion(cli, shell))
    context.exit()


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
    """Print one line about an exception, and return the exit code; an unexpected exception is reported as a defect."""
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
    from geometry.common.errors import ProbeError  # imported only here: it takes 0.2 s, which --help does not need
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
