"""Random scenes over wide ranges, and the same scene scaled, stiffened, mirrored or turned."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

from geometry import Scene
from geometry.scenes.units import SI_CONTEXT

LENGTHS = {
    "inner_radius", "outer_radius", "gap", "height", "inner_height", "outer_height", "radius", "depth", "diameter", "x", "y",
    "indentation",
}  # fmt: skip
MODULI = {"inner": ("probe", "inner"), "outer": ("probe", "outer"), "tissue": ("tissue",), "inclusion": ("inclusion", 0)}


def draw_between(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers whose logarithm is spread evenly."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


@st.composite
def scenes(draw: Any, least_cover: float = 0.15, farthest: float = 0.0, tumours: int = 1) -> Scene:
    """A probe of any proportions, bonded or frictionless, on a cylinder of tissue with tumours.

    Parameters
    ----------
    draw
        Hypothesis's.
    least_cover
        Tissue above a tumour, in its diameters.
    farthest
        Of the first tumour's centre from the probe's axis along x, outer radii; 0: on the axis.
    tumours
        How many at most, side by side.
    """
    probe = draw(probes())
    outer = math.hypot(probe["inner_radius"] + probe["gap"], probe["inner_radius"] / math.sqrt(probe["area_ratio"]))
    bodies: list[dict[str, Any]] = []
    for _ in range(draw(st.integers(1, tumours))):
        bodies.append(_tumour(draw, outer, least_cover, farthest, bodies))
    lowest = max(body["depth"] + body["diameter"] / 2 for body in bodies)
    widest = max(outer, *(math.hypot(body["x"], body["y"]) + body["diameter"] for body in bodies))
    room = {"radius": widest * draw(draw_between(1.5, 10.0)), "depth": lowest * draw(draw_between(1.1, 4.0))}
    scene = {
        "probe": {**probe, "inner": draw(materials(0.2, 1e4)), "outer": draw(materials(0.2, 1e4))},
        "tissue": {"shape": "cylinder", **room, **draw(materials(1.0, 1.0))},
        "inclusion": bodies,
        "contact": {"interface": draw(st.sampled_from(["bonded", "frictionless"]))},
        "load": {"indentation": 1e-6},
    }
    return scaled(Scene.model_validate(scene, context=SI_CONTEXT), moduli=draw(draw_between(0.1, 100.0)))


def materials(minimum: float, maximum: float) -> st.SearchStrategy[dict[str, float]]:
    """Materials of a modulus within a range, kPa."""
    modulus = draw_between(minimum, maximum).map(lambda kilopascals: 1e3 * kilopascals)
    return st.fixed_dictionaries({"youngs_modulus": modulus, "poisson_ratio": st.floats(0.0, 0.499)})


@st.composite
def probes(draw: Any) -> dict[str, float]:
    """Lengths: blocks from flat to tall, from a thin core to a thin sleeve, gaps from hairline to wide."""
    radius, height = draw(draw_between(1e-3, 1e-2)), draw(draw_between(0.1, 6.0))
    return {
        "inner_radius": radius,
        "area_ratio": draw(draw_between(0.05, 20.0)),
        "gap": radius * draw(draw_between(0.003, 0.5)),
        "inner_height": radius * height,
        "outer_height": radius * height * draw(draw_between(0.7, 1.4)),
    }


def _tumour(draw: Any, outer: float, least_cover: float, farthest: float, placed: list[dict[str, Any]]) -> dict[str, Any]:
    """The first tumour, or one beside the last."""
    diameter = outer * draw(draw_between(0.3, 1.5))
    x = outer * draw(st.floats(0.0, farthest))
    if placed:
        x = placed[-1]["x"] - 0.6 * (diameter + placed[-1]["diameter"]) - x
    return {
        "diameter": diameter,
        "depth": diameter * (0.5 + draw(draw_between(least_cover, 2.0))),
        "x": x,
        "y": outer * farthest * draw(st.floats(-0.5, 0.5)),
        "target": not placed,
        **draw(materials(1e-3, 1e4)),
    }


def scaled(scene: Scene, lengths: float = 1.0, moduli: float = 1.0) -> Scene:
    """Return the scene with every length and every modulus times a number."""

    def scale_value(key: str, value: Any) -> Any:
        if isinstance(value, dict):
            return {name: scale_value(name, item) for name, item in value.items()}
        if isinstance(value, tuple | list):
            return tuple(scale_value(key, item) for item in value)
        return value * lengths if key in LENGTHS else value * moduli if key == "youngs_modulus" else value

    return Scene.model_validate(scale_value("", scene.model_dump(exclude_unset=True)), context=SI_CONTEXT)


def stiffened(scene: Scene, part: str, times: float) -> Scene:
    """Return the scene with the modulus of one part (a key of ``MODULI``) times a number."""
    data = scene.model_dump(exclude_unset=True)
    material: Any = data
    for key in MODULI[part]:
        material = material[key]
    material["youngs_modulus"] *= times
    return Scene.model_validate(data, context=SI_CONTEXT)


def homogeneous(scene: Scene) -> Scene:
    """Return the scene with all tumours of the tissue's material."""
    like = scene.tissue.model_dump(include={"youngs_modulus", "poisson_ratio"})
    return scene.model_copy(update={"inclusion": tuple(body.model_copy(update=like) for body in scene.inclusion)})


def in_a_block(scene: Scene) -> Scene:
    """Return the scene with a block, longer than broad, about as wide as the cylinder of its tissue."""
    tissue = scene.tissue.model_dump(exclude={"shape"})
    radius = tissue.pop("radius")
    block = {**tissue, "shape": "block", "length": 2.2 * radius, "breadth": 1.6 * radius}
    return Scene.model_validate({**scene.model_dump(exclude_unset=True), "tissue": block}, context=SI_CONTEXT)


def moved(scene: Scene, xx: float, xy: float, yx: float, yy: float) -> Scene:
    """Return the scene with all tumours at (xx x + xy y, yx x + yy y), a block's sides exchanged where x and y are."""
    data = scene.model_dump(exclude_unset=True)
    for body in data["inclusion"]:
        x, y = body["x"], body["y"]
        body.update(x=xx * x + xy * y, y=yx * x + yy * y)
    tissue = data["tissue"]
    if scene.tissue.shape == "block" and xx == yy == 0:
        tissue.update(length=tissue["breadth"], breadth=tissue["length"])
    return Scene.model_validate(data, context=SI_CONTEXT)
