"""Derive the dimensions of the base and its height above blocks, bonds and films; list which dimensions are assumed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_minimum_mm, is_at_least
from geometry.scenes.probe import Probe, format_mm


@dataclass(frozen=True)
class BaseSizes:
    """Dimensions of the base in m: a step of the tube's radius below a wider flange; without a flange a disc of that radius.

    Attributes
    ----------
    flange_radius
        Radius of the flange; the tube's where there is none.
    thickness
        Of the flange, or of the disc.
    step_height
        From the higher of the base's two lower faces to the flange, so that the flange stays whole; 0 without one.
    """

    flange_radius: float
    thickness: float
    step_height: float


def find_base_sizes(probe: Probe) -> BaseSizes:
    """Return the base's dimensions, those that the scene leaves open by default.

    Defaults, in outer radii of the probe: 1.25 for the flange's radius, 0.3 for the thickness, at least 1 mm, and 0.2 for the
    step's height. A rigid base has a flange only if the scene gives its radius or the step's height. An elastic base always has
    one, as the evaluators model it.

    Raises
    ------
    InputError
        The flange is narrower than the tube.
    """
    base, radius = probe.base, probe.tube_radius
    thickness = max(0.3 * radius, 1e-3) if base.thickness is None else base.thickness
    if not has_flange(probe):
        return BaseSizes(radius, thickness, 0.0)
    flange = 1.25 * radius if base.flange_radius is None else base.flange_radius
    if not is_at_least(flange, radius):
        raise InputError(
            "probe.base.flange_radius", format_mm(flange), f"at least the tube's outer radius of {format_minimum_mm(radius)}"
        )
    return BaseSizes(max(flange, radius), thickness, 0.2 * radius if base.step_height is None else base.step_height)


def has_flange(probe: Probe) -> bool:
    """Return whether the base has a flange above its step; see ``find_base_sizes``."""
    base = probe.base
    return not base.rigid or base.flange_radius is not None or base.step_height is not None


def assume_sizes(probe: Probe) -> dict[str, float]:
    """Return the dimensions (m) of the probe's parts that the scene leaves open, by the keys that would give them.

    Raises
    ------
    InputError
        See ``find_base_sizes``.
    """
    keys = ("flange_radius", "thickness", "step_height") if has_flange(probe) else ("thickness",)
    sizes = find_base_sizes(probe)
    open_sizes = {f"probe.base.{key}": getattr(sizes, key) for key in keys if getattr(probe.base, key) is None}
    if probe.film is not None and "thickness" not in probe.film.model_fields_set:
        open_sizes["probe.film.thickness"] = probe.film.thickness
    return open_sizes


def find_film_levels(probe: Probe) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the heights of the lower and the upper face of the film on the inner and on the outer block, m.

    Raises
    ------
    InputError
        The probe has no films.
    """
    if probe.film is None:
        raise InputError("probe.film", Words("missing"), "a table [probe.film]")
    inner, outer = (
        (height + film.stack[0].thickness, height + film.stack[0].thickness + film.thickness)
        for film, height in zip(probe.film.by_block, (probe.core_height, probe.tube_height), strict=True)
    )
    return inner, outer


def find_base_faces(probe: Probe) -> tuple[float, float]:
    """Return the heights of the base's lower faces over the inner and the outer block, m: those of blocks, films and bonds.

    They are exactly equal where they differ by rounding errors only, as those of "5 mm" and "0.5 cm" may.
    """
    stacks = (0.0, 0.0) if probe.film is None else [film.stack_height for film in probe.film.by_block]
    inner, outer = (height + stack for height, stack in zip((probe.core_height, probe.tube_height), stacks, strict=True))
    return (outer, outer) if math.isclose(inner, outer, rel_tol=1e-14) else (inner, outer)
