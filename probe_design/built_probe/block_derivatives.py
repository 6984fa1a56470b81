"""Differentiate what both films read on a block of tissue by the probe's numbers, the block's modulus and that of soft bonds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import STACKS, Body
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.gradients import compute_gradients
from solver.results.film_charges import reads_film_states

UNIT_LOAD = Load(force=0.01)  # N: derivatives are those at a given load, whatever its size


class Derivatives(NamedTuple):
    """Derivatives on a reference with respect to the design's variables, per SI unit, shape (v - 1,) both."""

    log_ratio: Floats  # of ln(F_inner / F_outer)
    load_factor: Floats  # of ln sigma


def list_soft_bonds(probe: Probe) -> list[Body]:
    """List the bodies of the films' soft bonds."""
    if probe.film is None:
        return []
    pairs = [
        pair for film, stack in zip(probe.film.by_block, STACKS, strict=True) for pair in zip(film.bonds, stack[::2], strict=True)
    ]
    return [body for bond, body in pairs if (bond.youngs_modulus or math.inf) <= probe.film.soft_limit]


def differentiate_by_moduli(solution: Converged, bodies: Sequence[Body], charges: bool) -> Floats:
    """Return the derivatives of ln of each film's force, or charge, under a given load, by ln of some bodies' moduli, shape (2,).

    They are the energies in these bodies; ``charges`` are the lower half of the products.
    """
    states, totals = solution.sample.states, solution.sample.totals[0]
    present = np.intersect1d(states.model.mesh.body, bodies)
    changes = np.sum([states.compute_modulus_derivative(Body(body)).sum(axis=1) for body in present], axis=0)
    if len(present) == 0:
        return np.zeros(2)
    films = slice(2, 4) if charges else slice(0, 2)
    return np.asarray(changes[films] / totals[films] - changes[:2].sum() / totals[:2].sum())


def differentiate_block(scene: Scene, solution: Converged, names: tuple[str, ...], shares: Floats) -> Derivatives:
    """Return the derivatives on one block; ``shares`` are the films' fractions of the sum of both, shape (2,)."""
    gradient = compute_gradients(scene.model_copy(update={"load": UNIT_LOAD}), solution.sample)
    prefix = "charge" if reads_film_states(scene) else "stress"
    # of the logarithm of each film's charge, or stress, under a given load: d ln x = dx / x
    by_film = [
        dict(zip(gradient.variables, gradient.derivatives[key][0] / gradient.values[key][0], strict=True))
        for key in (f"{prefix}_inner", f"{prefix}_outer")
    ]
    moved = [differentiate_area_ratio(scene.probe, name) if prefix == "stress" else 0.0 for name in names]
    inner, outer = (np.array([logs.get(name, 0.0) for name in names]) for logs in by_film)
    return Derivatives(inner - outer + moved, shares[0] * inner + shares[1] * outer)


def differentiate_area_ratio(probe: Probe, name: str) -> float:
    """Return the derivative of ln(A_inner / A_outer), the areas' ratio, with respect to a number of the scene, 1/m.

    It converts a ratio of stresses to one of forces. The outer area is that of the ring between hole and outer radius.
    """
    ring = probe.outer_area / math.pi  # r_outer^2 - r_hole^2, with r_hole = r_inner + gap
    hole = 2 * probe.hole_radius / ring
    derivatives = {"probe.inner_radius": 2 / probe.inner_radius + hole, "probe.gap": hole}
    return (derivatives | {"probe.outer_radius": -2 * probe.tube_radius / ring}).get(name, 0.0)
