"""Map the scene to the volume mesher's space: the probe's axes with a widened gap and far tissue drawn near.

Tetrahedra of about equal size there are graded in the scene; a hairline gap costs as many of them as a wide one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Points


@dataclass(frozen=True)
class MeshSpace:
    """A one-to-one map of the scene, in the probe's axes, to the mesher's space; lengths in m.

    Attributes
    ----------
    radii
        0, the solid cylinder's, the hole's and the tube's radius, and one far beyond all bodies: (5,), rising.
    moved
        What is added to each of them in the mesher's space: (5,), its first and last two zero.
    rising
        What is added further for each m of height above the tissue: (5,).
    fade
        Depth of tissue at which the widened gap has faded.
    linear_radius
        Distance from the origin beyond which lengths shrink, as the logarithm does.
    """

    radii: tuple[float, ...]
    moved: tuple[float, ...]
    rising: tuple[float, ...]
    fade: float
    linear_radius: float

    def to_mesh(self, points: Points) -> Points:
        """Return the points of the mesher's space for points (n, 3) of the scene.

        The gap is widened first. Then a point at a distance r from the origin beyond R = ``linear_radius`` moves to
        R (1 + ln(r / R)).
        """
        shifted = self._shift(points, inverse=False)
        distance = np.linalg.norm(shifted, axis=1)
        ratio = np.maximum(distance / self.linear_radius, 1.0)
        result: Points = shifted * ((1 + np.log(ratio)) / ratio)[:, None]
        return result

    def to_scene(self, points: Points) -> Points:
        """Return the points of the scene for points (n, 3) of the mesher's space: the inverse of ``to_mesh``."""
        distance = np.linalg.norm(points, axis=1)
        ratio = np.maximum(distance / self.linear_radius, 1.0)
        far = points * (np.exp(ratio - 1) / ratio)[:, None]
        return self._shift(far, inverse=True)

    def compute_scale(self, points: Points) -> Points:
        """Return the ratio of lengths in the mesher's space to those in the scene at points (n, 3), gap excluded: (n,)."""
        result: Points = 1 / np.maximum(np.linalg.norm(points, axis=1) / self.linear_radius, 1.0)
        return result

    def _shift(self, points: Points, inverse: bool) -> Points:
        """Return points (n, 3), their distances from the probe's axis changed so that the gap is wider; back with ``inverse``.

        Radii between two of ``radii`` are interpolated linearly. The change fades with depth and grows with height.
        """
        radius = np.hypot(points[:, 0], points[:, 1])
        fading = np.clip(1 + points[:, 2] / self.fade, 0.0, 1.0)[:, None]
        height = np.clip(points[:, 2], 0.0, self.linear_radius)[:, None]
        scene_radii = np.broadcast_to(np.array(self.radii), (len(points), len(self.radii)))
        mesh_radii = scene_radii + fading * np.array(self.moved) + height * np.array(self.rising)
        source, image = (mesh_radii, scene_radii) if inverse else (scene_radii, mesh_radii)
        index = np.clip((radius[:, None] >= source).sum(axis=1) - 1, 0, len(self.radii) - 2)
        rows = np.arange(len(points))
        low, high = source[rows, index], source[rows, index + 1]
        fraction = (radius - low) / (high - low)
        mapped = image[rows, index] + fraction * (image[rows, index + 1] - image[rows, index])
        # on the axis nothing moves; the inner ``where`` only avoids a division by zero
        factor = np.where(radius > 0, mapped / np.where(radius > 0, radius, 1.0), 1.0)
        result = points.copy()
        result[:, :2] *= factor[:, None]
        return result


def choose_mesh_space(
    inner: float, hole: float, tube: float, *, gap: float, linear_radius: float, height: float = 0.0, rise: float = 0.0
) -> MeshSpace:
    """Return the space in which the gap between ``inner`` and ``hole`` is ``gap`` wide or wider, and ``rise`` more at ``height``.

    Lengths are in m; ``linear_radius`` is as in ``MeshSpace``. The gap is narrower than that where there is no room: at most a
    quarter of the solid cylinder's radius and of the tube's wall is taken.
    """
    lower_shares = _share_growth(max(gap - (hole - inner), 0.0), inner, tube - hole)
    upper_shares = _share_growth(sum(lower_shares) + rise, inner, tube - hole)
    derivatives = [(high - low) / height if height > 0 else 0.0 for low, high in zip(lower_shares, upper_shares, strict=True)]
    # the widening fades over a depth of three times its width
    fade = max(3 * sum(lower_shares), 1e-3 * inner)
    radii = (0.0, inner, hole, tube, 1e6 * tube)
    return MeshSpace(
        radii,
        (0.0, -lower_shares[0], lower_shares[1], 0.0, 0.0),
        (0.0, -derivatives[0], derivatives[1], 0.0, 0.0),
        fade,
        linear_radius,
    )


def _share_growth(add: float, inner: float, wall: float) -> tuple[float, float]:
    """Return by how much the solid cylinder's radius and the tube's wall shrink for a gap that grows by ``add``, all in m.

    Each takes half; where one is at its limit of a quarter, the other takes the rest, up to its own limit.
    """
    outwards = min(add - min(add / 2, inner / 4), wall / 4)
    return min(add - outwards, inner / 4), outwards
