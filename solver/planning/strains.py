"""Strain measures of the load rule: effects of tissue depth, layers, blocks and the cover of inclusions.

Per indentation, against a probe with stiff blocks on deep tissue; see ``solver.planning.loads``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

from geometry.common.arrays import Floats, Numeric
from geometry.scenes.probe import Interface, Material
from geometry.scenes.scene_tables import Inclusion, Tissue

RATIO_CHANGE_PER_X = 0.1  # of ratio, stresses and stiffness per x
COVER_COEFFICIENTS = (
    0.55,
    0.05,
    0.5,
    1.3,
)  # of eq. PL.7: the worst of 150 scenes needs 86 % of this factor, half of them an eighth
SHALLOW_COEFFICIENT = (
    25.0  # of eq. PL.5: the worst row needs 97 % of it, at 9 outer radii; at 3 the worst needs 92 %, at one 40 %
)
SOFT_LAYER_COEFFICIENT, EDGE_LENGTH_RELATIVE, THIN_LAYER_RELATIVE = (
    1.6,
    0.1,
    0.02,
)  # of eq. PL.6: the worst of 62 scenes of layer_loads takes 0.8 of its promise
BENDING_COEFFICIENT, PLATE_COEFFICIENT = 1.6, 5.0  # of eq. PL.11, likewise
SLIDING_FACTOR = 2.2  # of frictionless faces: examples/scene.toml's log-sensitivity is 7 % off at 0.039 R, with bonded faces 3 %
LAYERED_RATIO_FACTOR = 1.6  # likewise
CANCELLING_STRESS_SHARE = 0.2  # of eq. PL.10
NEARING_COEFFICIENTS = (1.45, 0.3, 1.6, 0.12)  # of eq. PL.4: 1.2 times what 2263 scenes need; 7 times too much for half of them
SLIM_TUBE_COEFFICIENT = 0.15  # of eq. PL.3: the worst of 360 scenes needs 0.9 of it with this value, and 1.35 times it with 0


def compute_cover_factor(bodies: Iterable[Inclusion]) -> float:
    """Return the factor by which inclusions near the surface increase the effect of finite strain on ratio and stresses.

    What covers them is strained the more the thinner it is, and counts the more the wider they are: with diameter D and cover t
    at most by

        1 + 0.55 max(0, D / (t + 0.05 D) - 0.5)^1.3      (PL.7)

    whatever their moduli and positions off the axis are. The log-sensitivity needs no more than eq. PL.2. Bodies from
    surface files, whose sizes are not known here, count as nothing.
    """
    coefficient, cover_offset, threshold, power = COVER_COEFFICIENTS
    sizes = [(max(body.diameters) if body.diameters is not None else body.diameter or 0.0, body.depth) for body in bodies]
    wide = [size / (max(0.0, depth - size / 2) + cover_offset * size) for size, depth in sizes if size > 0]
    return float(1 + coefficient * max(0.0, max(wide, default=0.0) - threshold) ** power)


def compute_both_strains(
    tube_radius: Numeric, tissue: Tissue, interface: Interface, added: Numeric = 0.0, covered: float = 1.0, *, law: float = 1.0
) -> tuple[Numeric, Numeric]:
    """Return x per indentation, 1/m, for the log-sensitivity, and its counterpart for ratio, stresses and stiffness.

    Layers change these more than the log-sensitivity, stiff ones these alone, and what covers inclusions adds to that: with b, f
    and m of eq. PL.6 and k of eq. PL.7

        indentation sqrt(b^2 ((1.6 sqrt(1 + 5 m) - 0.6)^2 - 1 + k^2) + (1.6 f / R)^2)      (PL.11)

    Parameters
    ----------
    tube_radius
        Outer radius of the probe, m; a float, an array or casadi.
    tissue
        The tissue, of any shape.
    interface
        Interface of the blocks and the tissue.
    added
        What the blocks add to x per indentation, eq. PL.3, 1/m; for the ratio it counts k times.
    covered
        Factor k of eq. PL.7.
    law
        Factor s of eq. PL.12, which multiplies both results.
    """
    deep, soft, plate = _compute_strains(tube_radius, tissue)
    bending = 1 + BENDING_COEFFICIENT * ((1 + PLATE_COEFFICIENT * plate) ** 0.5 - 1)
    ratio_strain = (deep**2 * (bending**2 - 1 + covered**2) + (LAYERED_RATIO_FACTOR * soft) ** 2) ** 0.5
    slides = _get_sliding_factor(interface)
    return law * (compute_tissue_strain(tube_radius, tissue, interface) + added), law * (slides * ratio_strain + covered * added)


def compute_tissue_strain(tube_radius: Numeric, tissue: Tissue, interface: Interface = "bonded") -> Numeric:
    """Return x per indentation on deep, shallow or layered tissue, 1/m.

    Where the bottom is near the tissue is squeezed out from under the probe, which is bad sooner than an indentation of deep
    tissue: with the outer radius R and the depth H

        x = indentation b,   b = sqrt(1/R^2 + (25 R / H^2)^2)      (PL.5)

    bounds all of ``tests/reference/contact/shallow.json``, from H = R on. What layers change is weighted by how much of the
    indentation they take up, so that a layer of the tissue's own material, or one next to nothing thick, changes nothing:

        x = indentation sqrt(b^2 + (f / R)^2)      (PL.6)

    Soft layers are strained more than tissue by as much as they are softer. Down to an interface at depth h let s = E_b / E - 1
    >= 0 be what a material is softer than E_b, the mean modulus below weighted by h / z^2, and w = 1 / (1 + 10 z / R), as the
    blocks' edges strain most what is near them. Then

        f = max over h of 1 / (1/g + h^2 / (25 R^2)),
        g = 1.6 (int s^3 w^3 dz / int s^2 w^2 dz) / (1 + (0.02 R / int s dz)^2),

    as the strain is by s larger, where the layer's compliance counts beside the tissue's, and at most what a bottom there makes.
    Stiff layers carry the load as plates, which is eq. PL.11's: with E_s the harmonic mean below, weighted likewise,

        m = max over h of int max (E / E_s - 1, 0) / (1 + z / R)^2 dz / R.

    ``tests/reference/contact/layered.json`` and ``benchmarks.extremes.layer_loads`` hold it. Faces that are not bonded slide at
    the blocks' edges, which changes the log-sensitivity 2.2 times as soon: all counts that many times.

    Parameters
    ----------
    tube_radius
        Outer radius of the probe, m; a float, an array or casadi.
    tissue
        The tissue, of any shape.
    interface
        Interface of the blocks and the tissue.
    """
    deep, soft, _ = _compute_strains(tube_radius, tissue)
    return _get_sliding_factor(interface) * (deep**2 + soft**2) ** 0.5


def _get_sliding_factor(interface: Interface) -> float:
    """Return the factor by which faces that slide increase x."""
    return 1.0 if interface == "bonded" else SLIDING_FACTOR


def _compute_strains(tube_radius: Numeric, tissue: Tissue) -> tuple[Numeric, Numeric, Numeric]:
    """Return b of eq. PL.5, f / R of eq. PL.6, both 1/m, and m of eq. PL.11, see ``compute_tissue_strain``."""
    squeezed = 0.0 if tissue.shape == "half-space" else SHALLOW_COEFFICIENT * tube_radius / tissue.depth**2
    softest, plate = 0.0 * tube_radius, 0.0 * tube_radius  # zeros of the radius's type: float, array or casadi
    moduli, depths = _list_materials(tissue)
    for k, depth in enumerate(depths[1:], 1):
        mean_below, harmonic_mean = _compute_means_below(moduli[k:], depths[k:])
        spans = list(zip(moduli[:k], depths[:k], depths[1:], strict=False))
        stiffer = [(e, top, bottom) for modulus, top, bottom in spans if (e := modulus / harmonic_mean - 1) > 0]
        softer = [(s, top, bottom) for modulus, top, bottom in spans if (s := mean_below / modulus - 1) > 0]
        if stiffer:
            plate = _choose_greater(
                plate, sum(e * _integrate_edge_weight(tube_radius, top, bottom) for e, top, bottom in stiffer)
            )
        if softer:
            softest = _choose_greater(softest, _compute_soft_strain(tube_radius, softer, depth))
    return (1 / tube_radius**2 + squeezed**2) ** 0.5, softest / tube_radius, plate


def _list_materials(tissue: Tissue) -> tuple[list[float], list[float]]:
    """Return the moduli from the surface down, Pa, and the depths where they begin, m; neighbours of equal moduli are one.

    The tissue's own modulus, below all layers, is the last.
    """
    moduli, depths = list[float](), list[float]()
    all_moduli = [*(layer.youngs_modulus for layer in tissue.layer), tissue.youngs_modulus]
    for modulus, depth in zip(all_moduli, (0.0, *tissue.interfaces), strict=True):
        if not moduli or modulus != moduli[-1]:
            moduli.append(modulus)
            depths.append(depth)
    return moduli, depths


def _compute_means_below(moduli: list[float], depths: list[float]) -> tuple[float, float]:
    """Return the mean and the harmonic mean of the moduli below a depth h, the first of ``depths``, weighted by h / z^2.

    ``depths`` are those where the materials begin, m. The integral of h / z^2 from h to z is 1 - h / z, up to 1.
    """
    begins = [1 - depths[0] / depth for depth in depths] + [1.0]
    weights = [end - begin for begin, end in pairwise(begins)]
    mean = sum(weight * modulus for weight, modulus in zip(weights, moduli, strict=True))
    return mean, 1 / sum(weight / modulus for weight, modulus in zip(weights, moduli, strict=True))


def _compute_soft_strain(tube_radius: Numeric, softer: list[tuple[float, float, float]], depth: float) -> Numeric:
    """Return f of eq. PL.6 for one interface at a depth h, m, from (s, top, bottom) of the softer materials above it."""
    softness = sum(s * (bottom - top) for s, top, bottom in softer)
    square: Numeric = 0.0
    cube: Numeric = 0.0
    for s, top, bottom in softer:
        begin, end = (1 / (1 + z / (EDGE_LENGTH_RELATIVE * tube_radius)) for z in (top, bottom))
        part = s**2 * _integrate_edge_weight(EDGE_LENGTH_RELATIVE * tube_radius, top, bottom)  # of the integral of s^2 w^2
        square, cube = square + part, cube + part * s * (begin + end) / 2
    strained = SOFT_LAYER_COEFFICIENT * cube / square / (1 + (THIN_LAYER_RELATIVE * tube_radius / softness) ** 2)
    return strained / (1 + strained * depth**2 / (SHALLOW_COEFFICIENT * tube_radius**2))


def _integrate_edge_weight(size: Numeric, top: float, bottom: float) -> Numeric:
    """Return the integral of 1 / (1 + z / size)^2 over depths z from top to bottom, m, divided by ``size``."""
    return (bottom - top) / size / ((1 + top / size) * (1 + bottom / size))


def _choose_greater(a: Numeric, b: Numeric) -> Numeric:
    """Return the greater of two floats, arrays or casadi expressions; complex numbers compare by their real parts."""
    # 1 or 0 as a factor, as casadi has no branches
    first = a.real >= b.real if hasattr(a, "real") else a >= b
    return a * first + b * (1 - first)


def compute_cancelling_factor(totals: Floats, areas: tuple[float, float]) -> float:
    """Return the factor by which a film's relative change grows where its pressures nearly cancel.

    Where a stiff layer carries the load to one block, the other's film is pushed here and pulled there. With the films' stresses

        max(1, 0.2 (mean stress) / (lesser stress))      (PL.10)

    Parameters
    ----------
    totals
        Force on each film per indentation, N/m, shape (2,).
    areas
        Areas of the films, m^2.
    """
    stresses = [abs(float(total)) / area for total, area in zip(totals, areas, strict=True)]
    mean, min_stress = abs(float(sum(totals))) / sum(areas), min(stresses)
    return max(1.0, CANCELLING_STRESS_SHARE * mean / min_stress) if min_stress > 0 else 1.0


def compute_block_strain(height: Numeric, strain: Numeric) -> Numeric:
    """Return what a block of given height, m, and mean strain per indentation, 1/m, adds to x per indentation, 1/m: eq. PL.3."""
    return height * strain**2 / RATIO_CHANGE_PER_X


def compute_slimness(radius: Numeric, wall: Numeric) -> Numeric:
    """Return the factor of eq. PL.3 by which a thin tube strains more, for its outer radius and wall thickness, m."""
    return 1 + SLIM_TUBE_COEFFICIENT * radius / wall


def _maximise_over_layers(tube_radius: Numeric, tissue: Tissue, value: Callable[[Material], float]) -> Numeric:
    """Return the maximum of a material's value over tissue and layers, of which thin ones count in part.

    The excess of a layer over the tissue is weighted by T / (T + 0.02 R), see ``bound_nearing``.
    """
    tissue_value = maximum = value(tissue)
    for layer in tissue.layer:
        if value(layer) > tissue_value:
            thickness = sum(thicker.thickness for thicker in tissue.layer if value(thicker) >= value(layer))
            maximum = _choose_greater(
                maximum,
                tissue_value + (value(layer) - tissue_value) * thickness / (thickness + THIN_LAYER_RELATIVE * tube_radius),
            )
    return maximum


def bound_nearing(
    tissue: Tissue, radii: tuple[Numeric, Numeric, Numeric], strains: tuple[Numeric, Numeric], modulus: Numeric
) -> Numeric:
    """Return an upper bound on the approach of the walls at the gap per indentation.

    Per indentation that is

        1.45 e_i r_i + 0.3 e_o w + (1.6 (1 - 2 nu) + 0.12) E / (E + E_o t (1 + 5 t)),   t = w / r_h      (PL.4)

    with the blocks' mean strains e per indentation, the tube's wall w and hole radius r_h, and the tissue's E and nu: both blocks
    widen, and the tissue drags the tube's end inwards, the thinner and softer the more. Layers that are stiffer or more
    compressible count, by the thickness T of all that are as much so, as T / (T + 0.02 R) of the difference.

    Parameters
    ----------
    tissue
        The tissue, of any shape.
    radii
        Radii of the inner block, of the hole and of the tube, m; floats, arrays or casadi.
    strains
        Mean strains e of both blocks per indentation, 1/m.
    modulus
        Young's modulus E_o of the tube, Pa.
    """
    inner_radius, hole, tube_radius = radii
    wall = tube_radius - hole
    thin = wall / hole
    hardest = _maximise_over_layers(tube_radius, tissue, lambda material: material.youngs_modulus)
    min_poisson_ratio = -_maximise_over_layers(tube_radius, tissue, lambda material: -material.poisson_ratio)
    dragged = hardest / (hardest + modulus * thin * (1 + 5 * thin))
    by_inner, by_outer, compressible, constant = NEARING_COEFFICIENTS
    widened = by_inner * strains[0] * inner_radius + by_outer * strains[1] * wall
    return widened + (compressible * (1 - 2 * min_poisson_ratio) + constant) * dragged
