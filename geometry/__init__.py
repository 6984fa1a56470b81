"""The probe and its scene as shapes: parameters, files, meridian meshes, solids, STEP.

CAD (``geometry.cad.solids``, ``geometry.cad.export``) and meshes are imported where they are needed.
"""

from geometry.common.errors import ExportError, InputError, MissingLibrary, ProbeError, Refusal, SolveError
from geometry.scenes.probe import Base, Film, Groove, Material, Probe
from geometry.scenes.scene import (
    BlockTissue,
    Contact,
    CylinderTissue,
    HalfSpaceTissue,
    Inclusion,
    Load,
    Placement,
    Scene,
)
from geometry.scenes.scene_file import read_scene, scene_from_dict, scene_from_toml, scene_to_dict, scene_to_toml

__all__ = [
    "Base",
    "BlockTissue",
    "Contact",
    "CylinderTissue",
    "ExportError",
    "Film",
    "Groove",
    "HalfSpaceTissue",
    "Inclusion",
    "InputError",
    "Load",
    "Material",
    "MissingLibrary",
    "Placement",
    "Probe",
    "ProbeError",
    "Refusal",
    "Scene",
    "SolveError",
    "read_scene",
    "scene_from_dict",
    "scene_from_toml",
    "scene_to_dict",
    "scene_to_toml",
]
