"""The command `rerun`: check whether the numbers of a file can be reproduced."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from probe_design.commands.output import print_json
from probe_design.commands.request import Option, Request


class RerunRequest(Request):
    """Repeat the command that made FILE, and report whether its numbers still agree.

    FILE is the output of --json, an optimum's design.toml, a report, or the folder of optimize, sweep, tradeoff or export. Its
    block of provenance names the command and the scene. The scene's file must be present, unchanged, in the current folder or in
    that of FILE. Two numbers agree within the error estimates of both, or without these to 1 part in a million; seconds and
    versions are not compared.

    The exit code is 0 where all agree, 1 where one differs, 2 where FILE has no block of provenance.
    """

    file: Annotated[Path, Option("File, or folder of files.", is_argument=True)]

    def run(self) -> None:
        """Repeat the command, and exit with 1 where a number differs."""
        from probe_design.commands.main import cli
        from probe_design.repetition.rerun import rerun
        from probe_design.terminal.console import warn, write_message

        result = rerun(self.file, cli)
        if self.as_json:
            print_json(result.as_dict())
        else:
            for difference in result.differences:
                print(difference)
            print(f"{result.numbers} values compared: {'all agree' if result.agrees else f'{len(result.differences)} differ'}")
            warn(result.warnings)
        write_message(f"made by: {shlex.join(['probe-design', *result.command])}")
        if not result.agrees:
            raise SystemExit(1)
