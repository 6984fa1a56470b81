"""Errors of the closed form's charges: quantiles, which the true errors are below in 95 % of the scenes of each class.

They are exp(c + sum of w_k x_k) as those of the forces (eq. CF.19), with features of the films and their bonds beside those of
the scene. Errors of charges are relative to the charges themselves, those of the log-sensitivity absolute.
``python -m benchmarks.closed_form.charge_error`` fits weights and constants to drawn scenes on the axis whose charges
``axisymmetric`` computes, and writes them to ``CHARGE_TABLES``. Off the axis the larger constant of bare tissue and of near sides
is stated. Layered scenes have weights of their own, and more features: where the parts of a charge nearly cancel, its error is
relative to these. Where glue between block and film stretches with a film that floats on tape, membranes are further off than in
most of those scenes, as glue and film bend: with g the glue's stiffness in its plane over the film's, and f the part of the
film that floats, ln(1 + 2 g f) is added. An elastic base bends and stretches the film that a bond holds on it, which neither
formulas nor drawn scenes have; a bound on that charge is added, see ``_bound_base_charges``. So is one where the bond to the base
is thick for the film, which then is no membrane on springs, see ``_bound_squeezed_charges``.
"""

from __future__ import annotations

import math

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.film import Bond
from geometry.scenes.scene import Scene
from solver.closed_form.designs import Shape
from solver.closed_form.error_quantile import CHARGE_CLASSES, StatedErrors, classify, compute_features, read_quantiles
from solver.closed_form.film_membrane import MIN_GLUE_MODULUS
from solver.results.detail_compliance import CHARGE_CHANGE_FACTOR, FILM_DETAIL, iterate_details

CHARGE_TABLES = dict.fromkeys(CHARGE_CLASSES, "charge_error_quantiles.json") | {"layered": "layered_charge_error_quantiles.json"}
CHARGE_QUANTITIES = ("charge_ratio", "charge_inner", "charge_outer", "charge_log_sensitivity")
GLUE_ERROR_FACTOR = 2.0  # covers 76 of 79 inner films with glue to the block and tape to the base; without it 71
BASE_STRAIN_FACTOR = 5.0  # covers 96 of 98 charges, see ``benchmarks.closed_form.base_charges``
HELD_WIDTH_SQUARED = 8.0  # of a disc that a bond holds, a fraction x^2 / (x^2 + 8) of the base's strain passes to it; x small
SQUEEZE_FACTOR = 6.0  # covers 155 of 160 charges of films of 1 to 60 um on bonds 0.7 to 15 shear lengths thick; without it 135
SPRING_LENGTHS_SQUARED = 8.0  # a bond x shear lengths thick is no layer of springs by the part x^2 / (x^2 + 8); x small
MIN_CHARGE = 1e-300  # C/m, in place of a charge of zero, which has no relative error
MAX_EXPONENT = 20.0  # beyond it a charge is far below its error
CANCELLED_PARTS = 4.0  # parts of a charge over itself from which on its error is relative to the parts; clamped films have 3 to 6


def state_charge_errors(scene: Scene, shape: Shape, values: Floats, products: Floats, derivatives: Floats) -> StatedErrors:
    """Return the 95 % quantiles of the errors of a scene's charges; ``log_totals`` holds relative errors.

    Parameters
    ----------
    scene
        The scene, with films.
    shape
        Its structure.
    values
        Its parameters, see ``designs.build_parameters``, shape (parameters,).
    products
        Forces, N/m, and charges, C/m, shape (4, 2); positive total forces.
    derivatives
        Their derivatives by the logarithm of the target's modulus, shape (4, 2).
    """
    kind, features = classify(shape), compute_charge_features(scene, shape, values, products, derivatives)
    table = read_quantiles(CHARGE_TABLES.get(kind, CHARGE_TABLES["bare"]))
    kinds = [kind] if kind in CHARGE_CLASSES else list(table["constants"])
    exponents = [
        max(table["constants"][name][quantity] for name in kinds)
        + sum(weight * features[key] for key, weight in table["weights"][quantity].items())
        for quantity in CHARGE_QUANTITIES
    ]
    ratio, inner, outer, sensitivity = (math.exp(min(exponent, MAX_EXPONENT)) for exponent in exponents)
    glued = _bound_glue_errors(scene)
    totals = np.array([inner, outer]) + glued
    ratio += float(add_glue_to_ratio(*glued))
    forces = products[:2]
    for detail in iterate_details(scene.probe):
        if detail.name != FILM_DETAIL:  # films are modelled
            bound = detail.compute_bound(forces)
            totals = totals + CHARGE_CHANGE_FACTOR * bound.totals / forces.sum(axis=1)
            ratio += CHARGE_CHANGE_FACTOR * bound.log_ratio
    strained = _bound_base_charges(scene) + _bound_squeezed_charges(scene)
    stretched = strained * forces.sum(axis=1) / np.maximum(np.abs(products[2:].sum(axis=1)), MIN_CHARGE)
    totals, largest = totals + stretched, float(stretched.max())
    ratio += math.log1p(largest)  # both charges grow, so that the ratio changes by the larger growth at most
    sensitivity += largest / (1 + largest) * _sum_sensitivities(products, derivatives)
    return StatedErrors(ratio, totals, float(totals.max()), sensitivity)


def _bound_base_charges(scene: Scene) -> Floats:
    """Return a bound on the charges per force that an elastic base adds to both films by stretching them, C/N, shape (2,).

    A film that moves with the base has the base's strains, which are as the pressure over the base's modulus E_b, so that its
    charge per force is as d_p E / E_b, with E the film's modulus and d_p the mean of d31 and d32. On a bond that slips over a
    length l less of the strain passes to a film of width l x.
    """
    probe = scene.probe
    if probe.film is None or probe.base.youngs_modulus is None:
        return np.zeros(2)
    charges = []
    for width, film in zip((probe.inner_radius, probe.tube_radius - probe.hole_radius), probe.film.by_block, strict=True):
        widths_squared = (width / film.shear_length) ** 2
        held = widths_squared / (widths_squared + HELD_WIDTH_SQUARED)
        lateral = abs(film.d31 + film.d32) / 2
        charges.append(BASE_STRAIN_FACTOR * held * lateral * film.youngs_modulus / probe.base.youngs_modulus)
    return np.array(charges)


def _bound_squeezed_charges(scene: Scene) -> Floats:
    """Return a bound on what formulas add to both charges per force where thin films lie on thick glue, C/N, shape (2,).

    Within a shear length l of its edges the film widens with the bond that is squeezed out under it, as s_a e of eq. CF.27: on
    the mean d_p (1 + nu) s_a / t times the edges' share 2 l / width. A bond thicker than l is squeezed out less there.
    """
    probe = scene.probe
    if probe.film is None:
        return np.zeros(2)
    charges = []
    for width, film in zip((probe.inner_radius, probe.tube_radius - probe.hole_radius), probe.film.by_block, strict=True):
        to_block, to_base = film.bonds
        ratio, decay = to_base.poisson_ratio or 0.0, film.shear_length
        squeezed = to_base.thickness * ratio / (2 * (1 - ratio)) / film.thickness
        lengths_squared = (to_base.thickness / decay) ** 2
        part = lengths_squared / (lengths_squared + SPRING_LENGTHS_SQUARED)
        # glue between block and film holds both
        stiffness = to_block.thickness * _get_glue_modulus(to_block) / (film.thickness * film.youngs_modulus)
        edges = min(1.0, 2 * decay / width) / (1 + stiffness)
        charges.append(SQUEEZE_FACTOR * abs(film.mean_lateral_charge) * (1 + film.poisson_ratio) * squeezed * part * edges)
    return np.array(charges)


def _get_glue_modulus(bond: Bond) -> float:
    """Return the modulus of a bond that is glue, Pa; 0 of tape and of a rigid bond."""
    return bond.youngs_modulus if bond.youngs_modulus is not None and bond.youngs_modulus >= MIN_GLUE_MODULUS else 0.0


def _sum_sensitivities(products: Floats, derivatives: Floats) -> float:
    """Return the sum of the absolute log-sensitivities of both charges to the target's modulus."""
    totals = np.maximum(np.abs(products[2:].sum(axis=1)), MIN_CHARGE)
    return float(np.sum(np.abs(derivatives[2:].sum(axis=1)) / totals))


def _bound_glue_errors(scene: Scene) -> Floats:
    """Return what glue between block and film adds to the errors of both charges, shape (2,); see the module's docstring."""
    probe = scene.probe
    widths, added = (probe.inner_radius, probe.tube_radius - probe.hole_radius), []
    for width, film in zip(widths, () if probe.film is None else probe.film.by_block, strict=True):
        bond, decay = film.bonds[0], film.shear_length
        stiffness = bond.thickness * _get_glue_modulus(bond) / (film.thickness * film.youngs_modulus)
        added.append(math.log1p(GLUE_ERROR_FACTOR * stiffness * decay / (width + decay)))
    return np.array(added)


def add_glue_to_ratio(inner: Floats, outer: Floats) -> Floats:
    """Return what is added to the error of the ratio of charges where glue adds these to each: in equal stacks half is common."""
    return np.asarray(np.abs(inner - outer) + np.minimum(inner, outer) / 2)


def compute_charge_features(
    scene: Scene, shape: Shape, values: Floats, products: Floats, derivatives: Floats
) -> dict[str, float]:
    """Return the features of the charges' errors: those of the forces, and some of the inner and of the outer film.

    - thick stack: height of film and bonds over the block's width, which membranes neglect;
    - held: how little the bond to the base lets the film widen, so that the film's edge counts;
    - opposed charges: parts of a charge beyond their sum, as where the parts by d31 and by d33 are of opposite sign;
    - soft bond: how far the block slips on its bond, compared with its width;
    - stiff block: its stiffness over that of the film in its plane;
    - target: as of the forces, of charges;
    - floating glue: what ``state_charge_errors`` adds for glue between block and a film that floats;
    - cancelled: sizes of a charge's parts, by d33 and by d31 and d32 or by the motions of both bases, over the charge beyond
      ``CANCELLED_PARTS``; with the weight 1 the error of a charge near zero is relative to its parts. Cancelled: the larger.

    See ``state_charge_errors`` for the arguments.
    """
    probe, film = scene.probe, scene.probe.film
    assert film is not None
    shared = compute_features(shape, values[:, None], products[None, :2], derivatives[None, :2])
    features = {key: float(feature[0]) for key, feature in shared.items()}
    forces, charges = products[:2].sum(axis=1), products[2:]
    totals = charges.sum(axis=1)
    widths = probe.inner_radius, probe.tube_radius - probe.hole_radius
    blocks = (probe.inner, probe.outer)
    heights = probe.core_height, probe.tube_height
    for k, (name, block_film) in enumerate(zip(("inner", "outer"), film.by_block, strict=True)):
        width, modulus = widths[k], blocks[k].youngs_modulus
        decay, slip = block_film.shear_length, block_film.slips[0]
        floor = 1e-300 + abs(totals[k])
        opposed = (np.abs(charges[k]).sum() + abs(block_film.d33) * forces[k]) / floor
        in_plane = block_film.thickness * block_film.youngs_modulus
        features |= {
            f"thick stack {name}": math.log(0.003 + block_film.stack_height / width),
            f"held {name}": math.log(0.03 + width / (width + decay)),
            f"opposed charges {name}": math.log(float(opposed)),
            f"soft bond {name}": math.log(0.01 + slip * modulus / width),
            f"stiff block {name}": math.log(0.001 + modulus * width / in_plane),
            f"flat {name}": math.log(0.1 + heights[k] / width),
        }
    features["target"] = math.log(1e-7 + float(np.abs(derivatives[2:].sum(axis=1) / np.where(totals == 0, 1e-300, totals)).sum()))
    glued = _bound_glue_errors(scene)
    normal = np.array([block_film.d33 for block_film in film.by_block]) * forces
    parts = np.maximum(np.abs(normal) + np.abs(totals - normal), np.abs(charges).sum(axis=1))
    cancelled = np.log(np.maximum(parts / np.maximum(np.abs(totals), MIN_CHARGE) / CANCELLED_PARTS, 1.0))
    for k, name in enumerate(("inner", "outer")):
        features |= {f"floating glue {name}": float(glued[k]), f"cancelled {name}": float(cancelled[k])}
    return features | {"cancelled": float(cancelled.max())}
