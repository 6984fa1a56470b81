"""Damaged STEP and STL files, each the surface of an inclusion."""

from __future__ import annotations

import re
import struct
import tempfile
from functools import cache
from pathlib import Path

from benchmarks.robustness.attempt import Attempt
from benchmarks.robustness.damage import Random, garble
from benchmarks.robustness.files import write_scene

VALUES = (b"0.", b"1.E+30", b"-1.", b"1.E-30", b"NaN", b"1.E+400", b"")
FLOATS = (float("nan"), float("inf"), 0.0, -0.0, 1e30, 1e-38)


def step(draw: Random, folder: Path) -> Attempt:
    """Damage a STEP file: other numbers, references or bytes, cut, lines doubled, or nested deeply."""
    content = draw.choice(steps())
    for _ in range(draw.randint(1, 3)):
        content = _step_damaged(content, draw)
    return _build_plan_attempt(content, ".step", folder)


def stl(draw: Random, folder: Path) -> Attempt:
    """Damage an STL file, binary or text: other numbers, corners moved, triangles lost or turned, or any bytes."""
    binary = draw.random() < 0.6
    content = stls()[binary]
    for _ in range(draw.randint(1, 3)):
        damage = draw.choice([_stl_damaged if binary else _step_damaged, garble])
        content = damage(content, draw)
    return _build_plan_attempt(content, draw.choice([".stl", ".STL"]), folder)


def _build_plan_attempt(content: bytes, suffix: str, folder: Path) -> Attempt:
    """Plan the scene, which reads the body, unless the limits of ``evaluate`` refuse it sooner."""
    (folder / f"body{suffix}").write_bytes(content)
    words = ("plan", write_scene(folder, {"surface": f"body{suffix}"}), "--json")
    return Attempt(words, f"a body of {len(content)} bytes", 150.0)  # the reader has 60 s, which are not the answer's


def _step_damaged(content: bytes, draw: Random) -> bytes:
    kind = draw.choices(["number", "reference", "bytes", "line", "deep"], [0.35, 0.4, 0.15, 0.05, 0.05])[0]
    if kind in ("number", "reference"):
        places = list(re.finditer(rb"-?\d+\.\d*(?:[Ee][-+]?\d+)?" if kind == "number" else rb"#\d+", content))
        if places:
            place = draw.choice(places)
            replacement = draw.choice(VALUES) if kind == "number" else draw.choice(places)[0]
            return content[: place.start()] + replacement + content[place.end() :]
    if kind == "line":
        lines = content.split(b"\n")
        lines.insert(draw.randrange(len(lines)), draw.choice(lines))
        return b"\n".join(lines)
    if kind == "deep":
        return content.replace(b"(", b"(" * draw.choice([50, 100_000]), 1)
    return garble(content, draw)


def _stl_damaged(content: bytes, draw: Random) -> bytes:
    """Change the binary file's count, or a triangle's numbers, by themselves or all alike."""
    count = (len(content) - 84) // 50
    if count < 1 or draw.random() < 0.2:
        return content[:80] + struct.pack("<I", draw.choice([0, 1, count - 1, count + 1, 2**32 - 1]) % 2**32) + content[84:]
    offset = 84 + 50 * draw.randrange(count)
    kind = draw.choice(["number", "flat", "lost", "turned", "far"])
    if kind == "lost":
        return content[:80] + struct.pack("<I", count - 1) + content[84:offset] + content[offset + 50 :]
    numbers = list(struct.unpack("<12f", content[offset : offset + 48]))
    if kind == "number":
        numbers[draw.randrange(12)] = draw.choice(FLOATS)
    elif kind == "flat":
        numbers[3:12] = numbers[3:6] * 3
    elif kind == "turned":
        numbers[3:9] = numbers[6:9] + numbers[3:6]
    else:
        numbers[3:6] = [100 * number for number in numbers[3:6]]
    return content[:offset] + struct.pack("<12f", *numbers) + content[offset + 48 :]


@cache
def steps() -> tuple[bytes, ...]:
    """STEP files of a ball, a box with rounded edges, and a cone, mm."""
    from geometry.cad.solids import load_cadquery

    cq, files = load_cadquery(), []
    cone = cq.Workplane(cq.Solid.makeCone(1, 3, 5))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.step")
        for shape in (cq.Workplane().sphere(3), cq.Workplane().box(4, 5, 6).edges("|Z").fillet(1), cone):
            cq.exporters.export(shape, str(path))
            files.append(path.read_bytes())
    return tuple(files)


@cache
def stls() -> tuple[bytes, bytes]:
    """Return a ball as STL, text and binary, mm."""
    import pyvista

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.stl")
        files = []
        for binary in (False, True):
            pyvista.Icosphere(radius=3.0, nsub=2).save(path, binary=binary)
            files.append(path.read_bytes())
    return files[0], files[1]
