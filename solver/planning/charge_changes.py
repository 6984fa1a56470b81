"""Bound how much more a load changes the films' charges than the forces on them.

A film on a soft bond to the base is stretched by the shear below its block. Finite strain changes this shear, and with it the
charge, by up to 7.5 times the bound on film forces (122 scenes with films, x up to 0.3). With rigid bonds, glue and with
tape towards the block alone charges change as forces do. The log-sensitivity of charges has no rule of its own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.scene import Scene
from solver.axisymmetric.sections import add_details, build_sections
from solver.planning.loads import LoadRule

if TYPE_CHECKING:
    from solver.contact.model import ContactModel

SOFT_BOND_MODULUS = 1e8  # Pa: bonds between tape and glue, of which none are known, count as tape
SOFT_BOND_FACTOR = 1.5  # on eq. PL.13 where eq. PL.14 cannot be computed: the worst of 73 scenes needs 1.37
CHANGE_MARGIN_FACTOR = 2.0  # on the change at a light load without tumours: the worst of 73 scenes needs 1.73
TESTED_X = 0.02  # x of the light load
COARSE_MESH = MeridianFineness(1, 0, 2)  # on which both margins were measured


def has_soft_bond(scene: Scene) -> bool:
    """Return whether charges of a scene are modelled and a film has a soft bond to the base."""
    if scene.probe.film is None or not scene.models_charges:
        return False
    bonds = [film.bond_to_base for film in scene.probe.film.by_block]
    return any(bond is not None and bond.thickness > 0 and (bond.youngs_modulus or 0.0) < SOFT_BOND_MODULUS for bond in bonds)


def add_charges(rule: LoadRule, factor: float) -> LoadRule:
    """Return a rule whose bound on the changes of ratio and stresses covers those of the charges, ``factor`` times as large."""
    return replace(rule, covered=factor * rule.covered)


def compute_charge_factor(scene: Scene, rule: LoadRule) -> float:
    """Compute the factor for a scene without tumours on a coarse mesh pressed to a light load.

    With c the largest change of a charge per indentation, and of their ratio, under a load for which b bounds those of forces,
    it is

        max(1, 2 c / b)      (PL.14)

    Parameters
    ----------
    scene
        Without tumours, its contact tied.
    rule
        The rule for film forces on it.
    """
    if not has_soft_bond(scene):
        return 1.0
    from solver.contact.loaded_scene import truncate_half_space
    from solver.contact.model import ContactModel

    sections = add_details(scene, build_sections(scene))
    section = truncate_half_space(scene, sections.section)
    indentation = TESTED_X / rule.strain
    try:
        model = ContactModel.from_section(
            section, sections.materials, scene.contact.interface, COARSE_MESH, tied=True, films=sections.films
        )
        start, charges = _press_lightly(model, indentation)
    except (SolveError, LimitReached):
        return SOFT_BOND_FACTOR
    # charges per indentation, relative to those at rest
    inner, outer = charges / start
    change = max(abs(inner - 1), abs(outer - 1), abs(inner / outer - 1))
    bound = rule.bound_ratio_change(rule.stiffness * indentation)
    return max(1.0, CHANGE_MARGIN_FACTOR * float(change) / bound) if np.isfinite([change, bound]).all() else SOFT_BOND_FACTOR


def _press_lightly(model: ContactModel, indentation: float) -> tuple[Floats, Floats]:
    """Return both charges per indentation, C/m, shape (2,): at rest, and under a light load after one step of Newton's method.

    The step starts from the linear solution and takes the tangent at rest, so that its error is of the third order in the load.

    Raises
    ------
    SolveError
        The equations cannot be solved.
    """
    undeformed = model.build_rest_state()
    equations = model.factorise_tangent(model.linearise(undeformed))
    changes, derivatives = model.compute_responses(undeformed, equations)
    state = model.shift(undeformed, equations, indentation * changes[:, 0], indentation)
    loaded = model.linearise(state, equations, keep_tangent=True)
    return derivatives[2:, 0], model.predict_outputs(loaded)[2:] / indentation
