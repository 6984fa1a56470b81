"""Entry point of ``probe-design`` and ``python -m probe_design``. Signal handlers are installed before other imports."""

import os
import sys


def main() -> None:
    """Run the command line and exit: 0 success, 1 failure, 2 bad input, 128 + signal number; never a traceback."""
    try:
        from probe_design.process.interrupts import leave, run_interruptible
    except KeyboardInterrupt:  # no handler is installed yet
        print("probe-design: interrupted; nothing half-written is left", file=sys.stderr)
        sys.exit(130)
    leave(run_interruptible(_run))


def _run() -> int:
    _open_streams()
    from probe_design.process.system_limits import explain_refusal

    if reason := explain_refusal():
        print(f"probe-design: {reason}", file=sys.stderr)
        return 2
    from probe_design.commands.main import run

    return run()


def _open_streams() -> None:
    """Open standard streams that are closed, as the next file opened would take their number and receive printed text.

    Writing to standard output then fails, as on the closed stream. Standard input is empty; standard error discards its text.
    """
    for number, name, flags in ((0, "stdin", os.O_RDONLY), (1, "stdout", os.O_RDONLY), (2, "stderr", os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, flags), True)  # opens at the lowest free number, which is this one
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


if __name__ == "__main__":
    main()
