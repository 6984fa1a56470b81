"""The probe and its scene as shapes: parameters, files, meridian meshes, solids, STEP.

What a user calls:

    read_scene        a scene of a TOML file (docs/reference/scene-file.md)
    scene_from_toml   of its text; scene_from_dict: of its tables
    scene_to_toml     the text of such a file; scene_to_dict: its tables
    Scene             what is pressed on what: Probe, tissue, Inclusion, Contact, Placement, Load;
                      Scene.from_file(name); scene.replace({"probe.gap": "0.2 mm"}); scene.plot()
    Probe             two blocks of a Material each; Base, Film and Groove where it has them
    CylinderTissue    tissue, or BlockTissue, or HalfSpaceTissue
    InputError        bad input, in one line; Refusal: of a scene that an evaluator cannot take; SolveError, ExportError,
                      MissingLibrary: likewise named; ProbeError: any of them

Numbers are in SI units. CAD (``geometry.cad.solids``, ``geometry.cad.export``) and meshes are imported where they are needed.
"""

from geometry.common.errors import ExportError, InputError, MissingLibrary, ProbeError, Refusal, SolveError
from geometry.scenes.film import Film
from geometry.scenes.probe import Base, Groove, Material, Probe
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene, scene_from_dict, scene_from_toml, scene_to_dict, scene_to_toml
from geometry.scenes.scene_tables import BlockTissue, Contact, CylinderTissue, HalfSpaceTissue, Inclusion, Load, Placement

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
