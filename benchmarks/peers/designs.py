"""The 17 variables of a design: nine lengths, four Young's moduli, four Poisson's ratios."""

from __future__ import annotations

from geometry import Scene

Path = tuple[str | int, ...]

LENGTHS: dict[str, Path] = {
    "inner_radius": ("probe", "inner_radius"),
    "hole_radius": ("probe", "hole_radius"),
    "tube_radius": ("probe", "outer_radius"),
    "inner_height": ("probe", "inner_height"),
    "outer_height": ("probe", "outer_height"),
    "tissue_radius": ("tissue", "radius"),
    "tissue_depth": ("tissue", "depth"),
    "sphere_radius": ("inclusion", 0, "diameter"),
    "sphere_depth": ("inclusion", 0, "depth"),
}
BODIES: dict[str, Path] = {
    "inner": ("probe", "inner"),
    "outer": ("probe", "outer"),
    "tissue": ("tissue",),
    "inclusion": ("inclusion", 0),
}
MATERIALS: dict[str, Path] = {
    f"{body}.{key}": (*path, key) for key in ("youngs_modulus", "poisson_ratio") for body, path in BODIES.items()
}
VARIABLES = LENGTHS | MATERIALS


def vary_design(scene: Scene, variable: str, factor: float) -> Scene:
    """Return the scene with one variable multiplied, all others kept."""
    probe, values = scene.probe, scene.model_dump(exclude_none=True)
    explicit = {
        "hole_radius": probe.hole_radius,
        "outer_radius": probe.tube_radius,
        "inner_height": probe.core_height,
        "outer_height": probe.tube_height,
    }
    values["probe"] = {k: v for k, v in values["probe"].items() if k not in ("area_ratio", "height", "gap")} | explicit
    *parents, key = VARIABLES[variable]
    node = values
    for step in parents:
        node = node[step]  # type: ignore[index]
    node[key] *= factor  # type: ignore[index]
    values["probe"]["gap"] = values["probe"].pop("hole_radius") - values["probe"]["inner_radius"]
    return Scene.model_validate(values)
