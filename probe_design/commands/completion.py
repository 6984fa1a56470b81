"""Install what makes a shell complete commands, options and their values at the Tab key."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from geometry.common.errors import InputError, Words
from geometry.common.files import write_text

PROGRAM, VARIABLE = "probe-design", "_PROBE_DESIGN_COMPLETE"  # the variable is the one that click reads
SHELLS = ("bash", "fish", "zsh")


def install_completion(group: click.Group, shell: str) -> str:
    """Write the completion of a shell to the user's folder where the shell looks for it.

    bash and fish load it by its name at the first Tab; for zsh one line is added to .zshrc, once.

    Parameters
    ----------
    group
        The commands.
    shell
        "bash", "fish" or "zsh"; "" for the shell in the environment's SHELL.

    Returns
    -------
    str
        What was written, and what to do next.

    Raises
    ------
    InputError
        The shell is none of these.
    """
    name = shell or Path(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        raise InputError("install-completion", name or Words("an unknown shell"), f"one of {', '.join(SHELLS)}")
    if name == "zsh":
        return _extend_zshrc()
    config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "fish/completions" / f"{PROGRAM}.fish"
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share") / "bash-completion/completions" / PROGRAM
    completion_class = get_completion_class(name)
    assert completion_class is not None
    path = config if name == "fish" else data
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, completion_class(group, {}, PROGRAM, VARIABLE).source())
    return f"wrote {path}; begin a new {name} to use it"


def _extend_zshrc() -> str:
    """Add the line that loads the completion to .zshrc, unless it is there."""
    path, line = Path(os.environ.get("ZDOTDIR") or Path.home()) / ".zshrc", f'eval "$({VARIABLE}=zsh_source {PROGRAM})"'
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    if line in text.splitlines():
        return f"{path} loads the completion already"
    with path.open("a", encoding="utf-8") as file:  # appended, so that a link to the user's own file stays one
        file.write(f"\n{line}\n")
    return f"added a line to {path}; begin a new zsh to use it"
