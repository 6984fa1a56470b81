"""Cache volume meshes by content: a mesh of the same bodies and sizes, by the same sources and versions, is read back.

The folder is the user's cache, or the one that the environment variable ``PROBE_DESIGN_CACHE`` names. A file is written
whole or not at all and carries its checksum: one that does not match is made again. Of processes that mesh the same at the same
time the first to write it wins, and all use its mesh: pytetwild makes different meshes of one scene, and results would differ
(netgen makes one).
"""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from geometry import mesh_programs
from geometry.common.cached_arrays import find_cache_folder, read_arrays, write_arrays
from geometry.scenes.scene import Scene
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesher import mesh_layout
from geometry.tetra.sizing import COARSE_FINENESS, TetraFineness
from geometry.tetra.tet_mesh import TetMesh

SOURCE_FOLDER = Path(__file__).parent
PROGRAM_FOLDER = Path(mesh_programs.__file__).parent


def read_or_make_mesh(
    scene: Scene,
    fineness: TetraFineness = COARSE_FINENESS,
    half: bool = False,
    tissue_extent: float | None = None,
    reference_radius: float | None = None,
) -> TetMesh:
    """Mesh a scene, tilt and films left out, or read its mesh from the cache.

    A cache that cannot be read or written costs time only. It keeps nothing of a mesh that was not finished.

    Parameters
    ----------
    scene
        The scene.
    fineness
        ``ROUGH_FINENESS``, ``COARSE_FINENESS``, ``FINE_FINENESS`` or other sizes.
    half
        Mesh only y >= 0 (probe's axes) of a scene that is its own mirror image there.
    tissue_extent
        Radius and depth in m that stand for a half-space's, left out 25 outer radii or more. Other tissue that reaches further
        becomes a cylinder of that radius about the probe's axis, deeper tissue as deep; left out, it stays.
    reference_radius
        Of the reference cylinder about the probe's axis, in m; left out, the tissue's own side where it is coaxial, else as large
        as there is room for.

    Returns
    -------
    TetMesh
        The mesh, nodes in m.

    Raises
    ------
    InputError
        A surface file that cannot be used.
    Refusal
        See ``geometry.tetra.layout.build_layout``.
    SolveError
        No mesh passed the checks, or pytetwild failed; the text says why.
    KeyboardInterrupt
        Ctrl-C, at once.
    """
    layout = build_layout(scene, half, find_extent(scene, tissue_extent), reference_radius)
    path = find_cache_folder("meshes") / f"{compute_key(layout, fineness)}.mesh"
    mesh = _read_mesh(path)
    if mesh is None:
        mesh, _ = mesh_layout(layout, fineness)
        _write_mesh(path, mesh)
        mesh = _read_mesh(path) or mesh  # that of another process if it was the first to write
    return mesh


def compute_key(layout: BodyLayout, fineness: TetraFineness) -> str:
    """Return a hash of all that determines the mesh: its numbers, a surface file's triangles, our sources and the versions."""
    digest = hashlib.sha256(
        f"{compute_source_digest()} {version('netgen-mesher')} {version('pytetwild')} {np.__version__} {fineness!r}".encode()
    )
    for part in fields(layout):
        _update_digest(digest, getattr(layout, part.name))
    return digest.hexdigest()


@cache
def compute_source_digest() -> str:
    """Return the digest of this package's sources and the meshers' programs, read once per process."""
    digest = hashlib.sha256()
    for path in sorted(SOURCE_FOLDER.glob("*.py")) + sorted(PROGRAM_FOLDER.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _update_digest(digest: hashlib._Hash, value: object) -> None:
    """Add a value to a digest: an array, a tuple or dataclass of values, or anything else by its ``repr``."""
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype} {value.shape} ".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple):
        digest.update(f"({len(value)} ".encode())
        for part in value:
            _update_digest(digest, part)
    elif is_dataclass(value) and not isinstance(value, type):
        digest.update(type(value).__name__.encode())
        for part in fields(value):
            _update_digest(digest, getattr(value, part.name))
    else:
        digest.update(f"{value!r} ".encode())


def _read_mesh(path: Path) -> TetMesh | None:
    """Read the mesh in a file; None if there is none that is whole."""
    arrays = read_arrays(path)
    return None if arrays is None else TetMesh(**arrays | {"half": bool(arrays["half"])})


def _write_mesh(path: Path, mesh: TetMesh) -> None:
    """Write a mesh to a file, unless the file is there or cannot be written."""
    write_arrays(path, {field.name: np.asarray(getattr(mesh, field.name)) for field in fields(mesh)})
