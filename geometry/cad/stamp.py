"""What every file for the workshop says of itself: which design, by which program, in which unit; no date, so files compare."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import version

from geometry.cad.materials import PartMaterial, part_materials
from geometry.cad.record import design_of
from geometry.provenance.block import Provenance, provenance
from geometry.scenes.probe import Probe

UNITS = "millimetres"


@dataclass(frozen=True)
class Stamp:
    """Origin of a file.

    Attributes:
        design: digest of the probe's numbers, see ``geometry.cad.record.compute_design_digest``.
        program: name and version.
        materials: of the parts, by their names; a part that is missing has none to be told.
        provenance: what made the file, see ``geometry.provenance.block``.
    """

    design: str
    program: str
    materials: dict[str, PartMaterial] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=dict)

    @property
    def text(self) -> str:
        """One line for headers."""
        return f"design {self.design}; {self.program}; {UNITS}"


def stamp_of(probe: Probe, edge_radius: float = 0.0) -> Stamp:
    """Stamp the files of a probe whose lower edges have that radius (m)."""
    program = f"probe-design {version('probe-design')}"
    return Stamp(design_of(probe, edge_radius), program, part_materials(probe), provenance())
