"""Number the regions of a mesh with one material each: bodies cut by the reference cylinder and by layer planes."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Ints
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import MAX_INCLUSIONS
from geometry.tetra.tet_mesh import MeshBody, TetMesh
from solver.materials.linear import Elastic, Isotropic

GROOVE_MODULUS_RELATIVE = (
    0.05  # of the tube's modulus: 30 steps on groove-over-tumour, where 1, 0.1, 0.03 and 0.01 take 45, 32, 30 and 31
)
NUMBERS_PER_LAYER = MeshBody.FIRST_INCLUSION + MAX_INCLUSIONS  # numbers reserved for one layer


class Region(NamedTuple):
    """A part of a body.

    Attributes
    ----------
    body
        Number of the body, as in ``TetMesh``.
    layer
        Layer of the tissue, as in ``TetMesh``.
    outside
        Whether it is the part of an inclusion outside the reference cylinder.
    """

    body: int
    layer: int = 0
    outside: bool = False

    @property
    def number(self) -> int:
        """Number of the region in ``Solid``; without layers, the body's number."""
        inside = self.body + NUMBERS_PER_LAYER * self.layer  # regions outside have negative numbers, from -1
        return -1 - inside if self.outside else inside

    @classmethod
    def from_number(cls, number: int) -> Region:
        """Return the region that has a number; the inverse of ``number``."""
        layer, body = divmod(-1 - number if number < 0 else number, NUMBERS_PER_LAYER)
        return cls(body, layer, number < 0)


def number_elements(mesh: TetMesh) -> Ints:
    """Return the number of each element's region, (t,)."""
    inside = mesh.body + NUMBERS_PER_LAYER * mesh.layer
    return np.where((mesh.body >= MeshBody.FIRST_INCLUSION) & mesh.beyond, -1 - inside, inside)


def find_layer_material(scene: Scene, layer: int) -> Material:
    """Return the tissue's material in a layer, numbered as in ``TetMesh``."""
    return scene.tissue.layer[layer - 1] if layer else scene.tissue  # 0 is the tissue below all layers


def find_material_at_depth(scene: Scene, depth: float) -> Material:
    """Return the tissue's material at a depth, m."""
    return (*scene.tissue.layer, scene.tissue)[bisect_right(scene.tissue.interfaces, depth)]


def find_scene_material(scene: Scene, number: int) -> Elastic | None:
    """Return a region's material in the scene; None for the groove."""
    body = Region.from_number(number).body
    if body >= MeshBody.FIRST_INCLUSION:
        return scene.inclusion[body - MeshBody.FIRST_INCLUSION]
    return None if body == MeshBody.GROOVE else find_base_material(scene, number)


def find_reference_material(scene: Scene, number: int) -> Elastic | None:
    """Return a region's material in the reference: tissue in inclusions, tube in the groove; None outside the cylinder."""
    region = Region.from_number(number)
    if region.outside or region.body == MeshBody.BEYOND:
        return None
    return scene.probe.outer if region.body == MeshBody.GROOVE else find_base_material(scene, number)


def find_base_material(scene: Scene, number: int) -> Elastic:
    """Return a region's material for the factor: tissue everywhere in the tissue, a soft tube material in the groove.

    The iterations of both solutions grow with the groove's contrast: the scene has nothing there, the reference the tube.
    """
    region, probe = Region.from_number(number), scene.probe
    if region.body == MeshBody.GROOVE:
        return Isotropic(GROOVE_MODULUS_RELATIVE * probe.outer.youngs_modulus, probe.outer.poisson_ratio)
    if region.body >= MeshBody.TISSUE:
        return find_layer_material(scene, region.layer)
    return probe.inner if region.body == MeshBody.INNER else probe.outer
