"""Check that a signal at any moment ends the program with one line, its exit code and no partial files.

python -m benchmarks.evaluators.interrupts --tries 20 --seed 0

For each command so many signals are sent, half of them Ctrl-C, the others SIGTERM and SIGHUP, at random moments between the
program's first instruction and its end. A run that had finished may keep its own exit code and files.

Duration: half an hour.
"""

from __future__ import annotations

import argparse

from tests.support.interrupted import Leftovers, left, moments
from tests.support.paths import EXAMPLES, REFERENCE

SCENE, TWO_TUMOURS, GROOVE = (
    str(path) for path in (EXAMPLES / "scene.toml", EXAMPLES / "two-tumours.toml", REFERENCE / "solid/groove-on-axis.toml")
)
SWEEP = str(EXAMPLES / "sweep.toml")
COMMAND_LINES = {
    "help": ("--help",),
    "evaluate": ("evaluate", SCENE, "--json"),
    "evaluate, a table": ("evaluate", SCENE, "--evaluator", "closed-form"),
    "plan": ("plan", TWO_TUMOURS),
    "curve": ("curve", SCENE, "--points", "9", "--plot", "OUT/curve.png"),
    "scan": ("scan", TWO_TUMOURS, "--points", "3", "--plot", "OUT/scan.png"),
    "detectability": ("detectability", SCENE, "--points", "4", "--plot", "OUT/map.png"),
    "estimate": ("estimate", SCENE, "--ratio", "0.563", "--noise", "0.01"),
    "export": ("export", SCENE, "-o", "OUT"),
    "optimize": ("optimize", SCENE, "--starts", "1", "-o", "OUT"),
    "tradeoff": ("tradeoff", SCENE, "-o", "OUT"),
    "sweep": ("sweep", SWEEP, "--workers", "1", "-o", "OUT"),
    "read": ("read", SCENE, "--virtual", "--seconds", "3"),
    "calibrate": ("calibrate", SCENE, "--virtual", "-o", "OUT/probe.toml"),
    "load": ("load", SCENE, "--to", "10 mN", "--points", "2", "--plot", "OUT/load.png"),
    "tolerances": ("tolerances", SCENE, "--plot", "OUT/budget.png"),
    "next reading": ("estimate", SCENE, "--ratio", "0.563", "--noise", "0.01", "--next"),
    "check": ("check", SCENE, "--virtual", "--seconds", "5", "-o", "OUT/check.json", "--report", "OUT/check.html"),
    "doctor": ("doctor", "--virtual", "--seconds", "2"),
    "a recording": ("read", SCENE, "--virtual", "--seconds", "3", "--record", "OUT/run.probe"),
    "optimize a design": ("optimize", "-o", "OUT", "--json"),
    "solid": ("evaluate", GROOVE, "--evaluator", "solid", "--accuracy", "0.05"),
}


def main() -> None:
    """Interrupt, check, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=20, help="for each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=f"of {', '.join(COMMAND_LINES)}; all without")
    options = parser.parse_args()
    print("| command | tries | interrupted | finished | wrong | longest wait, s |\n|---|---|---|---|---|---|", flush=True)
    for command in options.commands or COMMAND_LINES:
        print(row(command, options.tries, options.seed), flush=True)


def row(command: str, tries: int, seed: int) -> str:
    """Interrupt one command, and return the table's line."""
    whole = left(COMMAND_LINES[command])
    ended: list[tuple[float, int, Leftovers]] = []
    for delay, number in moments(whole.seconds, tries, [seed, *command.encode()]):
        ended.append((delay, number, left(COMMAND_LINES[command], delay, number)))
    faults = [
        (delay, number, reason) for delay, number, interrupted_run in ended if (reason := interrupted_run.wrong(number, whole))
    ]
    for delay, number, reason in faults:
        print(f"{command}, signal {number} after {delay:.3f} s of {whole.seconds:.3f}: {reason}")
    interrupted = sum(interrupted_run.code == 128 + number for _, number, interrupted_run in ended)
    waits = [interrupted_run.seconds - delay for delay, number, interrupted_run in ended if interrupted_run.code == 128 + number]
    return f"| {command} | {tries} | {interrupted} | {tries - interrupted} | {len(faults)} | {max(waits, default=0):.1f} |"


if __name__ == "__main__":
    main()
