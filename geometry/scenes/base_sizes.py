"""Dimensions of the base: those given, the others from the probe."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.common.errors import InputError
from geometry.scenes.probe import Probe, mm


@dataclass(frozen=True)
class BaseSizes:
    """Dimensions of the base in m: a step of the tube's radius below a wider flange.

    Attributes:
        flange_radius: radius of the flange.
        thickness: of the flange.
        step_height: from the higher of the two films to the flange, so that the flange stays whole.
    """

    flange_radius: float
    thickness: float
    step_height: float


def base_sizes(probe: Probe) -> BaseSizes:
    """Dimensions of the base; left out, 1.25 outer radii, 0.3 outer radii but at least 1 mm, and 0.2 outer radii.

    Raises:
        InputError: the flange is narrower than the tube.
    """
    base, radius = probe.base, probe.tube_radius
    flange = 1.25 * radius if base.flange_radius is None else base.flange_radius
    if flange < radius:
        raise InputError("probe.base.flange_radius", mm(flange), f"at least the tube's outer radius of {mm(radius)}")
    thickness = max(0.3 * radius, 1e-3) if base.thickness is None else base.thickness
    return BaseSizes(flange, thickness, 0.2 * radius if base.step_height is None else base.step_height)
