"""Rows of the matrix whose true values follow from a reference by a law of linear elasticity, where no other code reaches."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from geometry import Inclusion, Load, Scene, read_scene
from tests.support.extremes.rows import Row, Truth, truths
from tests.support.paths import REFERENCE

FORCES = (0.0, 1e-9, 0.1)  # N
GRAIN = 1e-5  # of the ratio: more than a sphere of 0.1 mm, a millionth of the tissue that the middle probe feels, can change
PER_DEGREE = (-30.14, 19.03)  # Pa on inner and outer block: half the difference of ``solid`` at 1 and at -1 degree
TILT_SHARE = 0.02  # of them: what they may be off
LENGTHS = {"inner_radius", "outer_radius", "gap", "height", "inner_height", "outer_height", "radius", "depth", "diameter",
           "diameters", "x", "y", "indentation", "length", "breadth"}  # fmt: skip
TISSUE_ITSELF = {  # x, diameter, cover, mm
    "8 mm, 10 um deep, off the axis,": ((5.0, 8.0, 0.01),),
    "two of 8 mm": ((-6.0, 8.0, 0.5), (6.0, 8.0, 0.5)),
    "40 mm, 10 um deep, off the axis,": ((20.0, 40.0, 0.01),),
    "0.1 mm off the axis": ((3.0, 0.1, 0.05),),
}
GRAINS = ((3.0, 0.1, 3.0), (6.0, 0.1, 3.0))
SCALED = (
    "stiff-cover-0.1-offset-0.5",
    "soft-cover-0.1-offset-1",
    "pair-off-axis",
    "frictionless-cover-0.1-offset-0.5",
    "contrast-1000",
)
PROPORTIONAL = ("stiffness", "stress_inner", "stress_outer")
LINEAR = "linear in the load, from NGSolve"
TILTED = "NGSolve upright, and the tilt's share, proportional to it, from `solid` at 1 degree"
SCALE = "the same at every scale, from NGSolve"
TURNED = "the same when turned, from NGSolve"


def lawful() -> Iterator[Row]:
    """Yield all of them."""
    yield from loads()
    yield from scales()
    yield from turned()
    yield from layered()
    yield from homogeneous()
    yield from hairline()
    yield from crossing()


def known(folder: str, name: str) -> tuple[Scene, Truth]:
    """Return a scene of ``tests/reference`` and its true values."""
    return read_scene(REFERENCE / folder / f"{name}.toml"), truths(folder)[name]


def loads() -> Iterator[Row]:
    """Stresses are linear in the load; ratio, stiffness and log-sensitivity do not depend on it."""
    for name in ("middle", "cover-10-um", "soft-blocks-frictionless"):
        scene, truth = known("extremes", name)
        for force in FORCES:
            pressed = with_load(scene, truth, Load(force=force))
            yield Row("laws", f"{name}, {force:g} N", *pressed, LINEAR)
        yield Row("laws", f"{name}, no indentation", *with_load(scene, truth, Load(indentation=0.0)), LINEAR)


def with_load(scene: Scene, truth: Truth, load: Load) -> tuple[Scene, Truth]:
    """Return a scene that an indentation loaded, and its true values, at another load."""
    assert scene.load.indentation is not None
    assert truth.stiffness is not None
    assert truth.stress_inner is not None
    assert truth.stress_outer is not None
    indentation = load.indentation if load.indentation is not None else (load.force or 0.0) / truth.stiffness
    times = indentation / scene.load.indentation
    stresses = {"stress_inner": truth.stress_inner * times, "stress_outer": truth.stress_outer * times}
    return changed(scene, load=load.model_dump()), replace(truth, **stresses)


def changed(scene: Scene, **parts: Any) -> Scene:
    """Return a scene with other parts, checked as a whole."""
    return Scene.model_validate(scene.model_dump() | parts)


def scales() -> Iterator[Row]:
    """All lengths times s: ratio, stresses and log-sensitivity stay, the stiffness grows by s; all moduli times m likewise."""
    for name in SCALED:
        scene, truth = known("off-axis", name)
        for what, size in (("0.1 mm", 1e-4), ("50 mm", 0.05)):
            times = size / scene.probe.tube_radius
            grown = Scene.model_validate(_times(scene.model_dump(), LENGTHS, times))
            values = replace(truth, stiffness=_product(truth.stiffness, times))
            yield Row("laws", f"{name}, outer radius {what}", grown, values, SCALE)
    for times in (1e-4, 1e6):
        grown = Scene.model_validate(_times(scene.model_dump(), {"youngs_modulus"}, times))
        scaled_values: dict[str, Any] = {
            key: _product(getattr(truth, key), times) for key in ("stiffness", "stress_inner", "stress_outer")
        }
        yield Row("laws", f"{name}, moduli times {times:g}", grown, replace(truth, **scaled_values), SCALE)


def _product(value: float | None, times: float) -> float | None:
    return None if value is None else value * times


def _times(values: Any, keys: set[str], times: float, own_modulus: bool = False) -> Any:
    """Multiply all numbers that stand under one of the keys."""
    if isinstance(values, dict):
        return {key: _times(value, keys, times, key in keys) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return tuple(_times(value, keys, times, own_modulus) for value in values)
    return values * times if own_modulus and isinstance(values, float) else values


def turned() -> Iterator[Row]:
    """Round tissue turned about the probe's axis is the same."""
    for name, degrees in (("stiff-cover-0.025-offset-0.5", 37.0), ("contrast-1000", 215.0)):
        scene, truth = known("off-axis", name)
        cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        bodies = tuple(body.model_dump() | {"x": body.x * cosine, "y": body.x * sine} for body in scene.inclusion)
        yield Row("laws", f"{name}, turned by {degrees:g} degrees", changed(scene, inclusion=bodies), truth, TURNED)


def crossing() -> Iterator[Row]:
    """A probe that is raised on the side of a stiff tumour while it is pressed: stress_outer crosses zero with the indentation.

    No reference code has tilt. The stresses are the sum of the upright probe's, NGSolve's, and of the tilt's, ``PER_DEGREE``.
    """
    scene, truth = known("off-axis", "stiff-cover-0.1-offset-0.5")
    tilt = -2.0
    for micrometres in (25.0, 39.2, 60.0):
        pressed, upright = with_load(scene, truth, Load(indentation=1e-6 * micrometres))
        inner = (upright.stress_inner or 0.0) + tilt * PER_DEGREE[0]
        outer = (upright.stress_outer or 0.0) + tilt * PER_DEGREE[1]
        uncertainty = TILT_SHARE * abs(tilt) * (abs(PER_DEGREE[0] / inner) + abs(PER_DEGREE[1] / outer))
        tilted_truth = Truth(inner / outer, inner, outer, truth.stiffness, None, uncertainty)
        tilted = changed(pressed, placement={"tilt": math.radians(tilt)})
        yield Row("zero", f"{tilt:g} degrees of tilt, {micrometres:g} um", tilted, tilted_truth, TILTED)


def homogeneous() -> Iterator[Row]:
    """Inclusions of the tissue's own material are not there; nor, within ``GRAIN``, are those of 0.1 mm."""
    scene, truth = known("extremes", "no-inclusion")
    tissue, without_sensitivity = scene.tissue.youngs_modulus, replace(truth, log_sensitivity=None)
    nothing = "as without an inclusion, from NGSolve"
    for name, bodies in TISSUE_ITSELF.items():
        yield Row(
            "laws", f"{name} of tissue", changed(scene, inclusion=spheres(scene, bodies, tissue)), without_sensitivity, nothing
        )
    for contrast in (1e-6, 1e6):
        grain, name = spheres(scene, GRAINS, contrast * tissue), f"two of 0.1 mm off the axis, contrast {contrast:g}"
        yield Row("laws", name, changed(scene, inclusion=grain), replace(without_sensitivity, uncertainty=GRAIN), nothing)


def layered() -> Iterator[Row]:
    """Layers of the tissue's own material are not there; tissue on rock is tissue on its rigid bottom; scales do not matter."""
    scene, truth = known("extremes", "middle")
    tissue = scene.tissue.model_dump()
    tissue_values = {"youngs_modulus": scene.tissue.youngs_modulus, "poisson_ratio": scene.tissue.poisson_ratio}
    for name, thickness in (("1 um", 1e-6), ("0.1 mm", 1e-4), ("30 mm", 30e-3)):
        cut = tissue | {"layer": [tissue_values | {"thickness": thickness}]}
        yield Row("laws", f"a layer of tissue, {name}", changed(scene, tissue=cut), truth, "as without it, from NGSolve")
    for times in (1e4, 1e6):  # of the rock some 10 mm: it gives way by less than its softness
        rock = tissue | {"depth": tissue["depth"] + 10e-3, "youngs_modulus": times * tissue_values["youngs_modulus"]}
        layers, deep = (
            replace(truth, uncertainty=truth.uncertainty + 2 / times),
            rock | {"layer": [tissue_values | {"thickness": tissue["depth"]}]},
        )
        yield Row(
            "laws", f"tissue on rock, contrast {times:g}", changed(scene, tissue=deep), layers, "on a rigid bottom, by NGSolve"
        )
    for name, size in (("film-of-a-tenth-millimetre", 0.1e-3), ("plate-on-gel", 50e-3)):
        scene, truth = known("tissue-layers", name)
        times = size / scene.probe.tube_radius
        grown = Scene.model_validate(_times(scene.model_dump(), LENGTHS | {"thickness"}, times))
        values = replace(truth, stiffness=_product(truth.stiffness, times))
        yield Row("laws", f"{name}, outer radius {1e3 * size:g} mm", grown, _pressed_alike(scene, values, times), SCALE)


def _pressed_alike(scene: Scene, truth: Truth, times: float) -> Truth:
    """The stresses under the same force on a probe that is larger by so much; those under an indentation grow with it."""
    area = 1 if scene.load.indentation is not None else times**-2
    inner, outer = (_product(stress, area) for stress in (truth.stress_inner, truth.stress_outer))
    return replace(truth, stress_inner=inner, stress_outer=outer)


def hairline() -> Iterator[Row]:
    """No mesher takes a gap of 1 um round 50 mm: from 2 um on, every value changes by less than from 5 to 2 um in ln(gap)."""
    scene, truth = known("extremes", "gap-2-um-large-probe")
    wider, exponent = truths("extremes")["gap-5-um-large-probe"], math.log(2) / math.log(5 / 2) / 2
    values, uncertainty = {}, 0.0
    for key in ("ratio", *PROPORTIONAL):
        value, reference_value = getattr(truth, key), getattr(wider, key)
        values[key] = value + (value - reference_value) * exponent  # the middle of what it may be
        uncertainty = max(uncertainty, abs(value / reference_value - 1) * exponent)
    probe, scaled_truth = scene.probe.model_dump() | {"gap": 1e-6}, Truth(**values, uncertainty=uncertainty)
    yield Row("laws", "gap-1-um-large-probe", changed(scene, probe=probe), scaled_truth, "from NGSolve's at 2 and 5 um")


def spheres(scene: Scene, bodies: tuple[tuple[float, float, float], ...], modulus: float) -> tuple[dict[str, Any], ...]:
    """Return spheres (x, diameter, cover, all in mm), the first of them the target."""
    material: dict[str, Any] = {"youngs_modulus": modulus, "poisson_ratio": scene.tissue.poisson_ratio}
    inclusions = [Inclusion(x=1e-3 * x, diameter=1e-3 * d, depth=1e-3 * (d / 2 + cover), **material) for x, d, cover in bodies]
    return tuple(body.model_dump() | {"target": k == 0} for k, body in enumerate(inclusions))
