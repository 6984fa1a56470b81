"""Probes to be exported and drawn, and what their files hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geometry.cad import solids
from geometry.scenes.film import Film
from geometry.scenes.probe import Base, Material, Probe
from geometry.scenes.units import SI_CONTEXT

RUBBER = Material(youngs_modulus=1e6, poisson_ratio=0.4)
FILM = Film(thickness=110e-6)
FLANGE = Base(rigid=True, flange_radius=9e-3, thickness=3e-3, step_height=2e-3)


def make(
    inner_radius: float = 5e-3,
    area_ratio: float = 3.7,
    gap: float = 1e-4,
    height: float = 5e-3,
    groove: tuple[float, float] | None = (2e-3, 1e-3),
    film: Film | None = FILM,
    **fields: Any,
) -> Probe:
    """A probe with a groove of that width and depth, or none; other heights, sizes and bases take the place of those here."""
    cut = None if groove is None else {"width": groove[0], "depth": groove[1]}
    heights = {} if "inner_height" in fields else {"height": height}
    sizes = {} if "outer_radius" in fields else {"area_ratio": area_ratio}
    blocks = {"inner": RUBBER, "outer": RUBBER}
    values = {"inner_radius": inner_radius, "gap": gap, "groove": cut, "film": film}
    return Probe.model_validate({**values, **heights, **sizes, **blocks, **fields}, context=SI_CONTEXT)


def read(path: Path) -> Any:
    """The shape in a STEP file, through the plain reader (``geometry.cad.export`` uses the one with names and colours)."""
    cq = solids.load_cadquery()
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    assert int(reader.ReadFile(str(path))) == 1
    reader.TransferRoots()
    return cq.Shape.cast(reader.OneShape())
