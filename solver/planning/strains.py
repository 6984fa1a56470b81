"""What is strained: by how much tissue, layers, blocks and what covers an inclusion raise what the rule for loads counts with.

Per indentation, against a probe with stiff blocks on deep tissue; see ``solver.planning.loads``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from geometry.scenes.scene import Inclusion, Tissue

RATIO_CHANGE = 0.1  # of ratio, stresses and stiffness per x
COVERED = (0.55, 0.05, 0.5, 1.3)  # of eq. PL.7: the worst of 150 scenes needs 86 % of what it says, half of them an eighth
SHALLOW = 25.0  # of eq. PL.5: the worst row needs 97 % of it, at 9 outer radii; at 3 the worst needs 92 %, at one 40 %
NEARING = (1.45, 0.3, 1.6, 0.12)  # of eq. PL.4: 1.2 times what 2263 scenes need; 7 times too much for half of them
SLIM = 0.15  # of eq. PL.3: the worst of 360 scenes needs 0.9 of what it says then, and 1.35 times that with 0 and no sum


def cover_factor(bodies: Iterable[Inclusion]) -> float:
    """Return by how many times inclusions near the surface raise what finite strain changes of ratio, stresses and stiffness.

    What covers them is strained the more the thinner it is, and counts the more the wider they are: with diameter D and cover t
    at most by

        1 + 0.55 max(0, D / (t + 0.05 D) - 0.5)^1.3      (PL.7)

    whatever their moduli are and wherever beside the axis they lie. The log-sensitivity needs no more than eq. PL.2. Bodies from
    surface files, whose sizes are not known here, count as nothing.
    """
    share, least, nothing, power = COVERED
    sizes = [(max(body.diameters) if body.diameters is not None else body.diameter or 0.0, body.depth) for body in bodies]
    wide = [size / (max(0.0, depth - size / 2) + least * size) for size, depth in sizes if size > 0]
    return float(1 + share * max(0.0, max(wide, default=0.0) - nothing) ** power)


def tissue_strain(tube_radius: Any, tissue: Tissue) -> Any:
    """Return x per indentation on deep, shallow or layered tissue, 1/m.

    Where the bottom is near the tissue is squeezed out from under the probe, which is bad sooner than an indentation of deep
    tissue: with the outer radius R and the depth H

        x = indentation sqrt(1/R^2 + (25 R / H^2)^2)      (PL.5)

    bounds all of ``tests/reference/contact/shallow.json``, from H = R on. Layers are such bottoms, each by the share of its own
    modulus that what is softer above it lacks; and a stiff layer on soft material carries the load by bending, where strain comes
    sooner: with c the largest modulus of a layer over any below it

        x = indentation (1.5 sqrt(c) - 0.5) sqrt(1/R^2 + (25 R max (1 - E_above / E_below) / H^2)^2)      (PL.6)

    which is 1.7 to 80 times what ``tests/reference/contact/layered.json`` needs, whose c is 100 at most, and 1.3 times what the
    worst scene of ``benchmarks.extremes.load_bounds --seed 1`` does; a larger c counts as the square of a tenth of it.

    Args:
        tube_radius: outer radius of the probe, m; a float, an array or casadi.
        tissue: of any shape.
    """
    bottoms, bending = _bottoms_and_bending(tissue)
    return (1.5 * bending**0.5 - 0.5) * (1 / tube_radius**2 + (SHALLOW * tube_radius * bottoms) ** 2) ** 0.5


def _bottoms_and_bending(tissue: Tissue) -> tuple[float, float]:
    """Largest (1 - E_above / E_below) / H^2 of floor and interfaces, 1/m^2, and c of eq. PL.6."""
    bottoms, bending = 0.0 if tissue.shape == "half-space" else 1 / tissue.depth**2, 1.0
    moduli = [*(layer.youngs_modulus for layer in tissue.layer), tissue.youngs_modulus]
    for k, depth in enumerate(tissue.interfaces):
        above, below = moduli[: k + 1], moduli[k + 1 :]
        bottoms = max(bottoms, (1 - min(above) / max(below)) / depth**2)
        bending = max(bending, moduli[k] / min(below))
    return bottoms, max(bending, (bending / 10) ** 2)


def block_strain(height: Any, strain: Any) -> Any:
    """What a block of a height, m, and a mean strain per indentation, 1/m, adds to x per indentation, 1/m: eq. PL.3."""
    return height * strain**2 / RATIO_CHANGE


def slimness(radius: Any, wall: Any) -> Any:
    """How many times as much a tube of an outer radius and a wall, m, adds: eq. PL.3."""
    return 1 + SLIM * radius / wall


def most_nearing(tissue: Tissue, radii: tuple[Any, Any, Any], strains: tuple[Any, Any], modulus: Any) -> Any:
    """By how much the walls at the gap near each other per indentation at most.

    Per indentation that is

        1.45 e_i r_i + 0.3 e_o w + (1.6 (1 - 2 nu) + 0.12) E / (E + E_o t (1 + 5 t)),   t = w / r_h      (PL.4)

    with the blocks' mean strains e per indentation, the tube's wall w and hole radius r_h, and the tissue's E and nu, the largest
    and the least of its layers: both blocks widen, and the tissue drags the tube's end inwards, the thinner and softer the more.

    Args:
        tissue: of any shape.
        radii: of the inner block, of the hole and of the tube, m; floats, arrays or casadi.
        strains: e of both blocks, 1/m.
        modulus: E_o of the tube, Pa.
    """
    inner_radius, hole, tube_radius = radii
    wall = tube_radius - hole
    thin = wall / hole
    materials = (tissue, *tissue.layer)
    hardest, least = max(one.youngs_modulus for one in materials), min(one.poisson_ratio for one in materials)
    dragged = hardest / (hardest + modulus * thin * (1 + 5 * thin))
    by_inner, by_outer, compressible, rest = NEARING
    widened = by_inner * strains[0] * inner_radius + by_outer * strains[1] * wall
    return widened + (compressible * (1 - 2 * least) + rest) * dragged
