"""Compute the paper's eqs. (4) and (6) to (8) with their defects corrected (PHYSICS section 1), to measure the defects' effect.

    1 / E_eq = 1 / E_matrix + k (1 / E_object - 1 / E_matrix),  k = 3 a D / (4 d^2)                                (PU.1)

The object's shortening has the factor (1-nu^2) like the tissue's, and the shortening of the tissue that it replaces is
subtracted. So an object of the matrix's modulus has no effect, and a stiffer one increases E_eq. The stress at depth is still the
far field of eq. (1), valid only for ``d`` well above ``a`` and ``D``. Symbols, units and checks are those of ``equations``.
"""

from __future__ import annotations

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_maximum
from solver.published.equations import check_numbers


@check_numbers
def modulus(a: float, d: float, D: float, E_matrix: float, E_object: float) -> float:
    """Return the equivalent modulus E_eq of tissue with an embedded object, by eq. PU.1, Pa.

    Parameters
    ----------
    a
        Radius of the circle under stress, m.
    d
        Depth of the object, m.
    D
        Its diameter, m.
    E_matrix
        Young's modulus of the tissue around it, Pa.
    E_object
        Its own, Pa.

    Raises
    ------
    InputError
        k is not below 1.
    """
    k = _compute_share(a, d, D)
    return 1 / ((1 - k) / E_matrix + k / E_object)


@check_numbers
def object_modulus(a: float, d: float, D: float, E_matrix: float, E_eq: float) -> float:
    """Return E_object from E_eq by eq. PU.1, Pa.

    Raises
    ------
    InputError
        k is not below 1, or E_eq is not below that of a rigid object.
    """
    k = _compute_share(a, d, D)
    rigid = E_matrix / (1 - k)
    if E_eq >= rigid:
        raise InputError("E_eq", E_eq, f"below that of a rigid object, {format_maximum(rigid)} Pa")
    return k * E_eq * rigid / (rigid - E_eq)


@check_numbers
def diameter(a: float, d: float, E_matrix: float, E_object: float, E_eq: float) -> float:
    """Return the object's diameter D from E_eq by eq. PU.1, m.

    Raises
    ------
    InputError
        E_eq is not between E_matrix and E_object, so that k is not between 0 and 1.
    """
    if not min(E_matrix, E_object) < E_eq < max(E_matrix, E_object):
        raise InputError("E_eq", E_eq, f"between E_matrix = {E_matrix:g} and E_object = {E_object:g} Pa")
    k = E_object * (E_matrix - E_eq) / (E_eq * (E_matrix - E_object))
    return 4 * d**2 * k / (3 * a)


def _compute_share(a: float, d: float, D: float) -> float:
    """Return k of eq. PU.1, the object's fraction of the shortening."""
    if 3 * a * D >= 4 * d**2:
        raise InputError("3 a D / (4 d^2)", Words(f"{3 * a * D / (4 * d**2):.4g}"), "below 1: a smaller or deeper object")
    return 3 * a * D / (4 * d**2)
