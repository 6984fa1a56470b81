"""The parts of a mesh that have one material each: bodies cut by the reference cylinder and by the planes between layers."""

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
SPAN = INCLUSION + MOST_INCLUSIONS  # numbers of one layer


class Region(NamedTuple):
    """A body's part.

    Attributes:
        body: as in ``TetMesh``.
        layer: of tissue, as there.
        outside: whether it is an inclusion's part outside the reference cylinder.
    """

    body: int
    layer: int = 0
    outside: bool = False

    @property
    def number(self) -> int:
        """By which ``Solid`` knows it: the body's own where there are no layers."""
        inside = self.body + SPAN * self.layer
        return -1 - inside if self.outside else inside

    @classmethod
    def of(cls, number: int) -> Region:
        """Return the region of a number."""
        layer, body = divmod(-1 - number if number < 0 else number, SPAN)
        return cls(body, layer, number < 0)


def numbers(mesh: TetMesh) -> Ints:
    """The region of each element, (t,)."""
    inside = mesh.body + SPAN * mesh.layer
    return np.where((mesh.body >= INCLUSION) & mesh.beyond, -1 - inside, inside)


def tissue_at(scene: Scene, layer: int) -> Material:
    """The tissue's material in a layer, as ``TetMesh`` numbers them."""
    return scene.tissue.layer[layer - 1] if layer else scene.tissue


def tissue_about(scene: Scene, depth: float) -> Material:
    """The tissue's material at a depth."""
    return (*scene.tissue.layer, scene.tissue)[bisect_right(scene.tissue.interfaces, depth)]


def own_material(scene: Scene, number: int) -> Material | None:
    """A region's material in the scene; None for what the groove takes away."""
    region, probe = Region.of(number), scene.probe
    if region.body >= INCLUSION:
        return scene.inclusion[region.body - INCLUSION]
    return {INNER: probe.inner, OUTER: probe.outer, GROOVE: None}.get(region.body, tissue_at(scene, region.layer))


def reference_material(scene: Scene, number: int) -> Material | None:
    """A region's material in the reference: the layer's in inclusions, the tube's in the groove; None beyond the cylinder."""
    region, probe = Region.of(number), scene.probe
    if region.outside or region.body == BEYOND:
        return None
    if region.body >= TISSUE:
        return tissue_at(scene, region.layer)
    return probe.inner if region.body == INNER else probe.outer


def without_inclusions(scene: Scene, number: int) -> Elastic:
    """A region's material in what is factorised: tissue in and beyond the cylinder, something between tube and air in the groove.

    Steps of both solutions grow with the contrast: air's for the reference, the tube's for the scene.
    """
    region, probe = Region.of(number), scene.probe
    if region.body == GROOVE:
        return Isotropic(GROOVED * probe.outer.youngs_modulus, probe.outer.poisson_ratio)
    if region.body >= TISSUE:
        return tissue_at(scene, region.layer)
    return probe.inner if region.body == INNER else probe.outer
