"""Write the scenes of ``tests/reference/off-axis``: off-axis tumours under two probes, for ``solid``.

Usage: ``python -m benchmarks.references.generate_off_axis_scenes tests/reference/off-axis``

Duration: seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from geometry import read_scene

HARD = {"inner_radius": 4, "gap": 0.15, "height": 4, "inner": "1 MPa", "outer": "0.3 MPa", "poisson": 0.47}
SOFT = {"inner_radius": 3.5, "gap": 0.2, "height": 5, "inner": "0.5 MPa", "outer": "0.8 MPa", "poisson": 0.45}
OUTER_RADIUS, MATRIX = 8.0, 6000.0  # mm, Pa


def sphere(offset: float, cover: float, diameter: float = 8.0, contrast: float = 10.0) -> dict[str, Any]:
    """Return a sphere; offset in outer radii, cover in diameters, diameter in mm."""
    return {"shape": f'diameter = "{diameter:g} mm"', "x": offset * OUTER_RADIUS, "depth": (0.5 + cover) * diameter} | {
        "contrast": contrast
    }


def ellipsoid(offset: float) -> dict[str, Any]:
    """Return the ellipsoid turned by 30 degrees, 2.5 mm below the surface."""
    turned = 'diameters = ["8 mm", "6 mm", "5 mm"]\norientation = [0.0, 30.0, 0.0]'
    return {"shape": turned, "x": offset * OUTER_RADIUS, "depth": 2.5 + (16 / 4 + 6.25 * 3 / 4) ** 0.5, "contrast": 10.0}


SCENES: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "stiff-cover-0.25-offset-0.5": (HARD, [sphere(0.5, 0.25)]),
    "stiff-cover-0.25-offset-1": (HARD, [sphere(1, 0.25)]),
    "stiff-cover-0.25-offset-2": (HARD, [sphere(2, 0.25)]),
    "stiff-cover-0.1-offset-0.5": (HARD, [sphere(0.5, 0.1)]),
    "stiff-cover-0.1-offset-1": (HARD, [sphere(1, 0.1)]),
    "stiff-cover-0.6-offset-0.5": (SOFT, [sphere(0.5, 0.6)]),
    "stiff-cover-1-offset-0.5": (SOFT, [sphere(0.5, 1, 10)]),
    "soft-cover-0.25-offset-0.5": (HARD, [sphere(0.5, 0.25, contrast=0.1)]),
    "soft-cover-0.25-offset-1": (SOFT, [sphere(1, 0.25, contrast=0.1)]),
    "soft-cover-0.1-offset-0.5": (HARD, [sphere(0.5, 0.1, contrast=0.1)]),
    "soft-cover-0.1-offset-1": (SOFT, [sphere(1, 0.1, contrast=0.1)]),
    "pair-on-axis": (HARD, [sphere(0, 0.3) | {"target": True}, sphere(9.2 / 8, 0.3)]),
    "pair-off-axis": (SOFT, [sphere(0.25, 0.3, 6) | {"target": True}, sphere(8.6 / 8, 0.3, 6)]),
    "stiff-cover-0.025-offset-0.5": (HARD, [sphere(0.5, 0.025)]),
    "frictionless-cover-0.25-offset-0.5": (HARD, [sphere(0.5, 0.25)]),
    "frictionless-cover-0.1-offset-0.5": (HARD, [sphere(0.5, 0.1)]),
    "ellipsoid-on-axis": (HARD, [ellipsoid(0)]),
    "ellipsoid-off-axis": (HARD, [ellipsoid(0.7)]),
    "contrast-100": (SOFT, [sphere(0.7, 0.2, contrast=100)]),
    "contrast-1000": (SOFT, [sphere(0.7, 0.2, contrast=1000)]),
    "nearly-incompressible": (SOFT | {"poisson": 0.499}, [sphere(0.7, 0.2)]),
}


def toml(name: str, probe: dict[str, Any], tumours: list[dict[str, Any]]) -> str:
    """Write the scene file."""
    sizes = [f'{key} = "{probe[key]:g} mm"' for key in ("inner_radius", "gap", "height")]
    lines = ["[probe]", sizes[0], f'outer_radius = "{OUTER_RADIUS:g} mm"', *sizes[1:]]
    lines += [f'\n[probe.{block}]\nyoungs_modulus = "{probe[block]}"\npoisson_ratio = 0.48' for block in ("inner", "outer")]
    lines += ["\n[probe.base]\nrigid = true", '\n[tissue]\nshape = "cylinder"\nradius = "40 mm"\ndepth = "30 mm"']
    lines += [f'youngs_modulus = "{MATRIX:g} Pa"\npoisson_ratio = {probe["poisson"]}']
    for body in tumours:
        lines += [f'\n[[inclusion]]\n{body["shape"]}\ndepth = "{body["depth"]:.10g} mm"\nx = "{body["x"]:.10g} mm"']
        lines += [f'youngs_modulus = "{body["contrast"] * MATRIX:g} Pa"\npoisson_ratio = {probe["poisson"]}']
        lines += ["target = true"] if body.get("target") else []
    lines += [f'\n[contact]\ninterface = "{"frictionless" if name.startswith("frictionless") else "bonded"}"']
    return "\n".join([*lines, '\n[load]\nindentation = "3 um"\n'])


def main(folder: Path) -> None:
    """Write every scene into the folder and read it back."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (probe, tumours) in SCENES.items():
        path = folder / f"{name}.toml"
        path.write_text(toml(name, probe, tumours), encoding="utf-8")
        read_scene(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
