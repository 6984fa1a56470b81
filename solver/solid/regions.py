"""Number the regions of a mesh with one material each: bodies cut by the reference cylinder and by layer planes."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Ints
from geometry.scenes.probe import Material
from geometry.scenes.scene import MOST_INCLUSIONS, Scene
from geometry.tetra.tet_mesh import BEYOND, GROOVE, INCLUSION, INNER, OUTER, TISSUE, TetMesh
from solver.solid.body_stiffness import Elastic, Isotropic

GROOVED = 0.05  # of the tube's modulus: 30 steps on groove-over-tumour, where 1, 0.1, 0.03 and 0.01 take 45, 32, 30 and 31
SPAN = INCLUSION + MOST_INCLUSIONS  # numbers reserved for one layer


class Region(NamedTuple):
    """A part of a body.

    Attributes:
        body: number of the body, as in ``TetMesh``.
        layer: layer of the tissue, as in ``TetMesh``.
        outside: whether it is the part of an inclusion outside the reference cylinder.
    """

    body: int
    layer: int = 0
    outside: bool = False

    @property
    def number(self) -> int:
        """Number of the region in ``Solid``; without layers, the body's number."""
        inside = self.body + SPAN * self.layer
        return -1 - inside if self.outside else inside

    @classmethod
    def of(cls, number: int) -> Region:
        """Return the region with a number."""
        layer, body = divmod(-1 - number if number < 0 else number, SPAN)
        return cls(body, layer, number < 0)


def numbers(mesh: TetMesh) -> Ints:
    """Return the number of each element's region, (t,)."""
    inside = mesh.body + SPAN * mesh.layer
    return np.where((mesh.body >= INCLUSION) & mesh.beyond, -1 - inside, inside)


def tissue_at(scene: Scene, layer: int) -> Material:
    """Return the tissue's material in a layer, numbered as in ``TetMesh``."""
    return scene.tissue.layer[layer - 1] if layer else scene.tissue


def tissue_about(scene: Scene, depth: float) -> Material:
    """Return the tissue's material at a depth, m."""
    return (*scene.tissue.layer, scene.tissue)[bisect_right(scene.tissue.interfaces, depth)]


def own_material(scene: Scene, number: int) -> Material | None:
    """Return a region's material in the scene; None for the groove."""
    region, probe = Region.of(number), scene.probe
    if region.body >= INCLUSION:
        return scene.inclusion[region.body - INCLUSION]
    return {INNER: probe.inner, OUTER: probe.outer, GROOVE: None}.get(region.body, tissue_at(scene, region.layer))


def reference_material(scene: Scene, number: int) -> Material | None:
    """Return a region's material in the reference: tissue in inclusions, tube in the groove; None outside the cylinder."""
    region, probe = Region.of(number), scene.probe
    if region.outside or region.body == BEYOND:
        return None
    if region.body >= TISSUE:
        return tissue_at(scene, region.layer)
    return probe.inner if region.body == INNER else probe.outer


def without_inclusions(scene: Scene, number: int) -> Elastic:
    """Return a region's material for the factor: tissue everywhere in the tissue, a soft tube material in the groove.

    The iterations of both solutions grow with the groove's contrast: the scene has nothing there, the reference the tube.
    """
    region, probe = Region.of(number), scene.probe
    if region.body == GROOVE:
        return Isotropic(GROOVED * probe.outer.youngs_modulus, probe.outer.poisson_ratio)
    if region.body >= TISSUE:
        return tissue_at(scene, region.layer)
    return probe.inner if region.body == INNER else probe.outer
