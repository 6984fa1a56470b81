"""Describe the meridian section of a rotationally symmetric scene by numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from itertools import accumulate

import numpy as np

from geometry.common.arrays import Numeric
from geometry.common.json_types import JsonObject
from geometry.meridian.grading import smooth_min

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
    LAYER_0 = 7
    LAYER_1 = 8
    LAYER_2 = 9
    LAYER_3 = 10
    LAYER_4 = 11
    LAYER_5 = 12
    LAYER_6 = 13
    LAYER_7 = 14


LAYERS = tuple(body for body in Body if body >= Body.LAYER_0)
TISSUES = (Body.TISSUE, *LAYERS)


@dataclass(frozen=True)
class Section:
    """Lengths in m, each a float or, for many designs at once, an array (real or complex) of shape (n,).

    ``inner_radius`` < ``hole_radius`` < ``tube_radius`` < ``tissue_radius``; 0 where there is no sphere, film,
    adhesive or elastic base. ``layer_0`` to ``layer_7`` are thicknesses of the tissue's layers from the surface downwards; those
    that are not zero come first. A sphere's centre lies on the axis. ``flange_thickness`` and ``step_height`` are the base's,
    see ``geometry.scenes.base_sizes.BaseSizes``. ``edge_radius`` is that of the blocks' lower edges: their faces end as far from
    their walls. ``mesh_size``, if not zero, takes the place of ``corner_size``.
    """

    inner_radius: Numeric
    hole_radius: Numeric
    tube_radius: Numeric
    inner_height: Numeric
    outer_height: Numeric
    tissue_radius: Numeric
    tissue_depth: Numeric
    sphere_radius: Numeric = 0.0
    sphere_depth: Numeric = 0.0
    film: Numeric = 0.0
    adhesive: Numeric = 0.0
    flange_radius: Numeric = 0.0
    flange_thickness: Numeric = 0.0
    step_height: Numeric = 0.0
    layer_0: Numeric = 0.0
    layer_1: Numeric = 0.0
    layer_2: Numeric = 0.0
    layer_3: Numeric = 0.0
    layer_4: Numeric = 0.0
    layer_5: Numeric = 0.0
    layer_6: Numeric = 0.0
    layer_7: Numeric = 0.0
    edge_radius: Numeric = 0.0
    mesh_size: Numeric = 0.0

    @cached_property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths that are not zero: those by which outputs can be differentiated."""
        names = (field.name for field in fields(self) if field.name != "mesh_size")
        return tuple(name for name in names if _is_present(getattr(self, name)))

    @cached_property
    def block_radii(self) -> JsonObject:
        """Radii of the blocks' walls and, if their edges are round, of the ends of their faces: rising, by name."""
        inner, hole, tube, edge = self.inner_radius, self.hole_radius, self.tube_radius, self.edge_radius
        if not _is_present(edge):
            return {"inner": inner, "hole": hole, "tube": tube}
        inside = {"inner edge": inner - edge, "inner": inner, "hole": hole, "hole edge": hole + edge}
        return inside | {"tube edge": tube - edge, "tube": tube}

    @property
    def has_details(self) -> bool:
        """Whether there is a film or an elastic base."""
        return _is_present(self.film) or _is_present(self.flange_thickness)

    @cached_property
    def interfaces(self) -> list[Numeric]:
        """Depths of the tissue's interfaces, from the surface downwards."""
        thicknesses = (getattr(self, body.name.lower()) for body in LAYERS)
        return list(accumulate(thickness for thickness in thicknesses if _is_present(thickness)))

    @cached_property
    def interfaces_apart(self) -> tuple[int, int]:
        """The numbers of interfaces above the sphere and of those that cross it; without a sphere all count as above."""
        if "sphere_radius" not in self.lengths:
            return len(self.interfaces), 0
        # real parts: lengths are complex where derivatives are computed by complex steps
        tops, bottoms = self.sphere_depth - self.sphere_radius, self.sphere_depth + self.sphere_radius
        count_above = sum(bool(np.all(np.real(depth) <= np.real(tops))) for depth in self.interfaces)
        return count_above, sum(bool(np.all(np.real(depth) < np.real(bottoms))) for depth in self.interfaces[count_above:])

    @cached_property
    def cover(self) -> Numeric:
        """Distance between the sphere's top and the next interface above it, or the surface."""
        count_above, _ = self.interfaces_apart
        return self.sphere_depth - self.sphere_radius - ([0.0, *self.interfaces][count_above])

    @cached_property
    def clearance(self) -> Numeric:
        """Distance between the sphere's bottom and the next interface below it, or the floor."""
        count_below = sum(self.interfaces_apart)
        return [*self.interfaces, self.tissue_depth][count_below] - self.sphere_depth - self.sphere_radius

    @cached_property
    def block_size(self) -> Numeric:
        """A smooth length below the smallest feature at the blocks' corners."""
        return smooth_min(
            self.inner_radius,
            self.hole_radius - self.inner_radius,
            self.tube_radius - self.hole_radius,
            self.tissue_radius - self.tube_radius,
            self.inner_height,
            self.outer_height,
            *([self.edge_radius] if _is_present(self.edge_radius) else []),
        )

    @cached_property
    def under_blocks(self) -> Numeric:
        """Distance between the blocks and what is below them: the first interface, the sphere or the floor."""
        if self.interfaces_apart[0]:
            return self.interfaces[0]
        return self.cover if "sphere_radius" in self.lengths else self.tissue_depth

    @cached_property
    def corner_size(self) -> Numeric:
        """The size to which the mesh is graded at the blocks' corners."""
        if _is_present(self.mesh_size):
            return self.mesh_size
        return smooth_min(self.block_size, self.under_blocks / 4)

    def box_limits(self) -> tuple[Numeric, Numeric]:
        """Return the smallest and the largest radius at which the sphere's box may end, between sphere and tissue's side.

        They are ``NEAREST_BOX`` and ``WIDEST_BOX`` sphere radii, or, where the tissue is narrow, about a third and two thirds of
        the way from the sphere to its side, without a kink between the two.
        """
        s, side_width = self.sphere_radius, self.tissue_radius - self.sphere_radius
        step = smooth_min((NEAREST_BOX - 1) * s, side_width / 3)
        reach = smooth_min((WIDEST_BOX - 1) * s, 2 * side_width / 3)
        return s + step, s + reach


def _is_present(length: Numeric) -> bool:
    """Return whether a length, or every entry of an array of lengths, is not zero."""
    # comparing a plain number takes a hundredth of the time that numpy needs
    return length != 0 if isinstance(length, float | int) else bool(np.all(length != 0))
