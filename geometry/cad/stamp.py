"""Describe the origin of each file for the workshop: design, program and unit; without a date, so that files can be compared."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import version

from geometry.cad.materials import PartMaterial, find_part_materials
from geometry.cad.parts_record import compute_design_digest
from geometry.provenance.block import DISTRIBUTION, Provenance, build_provenance
from geometry.scenes.probe import Probe

LENGTH_UNIT_NAME = "millimetres"


@dataclass(frozen=True)
class Stamp:
    """Origin of a file.

    Attributes
    ----------
    design
        Digest of the probe's numbers, see ``geometry.cad.parts_record.compute_design_digest``.
    program
        Name and version.
    materials
        Of the parts, by their names; parts without a known material are missing.
    provenance
        What made the file, see ``geometry.provenance.block``.
    """

    design: str
    program: str
    materials: dict[str, PartMaterial] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=dict)

    @property
    def text(self) -> str:
        """One line for headers."""
        return f"design {self.design}; {self.program}; {LENGTH_UNIT_NAME}"


def build_stamp(probe: Probe, edge_radius: float = 0.0) -> Stamp:
    """Return the stamp of the files of a probe whose blocks have lower edges of a radius, m."""
    program = f"probe-design {version(DISTRIBUTION)}"
    return Stamp(compute_design_digest(probe, edge_radius), program, find_part_materials(probe), build_provenance())
