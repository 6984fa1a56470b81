"""Write the new scenes of the matrix of extremes: an ordinary one, then its numbers at their limits, alone and together.

``python -m benchmarks.references.extremes_scenes tests/reference/extremes`` writes them; then ``axisymmetric.py`` on
that folder for the results.

Duration: seconds.
"""

from __future__ import annotations

import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.references.generate_extra_scenes import round_significant, toml
from geometry import read_scene

Numbers = dict[str, Any]
"""Lengths in mm, moduli in Pa; ``cover``: tissue over the inclusion; ``contrast``: its modulus over the tissue's."""

MIDDLE: Numbers = {
    "inner_radius": 4, "area_ratio": 1.2, "gap": 0.2, "inner_height": 3, "outer_height": 3, "inner_modulus": 3e5,
    "outer_modulus": 8e4, "inner_poisson": 0.48, "outer_poisson": 0.48, "tissue_radius": 45, "tissue_depth": 50,
    "tissue_modulus": 6000, "tissue_poisson": 0.45, "inclusion_poisson": 0.45, "contrast": 10, "diameter": 8, "cover": 3,
}  # fmt: skip
SIX_NINES = dict.fromkeys(("tissue_poisson", "inner_poisson", "outer_poisson", "inclusion_poisson"), 0.499999)
ZERO = dict.fromkeys(SIX_NINES, 0.0)
FREE = {"frictionless": True}
MICRO = {"inner_radius": 0.1, "gap": 0.005, "inner_height": 0.075, "outer_height": 0.075}
LARGE = {"inner_radius": 50, "inner_height": 37.5, "outer_height": 37.5, "tissue_radius": 400, "tissue_depth": 300}
GIANT = {"diameter": 50, "tissue_radius": 60, "tissue_depth": 80}
FLAT, TALL = ({"inner_height": h, "outer_height": h} for h in (0.08, 80))  # 0.02 and 20 inner radii
LID = {  # the ring presses a lid of tissue over a hollow: its middle sinks further, and pulls the inner block
    "inner_radius": 2, "area_ratio": 0.1, "gap": 2, "inner_modulus": 1e6, "outer_modulus": 1e6, "diameter": 30, "contrast": 1e-6,
}  # fmt: skip
SHEET = {"tissue_depth": 1.8, "diameter": 1, "cover": 0.4}  # 0.3 outer radii

# fmt: off
SCENES: dict[str, Numbers] = {
    "middle": {},
    "middle-frictionless": FREE,
    "no-inclusion": {"contrast": None},
    "no-inclusion-frictionless": {"contrast": None, **FREE},
    "no-inclusion-incompressible": {"contrast": None, **SIX_NINES},
    "no-inclusion-hairline-gap": {"contrast": None, "gap": 0.001},
    "contrast-1e-6": {"contrast": 1e-6},
    "contrast-1e-3": {"contrast": 1e-3},
    "contrast-1": {"contrast": 1},
    "contrast-1-shallow-frictionless": {"contrast": 1, "cover": 0.01, **FREE},
    "contrast-1e3": {"contrast": 1e3},
    "contrast-1e6": {"contrast": 1e6},
    "contrast-1e-6-frictionless": {"contrast": 1e-6, **FREE},
    "contrast-1e6-frictionless": {"contrast": 1e6, **FREE},
    "incompressible-tissue": {"tissue_poisson": 0.499999},
    "incompressible-inclusion": {"inclusion_poisson": 0.499999},
    "incompressible-blocks": {"inner_poisson": 0.499999, "outer_poisson": 0.499999},
    "incompressible": SIX_NINES,
    "incompressible-frictionless": {**SIX_NINES, **FREE},
    "incompressible-contrast-1e-6": {**SIX_NINES, "contrast": 1e-6},
    "incompressible-contrast-1e6-cover-10-um": {**SIX_NINES, "contrast": 1e6, "cover": 0.01},
    "incompressible-sheet-of-tissue": {**SIX_NINES, **SHEET},
    "zero-poisson": ZERO,
    "gap-1-um": {"gap": 0.001},
    "gap-1-um-frictionless": {"gap": 0.001, **FREE},
    "gap-2-um-large-probe": {**LARGE, "gap": 0.002},
    "gap-5-um-large-probe": {**LARGE, "gap": 0.005},
    "gap-1-um-micro-probe": {**MICRO, "gap": 0.001},
    "gap-5-mm": {"gap": 5},
    "gap-5-mm-micro-probe": {**MICRO, "gap": 5, "cover": 0.01},
    "gap-4.5-mm-small-inner": {"inner_radius": 0.5, "gap": 4.5, "area_ratio": 0.08, "cover": 0.1},
    "gap-5-mm-area-ratio-0.02": {"gap": 5, "area_ratio": 0.02},
    "cover-10-um": {"cover": 0.01},
    "cover-10-um-frictionless": {"cover": 0.01, **FREE},
    "cover-10-um-contrast-1e6": {"cover": 0.01, "contrast": 1e6},
    "cover-10-um-contrast-1e-6": {"cover": 0.01, "contrast": 1e-6},
    "cover-10-um-contrast-1e-6-frictionless": {"cover": 0.01, "contrast": 1e-6, **FREE},
    "cover-10-um-diameter-50-mm": {**GIANT, "cover": 0.01},
    "cover-10-um-diameter-50-mm-contrast-1e6": {**GIANT, "cover": 0.01, "contrast": 1e6},
    "cover-10-um-diameter-50-mm-contrast-1e-6": {**GIANT, "cover": 0.01, "contrast": 1e-6, **FREE},
    "cover-10-um-diameter-0.1-mm": {"diameter": 0.1, "cover": 0.01, "contrast": 1e3},
    "diameter-0.1-mm": {"diameter": 0.1},
    "diameter-0.1-mm-contrast-1e-6": {"diameter": 0.1, "cover": 0.05, "contrast": 1e-6},
    "diameter-50-mm": GIANT,
    "diameter-50-mm-contrast-1e-6": {**GIANT, "contrast": 1e-6},
    "area-ratio-0.02": {"area_ratio": 0.02},
    "area-ratio-0.02-gap-1-um-frictionless": {"area_ratio": 0.02, "gap": 0.001, **FREE},
    "area-ratio-50": {"area_ratio": 50},
    "area-ratio-50-frictionless": {"area_ratio": 50, **FREE},
    "area-ratio-50-gap-1-um": {"area_ratio": 50, "gap": 0.001},
    "area-ratio-50-tall": {"area_ratio": 50, **TALL},
    "micro-probe": MICRO,
    "micro-probe-incompressible": {**MICRO, **SIX_NINES},
    "micro-probe-diameter-0.1-mm-cover-10-um": {**MICRO, "diameter": 0.1, "cover": 0.01},
    "micro-probe-diameter-50-mm-cover-10-um": {**MICRO, **GIANT, "cover": 0.01, "contrast": 1e6},
    "micro-probe-no-inclusion-frictionless": {**MICRO, "contrast": None, **FREE},
    "large-probe": LARGE,
    "large-probe-diameter-50-mm-cover-10-um": {**LARGE, "diameter": 50, "cover": 0.01},
    "large-probe-diameter-0.1-mm-cover-10-um": {**LARGE, "diameter": 0.1, "cover": 0.01, "contrast": 1e6},
    "large-probe-incompressible-frictionless": {**LARGE, "diameter": 50, **SIX_NINES, **FREE},
    "flat": FLAT,
    "flat-frictionless": {**FLAT, **FREE},
    "flat-incompressible": {**FLAT, **SIX_NINES},
    "flat-soft-incompressible-blocks": {
        **FLAT, "inner_modulus": 100, "outer_modulus": 100, "inner_poisson": 0.499999, "outer_poisson": 0.499999,
    },
    "tall": TALL,
    "tall-frictionless": {**TALL, **FREE},
    "flat-inner-tall-outer": {"inner_height": 0.08, "outer_height": 80},
    "tall-inner-flat-outer": {"inner_height": 80, "outer_height": 0.08},
    "stiff-inner-soft-outer": {"inner_modulus": 1e10, "outer_modulus": 1},
    "soft-inner-stiff-outer": {"inner_modulus": 1, "outer_modulus": 1e10},
    "stiff-blocks": {"inner_modulus": 1e10, "outer_modulus": 1e10},
    "soft-blocks-frictionless": {"inner_modulus": 1, "outer_modulus": 1, **FREE},
    "inner-pressed-a-little": {**LID, "cover": 1.1},
    "inner-just-pressed": {**LID, "cover": 1.209},
    "inner-neither-pressed-nor-pulled": {**LID, "cover": 1.20946},
    "inner-just-pulled": {**LID, "cover": 1.21},
    "inner-pulled-a-little": {**LID, "cover": 1.3},
}
# fmt: on
CORNERS = (1, 10, 11, 12, 13, 14)  # of those drawn: the reference code takes minutes for others
CHOICES: dict[str, tuple[Any, ...]] = {
    "contrast": (1e-6, 1e6),
    "tissue_poisson": (0.0, 0.499999),
    "inner_poisson": (0.0, 0.499999),
    "outer_poisson": (0.0, 0.499999),
    "inclusion_poisson": (0.0, 0.499999),
    "inner_radius": (0.1, 50),
    "gap": (0.001, 5),
    "cover": (0.01, 5),
    "diameter": (0.1, 50),
    "area_ratio": (0.02, 50),
    "inner_slenderness": (0.02, 20),
    "outer_slenderness": (0.02, 20),
    "frictionless": (False, True),
}


def corner(name: str) -> Numbers:
    """Draw every number from its two limits, by the scene's name; the tissue is twice as large as what it holds."""
    random = np.random.default_rng(zlib.crc32(name.encode()))
    drawn = {key: values[int(random.integers(len(values)))] for key, values in CHOICES.items()}
    for block in ("inner", "outer"):
        drawn[f"{block}_height"] = drawn.pop(f"{block}_slenderness") * drawn["inner_radius"]
    tube = ((drawn["inner_radius"] + drawn["gap"]) ** 2 + drawn["inner_radius"] ** 2 / drawn["area_ratio"]) ** 0.5
    size = round_significant(2 * max(tube, drawn["diameter"] + drawn["cover"]))
    return drawn | {"tissue_radius": size, "tissue_depth": size}


def scenes() -> dict[str, Numbers]:
    """Return all scenes by name, with all of their numbers."""
    corners = {f"corner-{k}": corner(f"corner-{k}") for k in CORNERS}
    return {name: MIDDLE | changes for name, changes in (SCENES | corners).items()}


def main(folder: Path) -> None:
    """Write every scene into the folder and read it back."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, numbers in scenes().items():
        depth = float(f"{numbers['diameter'] / 2 + numbers['cover']:.10g}")
        path = folder / f"{name}.toml"
        path.write_text(toml(numbers | {"depth": depth}, numbers), encoding="utf-8")
        read_scene(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
