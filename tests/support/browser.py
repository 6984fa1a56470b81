"""Pages in a real browser: headless Chromium."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# drawn by the processor; no network: every host is one that does not exist
FLAGS = (
    "--headless", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr", "--virtual-time-budget=5000",
    "--allow-file-access-from-files", "--window-size=1400,1000", "--dump-dom",
)  # fmt: skip


# the page stands in a frame of the width that is asked for: a headless window is no narrower than 500 pixels
FRAME = """<!doctype html><iframe src="{page}" style="width: {width}px; height: 900px; border: 0"></iframe><script>
onload = () => {{
  const frame = document.querySelector("iframe"), page = frame.contentDocument, wide = frame.contentWindow.innerWidth;
  const told = document.documentElement.dataset, free = (one) => !one.closest("div.wide");
  told.width = wide;
  told.scroll = page.documentElement.scrollWidth;
  told.clipped = [...page.body.querySelectorAll("*")].filter((one) => free(one) && one.getBoundingClientRect().right > wide + 0.5)
    .map((one) => one.tagName).join(" ");
  told.scrolled = [...page.querySelectorAll("div.wide, pre")].filter((one) => one.scrollWidth > one.clientWidth).length;
  told.reached = page.querySelectorAll("div.wide[tabindex]").length;
  told.drawn = [...page.querySelectorAll("canvas")].map((one) => one.dataset.drawn).join(" ");
  told.broken = [...page.images].filter((one) => !one.complete || !one.naturalWidth).length;
  told.tables = page.querySelectorAll("table").length;
  told.buttons = page.querySelectorAll("button.copy").length;
}};
</script>"""


@dataclass(frozen=True)
class Shown:
    """A page as a browser has it.

    Attributes
    ----------
    told
        What is measured of it, by name; see ``FRAME``.
    console
        What its scripts, or the browser about them, have said.
    """

    attributes: dict[str, str]
    console: list[str]


def find_browser() -> str:
    """Return the program, or skip the test where there is none."""
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium")
    return program


def darkened(page: Path, folder: Path) -> Path:
    """Return a picture of a page's top in a browser that is set to dark, and darkens pages that do not forbid it."""
    picture = folder / "dark.png"
    command = [
        find_browser(), *FLAGS[:-1], f"--user-data-dir={folder / 'profile'}", "--enable-features=WebContentsForceDark",
        "--blink-settings=preferredColorScheme=0", f"--screenshot={picture}", page.as_uri(),
    ]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    return picture


def shown(page: Path, width: int, folder: Path) -> Shown:
    """Show a page at a width, pixels; skips the test where there is no browser. ``folder`` is for the browser's own files."""
    (folder / "frame.html").write_text(FRAME.format(page=page.as_uri(), width=width))
    command = [find_browser(), *FLAGS, f"--user-data-dir={folder / 'profile'}", (folder / "frame.html").as_uri()]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stderr[-2000:]
    attributes = dict(re.findall(r'data-(\w+)="([^"]*)"', re.findall(r"<html[^>]*>", ended.stdout)[0]))
    return Shown(attributes, [line for line in ended.stderr.splitlines() if "CONSOLE" in line])
