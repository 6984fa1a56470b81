"""The program, as ``probe-design`` and ``python -m probe_design``: signals are listened to before all else is imported."""

import os
import sys


def main() -> None:
    """Run the command line and end the process: 0 good, 1 failure, 2 bad input, 128 + signal; never a traceback."""
    try:
        from probe_design.process.interrupts import leave, minded
    except KeyboardInterrupt:  # nobody listens yet
        print("probe-design: interrupted; nothing half-written is left", file=sys.stderr)
        sys.exit(130)
    leave(minded(_run))


def _run() -> int:
    _open_streams()
    from probe_design.process.limits import refused

    if why := refused():
        print(f"probe-design: {why}", file=sys.stderr)
        return 2
    from probe_design.cli.main import run

    return run()


def _open_streams() -> None:
    """Open standard streams that are closed: the next file would take their place, and hold what libraries print.

    What is written to standard output then fails, as it would on the closed stream; the other two are empty and silent.
    """
    for number, name, flags in ((0, "stdin", os.O_RDONLY), (1, "stdout", os.O_RDONLY), (2, "stderr", os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, flags), True)  # the least number that is free
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


if __name__ == "__main__":
    main()
