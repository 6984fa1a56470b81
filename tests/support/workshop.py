"""A probe's package for the workshop, and what a reader of DXF that is not the writer finds in it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import dxf_parser

from geometry.scenes.probe import Probe
from geometry.workshop.tolerance import Budget
from tests.support.parts import FLANGE, make

EDGE = 0.2e-3
BUDGET = Budget(1.0, {"inner_radius": 0.02, "outer_height": 0.5}, {"inner_radius": 0.6, "outer_height": 0.05})


def probe() -> Probe:
    return make(base=FLANGE)


def entities(path: Path, kind: str) -> list[dict[str, Any]]:
    """Entities of a kind in model space."""
    return [entity for entity in dxf_parser.parse(path.read_bytes())["entities"] if entity["type"] == kind]


def distance(dimension: dict[str, Any]) -> float:
    """What a linear dimension measures between its points, or the size of a radius."""
    if "linearOrAngularPoint1" not in dimension:
        return float(dimension["actualMeasurement"])
    first, second = dimension["linearOrAngularPoint1"], dimension["linearOrAngularPoint2"]
    angle = math.radians(dimension["angle"])
    return abs((second["x"] - first["x"]) * math.cos(angle) + (second["y"] - first["y"]) * math.sin(angle))


def outlines(path: Path, layer: str) -> list[list[tuple[float, float, float]]]:
    """Closed outlines of a layer: corners and bulges."""
    polylines = [entity for entity in entities(path, "LWPOLYLINE") if entity["layer"] == layer]
    assert all(entity["shape"] for entity in polylines)  # closed
    return [[(corner["x"], corner["y"], corner.get("bulge", 0.0)) for corner in entity["vertices"]] for entity in polylines]
