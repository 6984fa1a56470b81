"""Whether a damaged STEP file ends the program: bodies mutated byte by byte, each read as an inclusion's surface.

python -m benchmarks.levels.damaged_bodies --files 60 --seed 0
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from geometry.cad.solids import cadquery
from geometry.common.errors import InputError
from geometry.tetra.surface_files import read_surface


def bodies() -> list[bytes]:
    """STEP files of a ball, a box with a rounded edge, and a cone."""
    cq, files = cadquery(), []
    shapes = [
        cq.Workplane().sphere(4),
        cq.Workplane().box(4, 5, 6).edges("|Z").fillet(1),
        cq.Workplane(cq.Solid.makeCone(1, 3, 5)),
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.step")
        for shape in shapes:
            cq.exporters.export(shape, str(path))
            files.append(path.read_bytes())
    return files


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Change numbers, references and bytes, cut, or double lines."""
    for _ in range(random.integers(1, 4)):
        kind = random.choice(5, p=[0.35, 0.5, 0.08, 0.02, 0.05])
        if kind == 0:
            places = list(re.finditer(rb"-?\d+\.\d*(?:E[-+]?\d+)?", content))
            one = places[random.integers(len(places))]
            value = [b"0.", b"1.E+30", b"-1.", b"1.E-30", b"NaN"][random.integers(5)]
            content = content[: one.start()] + value + content[one.end() :]
        elif kind == 1:
            places = list(re.finditer(rb"#\d+", content))
            one, other = (places[k] for k in random.integers(len(places), size=2))
            content = content[: one.start()] + other[0] + content[one.end() :]
        elif kind == 2:
            place = int(random.integers(len(content)))
            content = content[:place] + bytes([random.integers(256)]) + content[place + 1 :]
        elif kind == 3:
            content = content[: int(len(content) * random.uniform(0.5, 1.0))]
        else:
            lines = content.split(b"\n")
            lines.insert(int(random.integers(len(lines))), lines[random.integers(len(lines))])
            content = b"\n".join(lines)
    return content


def main() -> None:
    """Damage, read, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random, whole, counts = np.random.default_rng(options.seed), bodies(), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.step")
        for number in range(options.files):
            path.write_bytes(damaged(whole[number % len(whole)], random))
            start = time.perf_counter()
            try:
                read_surface(str(path), "inclusion[0].surface", np.zeros(3))
                how = "read"
            except InputError as refused:
                text = str(refused)
                death = re.search(r"ended by SIG\w+|took longer|more memory", text)
                how = f"refused, {death[0]}" if death else "refused"
            counts[how] += 1
            print(f"{number:3} {how} {time.perf_counter() - start:.1f} s", flush=True)
    print(dict(counts))


if __name__ == "__main__":
    main()
