"""Features from which the closed form's errors are estimated: ten numbers, each large where one approximation is rough.

Most come from how the formulas' own results change once something is changed: more functions, sides modelled or left out, a
block a little stiffer, no spheres. The others are powers of ratios of lengths. Of the logarithms of ratio and totals
``FEATURE_NAMES`` are

- always: one;
- finer: what both totals change with fifteen tractions for eleven, and with more functions in the blocks instead of eq. CF.10;
- sides: what is changed by modelling sides that are far enough to be left out, or by leaving out those of layers, and a tenth of
  what is changed by leaving out other near ones. Blocks of tissue are taken as cylinders;
- near sides: (outer radius / way to the side)^8. Tractions on the cut are smoothed;
- crowded spheres: what spheres change of the larger total, times (radius / way)^6 to the nearest of surface, interfaces, floor
  and sides and twice (radius / way to the side)^3. Their images are of few moments, and they have none in the sides;
- soft shell: the larger total's derivative by the logarithms of both blocks' moduli, times (hole / outer radius)^8
  ln(1 + height / wall). Shells bend over short ways;
- hairline gap: how much either block's modulus changes the other's total, where the gap is below 0.005 of either width and the
  inner block small. Tractions at its edges are singular in another way;
- cancelled: what forces there are beyond their sum. Errors of terms are those of a small difference;
- thin tissue: x^3 / (1 + x^2) of x = outer radius / depth. Pressures on a squeezed layer have details;
- interfaces: contrast / (1 + 100 depth / outer radius) of layers of tissue, summed, times 1 + cancelled / 20. Pressures on a
  film have details, and a skin passes them from block to block.

Of the log-sensitivity sides change what they change, and finer functions what the target changes of either total; the others are
what it changes of both, times the factors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Inclusion, Scene
from solver.closed_form.lateral_boundary import compute_side_radius, count_side_nodes

FEATURE_NAMES = (
    "always", "finer", "sides", "near sides", "crowded spheres",
    "soft shell", "hairline gap", "cancelled", "thin tissue", "interfaces",
)  # fmt: skip
PARAMETER_VARIANTS = ("scene", "inner_modulus", "outer_modulus", "no inclusions")  # the variants with other parameters
ALL_VARIANTS = (*PARAMETER_VARIANTS, "sides", "finer")  # and those with another formula
MODULUS_STEP_FACTOR = 1.05  # by which the moduli of the variants are multiplied
MODELLED_SIDES_FACTOR = 0.1  # fraction of the sides' effect that counts where sides are modelled
HAIRLINE_GAP_RELATIVE = 0.005  # of a block's width: about that of the rings at its edges


def compute_features(scene: Scene, forces: Floats, slopes: Floats) -> dict[str, Floats]:
    """Return each feature for ln(ratio), the logarithms of inner and outer total, and the log-sensitivity, shape (4,).

    Args:
        scene: the scene.
        forces: of the variants ``ALL_VARIANTS``; positive totals, N/m, shape (6, 2, 2).
        slopes: their derivatives by the logarithm of the target's modulus, shape (6, 2, 2).
    """
    changes = _Changes.from_variants(forces, slopes)
    target_effect = _compute_target_effect(scene, forces, slopes)
    constant = np.array([1.0, 1.0, 1.0, target_effect])
    spheres = np.array([*[changes.spheres.max()] * 3, target_effect])
    cross_effect = max(changes.ends[0, 1], changes.ends[1, 0])
    cancelled = float((np.abs(forces[0]).sum(axis=1) / forces[0].sum(axis=1) - 1).max())
    return {
        "always": constant,
        "finer": changes.finer,
        "sides": changes.sides * (MODELLED_SIDES_FACTOR if _has_modelled_sides(scene) else 1.0),
        "near sides": constant * _compute_edge_ratio(scene) ** 8,
        "crowded spheres": spheres * max((_compute_crowding(scene, body) for body in scene.inclusion), default=0.0),
        "soft shell": constant * changes.ends.sum(axis=0).max() * _compute_shell_thinness(scene),
        "hairline gap": constant * cross_effect * _compute_gap_narrowness(scene),
        "cancelled": constant * cancelled,
        "thin tissue": constant * _compute_tissue_thinness(scene),
        "interfaces": constant * _sum_interface_contrasts(scene) * (1 + cancelled / 20),
    }


@dataclass(frozen=True)
class _Changes:
    """Differences between the variants and the scene.

    Attributes:
        sides: of all quantities, by the sides, shape (4,).
        finer: of both totals' logarithms added, three times, and of both shares of the target, by more functions, shape (4,).
        spheres: of both totals' logarithms, by all spheres, shape (2,).
        ends: of both totals' logarithms (columns) by the logarithm of either block's modulus (rows), shape (2, 2).
    """

    sides: Floats
    finer: Floats
    spheres: Floats
    ends: Floats

    @classmethod
    def from_variants(cls, forces: Floats, slopes: Floats) -> _Changes:
        totals = forces.sum(axis=2)
        logs, shares = np.log(totals), slopes.sum(axis=2) / totals
        quantities = np.column_stack([logs @ [1, -1], logs, shares @ [1, -1]])
        ends = np.abs(logs[1:3] - logs[0]) / math.log(MODULUS_STEP_FACTOR)
        finer = [np.abs(values[5] - values[0]).sum() for values in (logs, logs, logs, shares)]
        return cls(np.abs(quantities[4] - quantities[0]), np.array(finer), np.abs(logs[3] - logs[0]), ends)


def _has_modelled_sides(scene: Scene) -> bool:
    """Return whether the tissue's sides are modelled: they are near, and the tissue is of one material."""
    tissue = scene.tissue
    if tissue.shape == "half-space" or tissue.layer:
        return False
    return count_side_nodes(scene.probe.tube_radius, tissue.depth, compute_side_radius(tissue)) > 0


def _compute_target_effect(scene: Scene, forces: Floats, slopes: Floats) -> float:
    """Return how much the target's modulus changes both totals, with the part that saturates at high contrast added."""
    if scene.target is None:
        return 0.0
    body = scene.inclusion[scene.target]
    times = body.youngs_modulus / _find_host_modulus(scene, body)
    shares = np.abs(slopes.sum(axis=2) / forces.sum(axis=2)).sum(axis=1)
    return float(shares[0] + shares[3] * min(times, 1 / times))


def _find_host_modulus(scene: Scene, body: Inclusion) -> float:
    """Return Young's modulus of the tissue around a sphere, Pa."""
    tissue = scene.tissue
    layers = zip(tissue.interfaces, tissue.layer, strict=True)
    return next((layer.youngs_modulus for lower, layer in layers if body.depth < lower), tissue.youngs_modulus)


def _compute_crowding(scene: Scene, body: Inclusion) -> float:
    """Return a measure of how near a sphere is to surface, interfaces, floor and sides."""
    tissue, radius = scene.tissue, (body.diameter or 0.0) / 2
    distances = [abs(body.depth - depth) for depth in (0.0, *tissue.interfaces)]
    if tissue.shape != "half-space":
        distances.append(tissue.depth - body.depth)
    side_ratio = min(1.0, radius / _compute_side_distance(scene, body.x, body.y))
    return max(radius / min(distances), side_ratio) ** 6 + 2 * side_ratio**3


def _compute_edge_ratio(scene: Scene) -> float:
    """Return the outer radius over the distance from the probe's axis to the nearest side."""
    return scene.probe.tube_radius / max(
        _compute_side_distance(scene, scene.placement.x, scene.placement.y), 1e-9 * scene.probe.tube_radius
    )


def _compute_side_distance(scene: Scene, x: float, y: float) -> float:
    """Return the distance from (x, y) to the tissue's nearest side, m."""
    tissue = scene.tissue
    if tissue.shape == "half-space":
        return math.inf
    if tissue.shape == "cylinder":
        return tissue.radius - math.hypot(x, y)
    return min(tissue.length / 2 - abs(x), tissue.breadth / 2 - abs(y))


def _compute_shell_thinness(scene: Scene) -> float:
    """Return a measure of how thin and tall the shell of the outer block is."""
    probe = scene.probe
    wall = probe.tube_radius - probe.hole_radius
    return (probe.hole_radius / probe.tube_radius) ** 8 * math.log1p(probe.tube_height / wall)


def _compute_gap_narrowness(scene: Scene) -> float:
    """Return how narrow the gap is relative to the blocks, times how small the inner block is relative to the outer; 0 to 1."""
    probe = scene.probe
    narrowest = HAIRLINE_GAP_RELATIVE * min(probe.inner_radius, probe.tube_radius - probe.hole_radius)
    return (1 - probe.inner_radius / probe.tube_radius) ** 4 / (1 + probe.gap / narrowest)


def _compute_tissue_thinness(scene: Scene) -> float:
    """Return x^3 / (1 + x^2) of x = outer radius / tissue depth; 0 on a half-space."""
    tissue = scene.tissue
    thin = 0.0 if tissue.shape == "half-space" else scene.probe.tube_radius / tissue.depth
    return thin**3 / (1 + thin**2)


def _sum_interface_contrasts(scene: Scene) -> float:
    """Return the sum of the interfaces' modulus contrasts, each weighted less the deeper it is."""
    tissue = scene.tissue
    moduli = [*(layer.youngs_modulus for layer in tissue.layer), tissue.youngs_modulus]
    sides = zip(tissue.interfaces, pairwise(moduli), strict=True)
    return sum(
        abs(E - lower_modulus) / (E + lower_modulus) / (1 + 100 * z / scene.probe.tube_radius) for z, (E, lower_modulus) in sides
    )
