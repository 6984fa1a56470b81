"""Bound how much more a load changes the films' charges than the forces on them.

A film on a soft bond to the base is stretched by the shear below its block. Finite strain changes this shear, and with it the
charge, by up to 7.5 times the bound on film forces (122 scenes with films, x up to 0.3). With rigid bonds, glue and with
tape towards the block alone charges change as forces do. The log-sensitivity of charges has no rule of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import BaseStates
from solver.elements.quadrilateral import project_dilations
from solver.elements.unit_square import UnitSquare
from solver.materials.hyperelastic import RR, TT, ZZ, Hyperelastic, compute_volume_change
from solver.planning.loads import LoadRule

SOFT_BOND_FACTOR = 1.5  # on eq. PL.13 where eq. PL.14 cannot be computed: the worst of 73 scenes needs 1.37
CHANGE_MARGIN_FACTOR = 2.0  # on the change at a light load: 35 presses need 1.22; 73, on a coarser mesh, needed 1.73
TESTED_X = 0.02, 0.005, 0.00125  # x of the light load: the first that turns no part of a mesh inside out, as thin tape may be


def has_soft_bond(scene: Scene) -> bool:
    """Return whether charges of a scene are modelled and a film has a soft bond to the base."""
    if scene.probe.film is None or not scene.models_charges:
        return False
    bonds = [film.bonds[1] for film in scene.probe.film.by_block]
    return any(not bond.is_rigid and not bond.is_glue for bond in bonds)


def add_charges(rule: LoadRule, factor: float) -> LoadRule:
    """Return a rule whose bound on the changes of ratio and stresses covers those of the charges, ``factor`` times as large."""
    return replace(rule, covered=factor * rule.covered)


def compute_charge_factor(scene: Scene, states: BaseStates, rule: LoadRule) -> float:
    """Compute the factor for a scene without tumours at a light load.

    With c the largest change of a charge per indentation, and of their ratio, under a load for which b bounds those of forces,
    it is

        max(1, 2 c / b)      (PL.14)

    Parameters
    ----------
    scene
        Without tumours, its contact tied.
    states
        Its base states and, where charges are modelled, film states.
    rule
        The rule for film forces on it.
    """
    if not has_soft_bond(scene):
        return 1.0
    if states.model.films is None:
        return SOFT_BOND_FACTOR
    for x in TESTED_X:
        indentation = x / rule.strain
        # charges per indentation, relative to those at rest
        inner, outer = compute_loaded_charges(states, indentation) / (indentation * states.products[2:].sum(axis=1))
        change = max(abs(inner - 1), abs(outer - 1), abs(inner / outer - 1))
        bound = rule.bound_ratio_change(rule.stiffness * indentation)
        if np.isfinite([change, bound]).all():
            return max(1.0, CHANGE_MARGIN_FACTOR * float(change) / bound)
    return SOFT_BOND_FACTOR


def compute_loaded_charges(states: BaseStates, indentation: float) -> Floats:
    """Return the charges of both films at an indentation, m, in ``CHARGE_UNIT``, shape (2,), to second order in it.

    They are NaN where these displacements turn a part of the mesh inside out.

    The stresses of finite strain belong to the displacements of linear elasticity, and are not in equilibrium. A film state is
    the adjoint of its charge: its energy with them is the charge after one step of Newton's method, with the tangent at rest.
    """
    model = states.model
    square, law = UnitSquare.from_geometry(model.geometry, model.shapes), Hyperelastic.from_moduli(model.law)
    lam, diagonal = law.lam[:, None], [RR, ZZ, TT]
    # displacement gradients of the probe pressed by one unit
    pressed = square.compute_gradients(states.values[..., :2].sum(axis=-1))
    if compute_volume_change(indentation * pressed).min() <= -1:
        return np.full(2, np.nan)

    def project(dilation: Floats) -> Floats:
        """Return the projection of a dilation, or of another field, onto the pressures, shape (n, q)."""
        return project_dilations(model.geometry, model.shapes, dilation[..., None])[..., 0]

    # the pressure is an unknown of its own, as in ``solver.materials.hyperelastic``; it follows the dilation
    pressure = indentation * lam * project(pressed[diagonal].sum(axis=0))
    stress = law.compute_stress(indentation * pressed)
    forces = stress.first_piola + pressure * stress.cofactor
    # a film state's pressure, by which the gap in the pressure's equation is multiplied, is lam times its projected dilation; the
    # projection is its own adjoint, so that the gap is projected in its place, once for both films
    forces[diagonal] += lam * project(stress.change - law.compute_dilation(pressure)[0])
    loads = square.sum_forces(square.turn_stress(square.weight * forces))
    return np.asarray(loads.ravel() @ states.values[..., 2:].reshape(loads.size, -1))
