"""The meridian section of a rotationally symmetric scene as numbers, and its kind."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np

from geometry.meridian.grading import Lengths, smooth_min

# how far from the axis the box round a sphere may end, in the sphere's radii
NEAREST_BOX, WIDEST_BOX = 1.25, 2.5


class Body(IntEnum):
    """The bodies of the meridian plane."""

    TISSUE = 0
    INNER = 1
    OUTER = 2
    INCLUSION = 3
    FILM = 4
    ADHESIVE = 5
    BASE = 6


@dataclass(frozen=True)
class Section:
    """Lengths in m, each a float or, for many designs at once, an array (real or complex) of shape (n,).

    ``inner_radius`` < ``hole_radius`` < ``tube_radius`` < ``tissue_radius``; 0 where there is no sphere, film,
    adhesive or elastic base. A sphere's centre lies on the axis. ``flange_thickness`` and ``step_height`` are the base's,
    see ``geometry.scenes.base_sizes.BaseSizes``. ``mesh_size``, if not zero, takes the place of ``corner_size``.
    """

    inner_radius: Lengths
    hole_radius: Lengths
    tube_radius: Lengths
    inner_height: Lengths
    outer_height: Lengths
    tissue_radius: Lengths
    tissue_depth: Lengths
    sphere_radius: Lengths = 0.0
    sphere_depth: Lengths = 0.0
    film: Lengths = 0.0
    adhesive: Lengths = 0.0
    flange_radius: Lengths = 0.0
    flange_thickness: Lengths = 0.0
    step_height: Lengths = 0.0
    mesh_size: Lengths = 0.0

    @property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths that are not zero: those by which outputs can be differentiated."""
        names = (field.name for field in fields(self) if field.name != "mesh_size")
        return tuple(name for name in names if np.all(getattr(self, name) != 0))

    @property
    def has_layers(self) -> bool:
        """Whether there is a film or an elastic base."""
        return bool(np.all(self.film != 0) or np.all(self.flange_thickness != 0))

    @property
    def cover(self) -> Any:
        """Tissue above the sphere."""
        return self.sphere_depth - self.sphere_radius

    @property
    def clearance(self) -> Any:
        """Tissue below the sphere."""
        return self.tissue_depth - self.sphere_depth - self.sphere_radius

    @property
    def block_size(self) -> Any:
        """A smooth length below the smallest feature at the blocks' corners."""
        return smooth_min(
            self.inner_radius,
            self.hole_radius - self.inner_radius,
            self.tube_radius - self.hole_radius,
            self.tissue_radius - self.tube_radius,
            self.inner_height,
            self.outer_height,
        )

    @property
    def layer(self) -> Any:
        """Tissue between the blocks and what is below them: the sphere or the floor."""
        return self.cover if "sphere_radius" in self.lengths else self.tissue_depth

    @property
    def corner_size(self) -> Any:
        """The size to which the mesh is graded at the blocks' corners."""
        if np.all(self.mesh_size != 0):
            return self.mesh_size
        return smooth_min(self.block_size, self.layer / 4)

    def box_limits(self) -> tuple[Any, Any]:
        """Between which radii the sphere's box may end: a smooth choice between sphere and tissue's side."""
        s, beside = self.sphere_radius, self.tissue_radius - self.sphere_radius
        step = smooth_min((NEAREST_BOX - 1) * s, beside / 3)
        reach = smooth_min((WIDEST_BOX - 1) * s, 2 * beside / 3)
        return s + step, s + reach
