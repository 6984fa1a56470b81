"""Make the scenes of ``tests/reference/extra`` and ``extreme``: corners of the range of designs, the rest drawn by name.

What a scene does not wish for is drawn log-uniformly from ``RANGES`` (Poisson's ratios from ``POISSON``) until the bodies
fit, by a generator seeded with the scene's name, so that adding scenes changes no other.

Usage: ``python -m benchmarks.references.generate_extra_scenes FOLDER``, a folder named ``extra`` or ``extreme``; then
``python -m benchmarks.references.axisymmetric FOLDER`` for the results.

Duration: seconds.
"""

from __future__ import annotations

import math
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.references import extra_scenes, extreme_scenes
from benchmarks.references.extra_scenes import Wishes
from geometry import read_scene

RANGES = {
    "inner_radius": (0.5, 10),
    "area_ratio": (0.05, 50),
    "inner_modulus": (1e2, 1e7),
    "outer_modulus": (1e2, 1e7),
    "tissue_modulus": (1e3, 1e4),
    "inner_slenderness": (0.05, 10),
    "outer_slenderness": (0.05, 10),
    "contrast": (1e-4, 1e4),
    "diameter": (0.5, 40),
    "cover": (0.005, 2),
}
SETS = {"extra": extra_scenes.SCENES, "extreme": extreme_scenes.SCENES}
SMALLEST_GAP, LARGEST_GAP, LARGEST_RADIUS, LARGEST_DEPTH = 0.005, 5, 50, 60
POISSON = [0.0, 0.2, 0.3, 0.4, 0.45, 0.48, 0.49, 0.499, 0.4999]


class Draw:
    """Random numbers for one scene, four significant digits each, and what it wishes instead."""

    def __init__(self, name: str, wishes: Wishes) -> None:
        self.wishes, self.random = wishes, np.random.default_rng(zlib.crc32(name.encode()) + 20261121)

    def draw_log_uniform(self, low: float, high: float) -> float:
        """Draw log-uniformly."""
        return round_significant(math.exp(self.random.uniform(math.log(low), math.log(high))))

    def draw_wished(self, key: str, limits: tuple[float, float] | None = None) -> Any:
        """Return the wish, or draw from the wished range or from the usual one."""
        wish = self.wishes.get(key, limits or RANGES.get(key))
        return self.draw_log_uniform(*wish) if isinstance(wish, tuple) else wish

    def poisson(self, key: str) -> float:
        """Draw a Poisson's ratio, that of the tissue above 0.2; drawn and dropped where there is a wish."""
        drawn = float(self.random.choice(POISSON[2:] if key == "tissue_poisson" else POISSON))
        return float(self.wishes.get(key, drawn))


def round_significant(value: float, digits: int = 4) -> float:
    """Round to significant digits."""
    return float(f"{value:.{digits}g}")


def draw_scene(draw: Draw) -> dict[str, Any] | None:
    """Draw one scene; None if its bodies do not fit."""
    keys = ("inner_radius", "area_ratio", "inner_modulus", "outer_modulus", "tissue_modulus")
    scene = {key: draw.draw_wished(key) for key in keys}
    scene["gap"] = draw.draw_wished("gap", (SMALLEST_GAP, min(LARGEST_GAP, scene["inner_radius"])))
    scene |= heights(draw, scene["inner_radius"])
    hole = scene["inner_radius"] + scene["gap"]
    tube = math.sqrt(hole**2 + scene["inner_radius"] ** 2 / scene["area_ratio"])
    if 1.1 * tube > LARGEST_RADIUS:
        return None
    scene["tissue_radius"] = tissue_size(draw, "tissue_radius", tube, (1.1 * tube, LARGEST_RADIUS))
    scene["tissue_depth"] = tissue_size(draw, "tissue_depth", tube, (0.3 * tube, LARGEST_DEPTH))
    scene |= {f"{body}_poisson": draw.poisson(f"{body}_poisson") for body in ("tissue", "inner", "outer", "inclusion")}
    scene["contrast"] = draw.draw_wished("contrast")
    scene["diameter"], cover = draw.draw_wished("diameter"), draw.draw_wished("cover")
    scene["depth"] = round_significant(scene["diameter"] / 2 + cover * scene["diameter"], 6)
    return scene if fits(scene, tube) else None


def heights(draw: Draw, unit: float) -> dict[str, float]:
    """Draw both heights: in three scenes of five the same one, unless either is wished for."""
    inner, is_same_height = round_significant(draw.draw_wished("inner_slenderness") * unit), draw.random.uniform() < 0.6
    if is_same_height and not {"inner_slenderness", "outer_slenderness"} & draw.wishes.keys():
        return {"inner_height": inner, "outer_height": inner}
    return {"inner_height": inner, "outer_height": round_significant(draw.draw_wished("outer_slenderness") * unit)}


def tissue_size(draw: Draw, key: str, tube: float, limits: tuple[float, float]) -> float:
    """Return the wished size, that from the wished ratio to the outer radius, or a random one."""
    ratio = draw.wishes.get(f"{key}_ratio")
    return float(draw.draw_wished(key, limits)) if ratio is None else round_significant(ratio * tube)


def fits(scene: dict[str, Any], tube: float) -> bool:
    """Whether probe and inclusion have room in the tissue, and a bit of it left."""
    radius, depth, diameter = scene["tissue_radius"], scene["tissue_depth"], scene["diameter"]
    if scene["contrast"] is not None and (scene["depth"] + 0.55 * diameter > depth or 0.515 * diameter > radius):
        return False
    return bool(1.0989 * tube <= radius <= LARGEST_RADIUS and 0.2997 * tube <= depth <= LARGEST_DEPTH)


def toml(scene: dict[str, Any], wishes: Wishes) -> str:
    """Write the scene file."""
    inner, outer = scene["inner_height"], scene["outer_height"]
    each = f"inner_height = {mm(inner)}\nouter_height = {mm(outer)}"
    sections = {
        "[probe]": f"inner_radius = {mm(scene['inner_radius'])}\narea_ratio = {float(scene['area_ratio'])!r}\n"
        f"gap = {mm(scene['gap'])}\n" + (f"height = {mm(inner)}" if inner == outer else each),
        "[probe.inner]": material(scene["inner_modulus"], scene["inner_poisson"]),
        "[probe.outer]": material(scene["outer_modulus"], scene["outer_poisson"]),
        "[probe.base]": "rigid = true",
        "[tissue]": f'shape = "cylinder"\nradius = {mm(scene["tissue_radius"])}\ndepth = {mm(scene["tissue_depth"])}\n'
        + material(scene["tissue_modulus"], scene["tissue_poisson"]),
    }
    if scene["contrast"] is not None:
        modulus = round_significant(scene["contrast"] * scene["tissue_modulus"])
        sections["[[inclusion]]"] = f"diameter = {mm(scene['diameter'])}\ndepth = {mm(scene['depth'])}\n" + material(
            modulus, scene["inclusion_poisson"]
        )
    sections["[contact]"] = f'interface = "{"frictionless" if wishes.get("frictionless") else "bonded"}"'
    sections["[load]"] = load(scene, bool(wishes.get("by_force")))
    return "\n".join(f"{head}\n{text}\n" for head, text in sections.items())


def mm(length: float) -> str:
    """Write a length given in mm as a TOML string."""
    return f'"{length:.10g} mm"'


def material(modulus: float, poisson: float) -> str:
    """Write the two lines of a material."""
    return f'youngs_modulus = "{modulus:.10g} Pa"\npoisson_ratio = {poisson!r}'


def load(scene: dict[str, Any], by_force: bool) -> str:
    """Write a load that keeps the strains small."""
    if by_force:
        return f'force = "{round_significant(scene["tissue_modulus"] * scene["inner_radius"] ** 2 * 2e-9, 2):.6g} N"'
    smallest = min(scene["inner_radius"], scene["inner_height"], scene["outer_height"])
    return f'indentation = "{round_significant(1e-3 * smallest, 2) * 1e3:.6g} um"'


def main(folder: Path) -> None:
    """Write every scene into the folder and read it back."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, wishes in SETS[folder.name].items():
        draw = Draw(name, wishes)
        drawn_scene = next(scene for scene in (draw_scene(draw) for _ in range(5000)) if scene is not None)
        path = folder / f"{name}.toml"
        path.write_text(toml(drawn_scene, wishes), encoding="utf-8")
        read_scene(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
