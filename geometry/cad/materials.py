"""Name the material of each part for drawings and STEP files: by the catalogue where the scene refers to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry.scenes.catalogue import find_material
from geometry.scenes.probe import Material, Probe
from geometry.scenes.units import format_modulus

STIFFEST_CAST = 50e6  # Pa: above the hardest castable silicones and polyurethane rubbers, below the softest plastics
KIND_OF_PROCESS = {"casting": "elastomer", "machining": "solid material"}  # of a block that has no name, by how it is made
PVDF_DENSITY = 1780.0
"""kg/m^3, of poled PVDF film: Measurement Specialties, Piezo Film Sensors Technical Manual (1999), p. 3."""


@dataclass(frozen=True)
class PartMaterial:
    """A part's material.

    Attributes
    ----------
    name
        In the catalogue, or of the kind of material.
    properties
        Required properties, with units.
    density
        In kg/m^3; None where it is not known.
    process
        How the part is made, a name in ``geometry/workshop/processes.toml``.
    """

    name: str
    properties: str
    density: float | None = None
    process: str = "machining"

    @property
    def text(self) -> str:
        """Name and properties in one line."""
        return f"{self.name}, {self.properties}"


def find_part_materials(probe: Probe) -> dict[str, PartMaterial]:
    """Return the materials of a probe's parts by their names, as ``geometry.cad.solids.build_parts`` has them."""
    base = probe.base
    if base.youngs_modulus is None or base.poisson_ratio is None:
        kind, properties = "rigid material", "metal or glass-filled polymer, far stiffer than the blocks"
    else:
        kind, properties = "elastic material", describe_elastic(base.youngs_modulus, base.poisson_ratio)
    stiff = PartMaterial(
        base.material or kind, properties, process=_find_process_name(base.material, base.youngs_modulus or math.inf)
    )
    films = {}
    if probe.film is not None:
        films = {
            name: PartMaterial("piezoelectric PVDF film", describe_elastic(film.youngs_modulus, film.poisson_ratio), PVDF_DENSITY)
            for name, film in zip(("film-inner", "film-outer"), probe.film.by_block, strict=True)
        }
    return {"inner": _build_block_material(probe.inner), "outer": _build_block_material(probe.outer), **films, "base": stiff}


def describe_elastic(youngs_modulus: float, poisson_ratio: float) -> str:
    """Write both constants of an isotropic material (Pa, 1)."""
    return f"E = {format_modulus(youngs_modulus)}, Poisson's ratio {poisson_ratio:g}"


def _build_block_material(material: Material) -> PartMaterial:
    """Return the material of a block for drawings and STEP files."""
    loss = f", tan delta {material.loss_factor:g}" if material.loss_factor else ""
    properties = describe_elastic(material.youngs_modulus, material.poisson_ratio) + loss
    process = _find_process_name(material.material, material.youngs_modulus)
    return PartMaterial(material.material or KIND_OF_PROCESS[process], properties, process=process)


def _find_process_name(name: str | None, youngs_modulus: float) -> str:
    """Return the process by which a part is made: from the catalogue, or from its modulus (Pa) alone."""
    if name is not None:
        return find_material(name).process
    return "casting" if youngs_modulus < STIFFEST_CAST else "machining"
