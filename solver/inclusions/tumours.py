"""Hold many tumours as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Inclusion, Scene


@dataclass(frozen=True)
class Tumours:
    """Spheres under a probe, on or off its axis: floats or arrays that broadcast to one shape, usually (sets, tumours of a set).

    Attributes
    ----------
    x, y
        Of the centres from the probe's axis, m.
    depth
        Of the centres under the surface, m.
    diameter
        m.
    youngs_modulus
        Pa.
    poisson_ratio
        Below 1/2.
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
        """Of all the arrays."""
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
        """Return one set (1, t) once for each Young's modulus (k,) of one of its tumours, shape (k, t)."""
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
        """Apply a function to all arrays without checking values: only shapes change."""
        out = object.__new__(type(self))
        for name, values in vars(self).items():
            object.__setattr__(out, name, np.asarray(change(values)))
        return out


def _compute_diameter(body: Inclusion) -> float:
    """Return the diameter of a sphere, or of the sphere of an ellipsoid's volume, m."""
    return body.diameter or float(np.cbrt(np.prod(body.diameters or (np.nan,))))
