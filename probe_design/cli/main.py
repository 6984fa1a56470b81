"""The command line: arguments in, one table or one JSON object out, one line for every refusal."""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from probe_design.cli.design import export, optimize
from probe_design.cli.estimate import estimate
from probe_design.cli.evaluate import curve, evaluate
from probe_design.cli.hardware import calibrate, check, read
from probe_design.cli.maps import detectability, scan
from probe_design.cli.plan import plan
from probe_design.cli.sweep import sweep
from probe_design.cli.tradeoff import tradeoff

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Verbs(click.Group):
    """The verbs; one that does not exist is refused with those that do."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Look a verb up."""
        verb = args[0]
        if verb in self.commands:
            return super().resolve_command(ctx, args)
        raise click.UsageError(f"verb = {verb!r}: allowed: {', '.join(self.commands)}")


@click.group(cls=Verbs, context_settings=CONTEXT)
@click.version_option(package_name="probe-design")
def cli() -> None:
    """Design, check and export tactile palpation probes.

    A scene file (TOML) says which probe is pressed on which tissue; README shows one.
    """


VERBS = (evaluate, plan, curve, scan, detectability, estimate, optimize, export, tradeoff, sweep, read, calibrate, check)
for verb in VERBS:
    cli.add_command(verb)


def main() -> None:
    """Run the program: 0 good, 1 failure, 2 bad input, 130 interrupted; never a traceback."""
    sys.exit(_run())


def _run() -> int:
    try:
        code = cli.main(prog_name="probe-design", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.NoArgsIsHelpError as help_page:
        click.echo(help_page.format_message())
        return 0
    except click.ClickException as refused:
        return _fail(refused.format_message(), 2)
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted; nothing half-written is left", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains again on the way out
        return 1
    except OSError as fault:
        return _fail(f"{fault.filename or 'output'}: {fault.strerror or fault}", 1)
    except MemoryError:
        less = "a coarser --accuracy, fewer inclusions, points or designs"
        return _fail(f"memory = all that the system gives this process: allowed: more, or a question that takes less: {less}", 2)
    except Exception as fault:  # the toolkit's own errors, and the last line of defence of "never a traceback"
        return _explained(fault)


def _explained(fault: Exception) -> int:
    from geometry.common.errors import ProbeError  # costs 0.2 s, which --help need not pay
    from hw.common.errors import HardwareError

    if isinstance(fault, ProbeError | HardwareError):
        return _fail(str(fault), fault.exit_code)
    if os.environ.get("PROBE_DESIGN_DEBUG"):
        raise fault
    return _fail(f"a defect of the program: {type(fault).__name__}: {str(fault)[:200]}; PROBE_DESIGN_DEBUG=1 shows where", 1)


def _fail(text: str, code: int) -> int:
    print("probe-design:", *text.split(), file=sys.stderr)
    return code
