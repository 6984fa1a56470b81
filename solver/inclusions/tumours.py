"""Hold many tumours as arrays, and the layers of tissue around them: each sphere lies wholly inside one layer, its matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Tissue
from solver.materials.linear import Isotropic


@dataclass(frozen=True)
class Tumours:
    """Spheres under a probe, on or off its axis: floats or arrays that broadcast to one shape, usually (sets, tumours of a set).

    Attributes
    ----------
    x, y
        Coordinates of the centres from the probe's axis, m.
    depth
        Depths of the centres under the surface, m.
    diameter
        Diameters, m.
    youngs_modulus
        Young's moduli, Pa.
    poisson_ratio
        Poisson's ratios, below 1/2.
    """

    x: Any
    y: Any
    depth: Any
    diameter: Any
    youngs_modulus: Any
    poisson_ratio: Any

    def __post_init__(self) -> None:
        """Broadcast to one shape.

        Raises
        ------
        InputError
            A number is not finite, or a size or modulus not positive.
        """
        arrays = np.broadcast_arrays(*(np.asarray(getattr(self, field.name), dtype=float) for field in fields(self)))
        for field, array in zip(fields(self), arrays, strict=True):
            object.__setattr__(self, field.name, array)
            positive = field.name in ("depth", "diameter", "youngs_modulus")
            if not np.all(np.isfinite(array)) or (positive and not np.all(array > 0)):
                raise InputError(
                    field.name, "not all positive" if positive else "not all finite", "finite numbers, sizes above 0"
                )

    @classmethod
    def from_scene(cls, scene: Scene) -> Self:
        """Return the spheres of a scene, and those of its ellipsoids' volumes, shape (1, inclusions)."""
        placement = scene.placement
        rows = [
            (
                body.x - placement.x,
                body.y - placement.y,
                body.depth,
                _compute_diameter(body),
                body.youngs_modulus,
                body.poisson_ratio,
            )
            for body in scene.inclusion
        ]
        return cls(*np.array(rows, dtype=float).reshape(-1, 6).T[:, None])

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of all the arrays."""
        shape: tuple[int, ...] = self.x.shape
        return shape

    @property
    def offset(self) -> Floats:
        """Distance of the centres from the probe's axis, m."""
        return np.asarray(np.hypot(self.x, self.y))

    @property
    def cover(self) -> Floats:
        """Overburden, the tissue above the spheres, m."""
        return np.asarray(self.depth - self.diameter / 2)

    def with_moduli(self, moduli: Floats, target: int) -> Self:
        """Return k copies of a single set (1, t), with Young's moduli (k,), Pa, for its tumour ``target``; shape (k, t)."""
        all_moduli = np.repeat(self.youngs_modulus, len(moduli), axis=0)
        all_moduli[:, target] = moduli
        return replace(self, youngs_modulus=all_moduli)

    def flatten(self) -> Self:
        """Return all tumours in one row, shape (n,)."""
        return self._map_arrays(np.ravel)

    def select(self, chosen: object) -> Self:
        """Return the tumours with the given indices."""
        return self._map_arrays(lambda values: values[chosen])

    def _map_arrays(self, change: Callable[[Any], Any]) -> Self:
        """Apply a function to all arrays; values are not checked again, as only shapes and selections change."""
        out = object.__new__(type(self))
        for name, values in vars(self).items():
            object.__setattr__(out, name, np.asarray(change(values)))
        return out


def _compute_diameter(body: Inclusion) -> float:
    """Return the diameter of a sphere, or of the sphere of an ellipsoid's volume, m."""
    return body.diameter or float(np.cbrt(np.prod(body.diameters or (np.nan,))))


@dataclass(frozen=True)
class Strata:
    """The materials of a tissue from the surface downwards, and where they meet.

    Attributes
    ----------
    interfaces
        Depths of the k interfaces, m, rising.
    materials
        Materials of the k layers, and last that of the tissue below them.
    """

    interfaces: tuple[float, ...]
    materials: tuple[Material, ...]

    @classmethod
    def from_tissue(cls, tissue: Tissue) -> Strata:
        """Build the strata of a scene's tissue."""
        return cls(tissue.interfaces, (*tissue.layer, tissue))

    def find_layer(self, depth: Floats) -> Ints:
        """Return the index of the material at depths, m, of any shape; an interface belongs to the material below it."""
        return np.asarray(np.searchsorted(self.interfaces, depth, side="right"))

    def find_hosts(self, depth: Floats) -> Isotropic:
        """Return the elastic laws of the tissue at depths, m, of any shape."""
        return Isotropic.from_materials(self.materials).select(self.find_layer(depth))

    def compute_gap(self, tumours: Tumours) -> Floats:
        """Return the distance from each sphere to the nearest interface, m: inf without any, negative where one crosses it."""
        gaps = [np.abs(tumours.depth - depth) - tumours.diameter / 2 for depth in self.interfaces]
        return np.asarray(np.min(gaps, axis=0) if gaps else np.full(tumours.shape, np.inf))

    @cached_property
    def contrasts(self) -> Floats:
        """Contrast of the materials on both sides of each interface: 0 for the same, up to 1, shape (k,).

        The larger of |a - b| / (a + b) for the moduli a, b of both sides: the shear moduli mu, and the moduli of compression
        lambda + 2 mu.
        """
        return np.array([compute_contrast(*pair) for pair in pairwise(self.materials)])


def compute_contrast(upper: Material, lower: Material) -> float:
    """Return the contrast of two materials, see ``Strata.contrasts``."""
    pairs = zip(_compute_moduli(upper), _compute_moduli(lower), strict=True)
    return max(abs(a - b) / (a + b) for a, b in pairs)


def _compute_moduli(material: Material) -> tuple[float, float]:
    """Return the shear modulus and lambda + 2 mu, Pa."""
    law = Isotropic.from_material(material)
    return law.shear_modulus, law.dilation_modulus + law.two_mu
