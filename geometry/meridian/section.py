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
    BASE = 4
    INNER_BOND_TO_BLOCK = 5
    INNER_FILM = 6
    INNER_BOND_TO_BASE = 7
    OUTER_BOND_TO_BLOCK = 8
    OUTER_FILM = 9
    OUTER_BOND_TO_BASE = 10
    LAYER_0 = 11
    LAYER_1 = 12
    LAYER_2 = 13
    LAYER_3 = 14
    LAYER_4 = 15
    LAYER_5 = 16
    LAYER_6 = 17
    LAYER_7 = 18


LAYERS = tuple(body for body in Body if body >= Body.LAYER_0)
TISSUES = (Body.TISSUE, *LAYERS)
BLOCKS, FILMS = (Body.INNER, Body.OUTER), (Body.INNER_FILM, Body.OUTER_FILM)
STACKS = (
    (Body.INNER_BOND_TO_BLOCK, Body.INNER_FILM, Body.INNER_BOND_TO_BASE),
    (Body.OUTER_BOND_TO_BLOCK, Body.OUTER_FILM, Body.OUTER_BOND_TO_BASE),
)  # layers on the inner and the outer block, from the block to the base


@dataclass(frozen=True)
class Section:
    """Lengths in m, each a float or, for many designs at once, an array (real or complex) of shape (n,).

    ``inner_radius`` < ``hole_radius`` < ``tube_radius`` < ``tissue_radius``; 0 where there is no sphere, layer
    or elastic base. The layers of ``STACKS`` lie on the blocks; ``inner_inset`` and ``outer_inset`` are the distances from the
    films' free edges to their electrodes.
    ``layer_0`` to ``layer_7`` are thicknesses of the tissue's layers from the surface downwards; those
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
    inner_bond_to_block: Numeric = 0.0
    inner_film: Numeric = 0.0
    inner_bond_to_base: Numeric = 0.0
    outer_bond_to_block: Numeric = 0.0
    outer_film: Numeric = 0.0
    outer_bond_to_base: Numeric = 0.0
    inner_inset: Numeric = 0.0
    outer_inset: Numeric = 0.0
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
        """Radii of the blocks' walls, of the ends of faces with round edges and of electrodes inside films: rising, by name."""
        walls = {"inner": (self.inner_radius, -1), "hole": (self.hole_radius, 1), "tube": (self.tube_radius, -1)}
        insets = {"inner": self.inner_inset, "hole": self.outer_inset, "tube": self.outer_inset}
        radii: JsonObject = {}
        for wall, (radius, inwards) in walls.items():
            radii[wall] = radius
            if _is_present(self.edge_radius):
                radii[f"{wall} edge"] = radius + inwards * self.edge_radius
            if _is_present(insets[wall]):
                radii[f"{wall} electrode"] = radius + inwards * insets[wall]
        return dict(sorted(radii.items(), key=lambda entry: float(np.min(np.real(entry[1])))))

    @cached_property
    def stacks(self) -> tuple[tuple[Body, ...], ...]:
        """The layers that lie on the inner and on the outer block, from the block upwards."""
        return tuple(tuple(body for body in stack if _is_present(getattr(self, body.name.lower()))) for stack in STACKS)

    @cached_property
    def top_heights(self) -> tuple[Numeric, Numeric]:
        """Heights of the upper ends of the inner and the outer block with the layers on them."""
        inner, outer = (
            height + sum(getattr(self, body.name.lower()) for body in stack)
            for height, stack in zip((self.inner_height, self.outer_height), self.stacks, strict=True)
        )
        return inner, outer

    @property
    def has_details(self) -> bool:
        """Whether there are layers on the blocks or an elastic base."""
        return any(self.stacks) or _is_present(self.flange_thickness)

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

    def compute_box_limits(self) -> tuple[Numeric, Numeric]:
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
