"""Compute the paper's equations (1) to (12) exactly as printed, defects included, and eq. (8) with its defects corrected.

"Detecting Embedded Objects Using Haptics with Applications in Artificial Palpation of Tumors", sections 2.3 and 2.4. Symbols are
the paper's, SI units: ``sigma`` the applied stress on a circle of radius ``a``, ``d`` depth and ``D`` diameter of the object,
``nu`` Poisson's ratio, ``E_...`` Young's moduli. Their defects are listed in ``solver.published.evaluator``. Corrected,

    1 / E_eq = 1 / E_matrix + k (1 / E_object - 1 / E_matrix),  k = 3 a D / (4 d^2)                                (PU.1)

as the object's shortening has the factor (1-nu^2) like the tissue's, and the shortening of the tissue that it replaces is
subtracted. So an object of the matrix's modulus has no effect, and a stiffer one increases E_eq. The stress at depth is still the
far field of eq. (1), valid only for ``d`` well above ``a`` and ``D``.

Every function refuses with ``InputError`` arguments that are not positive and finite (``nu``: 0 to 0.5; eq. (12): any finite
number), and results beyond double precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_maximum

P = ParamSpec("P")
R = TypeVar("R", float, tuple[float, float], tuple[float, float, float])

SIGNED_SYMBOLS = ("Q", "psi_1", "psi_2", "d31", "d32", "d33")


def check_numbers(formula: Callable[P, R]) -> Callable[P, R]:
    """Decorate a formula with checks of its arguments, by their names, and of its result."""
    names = signature(formula)

    @wraps(formula)
    def call_checked(*args: P.args, **kwargs: P.kwargs) -> R:
        """Call the formula; raise ``InputError`` where an argument or the result is out of range."""
        arguments = names.bind(*args, **kwargs).arguments
        for name, value in arguments.items():
            for number in _list_numbers(value):
                _check_number(name, number)
        try:
            result = formula(*args, **kwargs)
        except ArithmeticError:  # overflow or division by zero
            result = None
        if result is None or not all(map(math.isfinite, _list_numbers(result))):
            raise InputError(formula.__name__, Words("out of range"), "arguments whose result double precision holds")
        return result

    return call_checked


def _list_numbers(value: object) -> Iterable[float]:
    """Return the numbers of a tuple, or a number alone."""
    return value if isinstance(value, tuple) else (value,)


def _check_number(name: str, value: float) -> None:
    """Raise ``InputError`` where the argument of that name is outside its range, see the module's docstring."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(name, value, "a finite number")
    if name.startswith("nu") and not 0 <= value <= 0.5:
        raise InputError(name, value, "from 0 to 0.5")
    if name not in SIGNED_SYMBOLS and not name.startswith("nu") and value <= 0:
        raise InputError(name, value, "above 0")


@check_numbers
def compute_stress_at_depth(sigma: float, a: float, d: float) -> float:
    """Return the stress at depth d, Pa. Eq. (1): sigma_1 = 3 sigma a^2 / (2 d^2)."""
    return 3 * sigma * a**2 / (2 * d**2)


@check_numbers
def compute_displacement_matrix(sigma: float, a: float, nu: float, E_matrix: float) -> float:
    """Return the displacement of the matrix, m. Eq. (2): DIS_A = 2 (1-nu^2) sigma a / E_matrix."""
    return 2 * (1 - nu**2) * sigma * a / E_matrix


@check_numbers
def compute_displacement_object(sigma: float, a: float, d: float, D: float, E_object: float) -> float:
    """Return the shortening of the object, m. Eq. (3): DIS_B = sigma_1 D / E_object = 3 sigma a^2 D / (2 d^2 E_object)."""
    return 3 * sigma * a**2 * D / (2 * d**2 * E_object)


@check_numbers
def compute_displacement_below(sigma: float, a: float, d: float, D: float, *, nu: float, E_matrix: float) -> float:
    """Return the displacement below the object, m. Eq. (4): DIS_C = 3 (1-nu^2) sigma a^2 D / (2 E_matrix d^2)."""
    return 3 * (1 - nu**2) * sigma * a**2 * D / (2 * E_matrix * d**2)


@check_numbers
def compute_displacement_equivalent(sigma: float, a: float, nu: float, E_eq: float) -> float:
    """Return the displacement of the equivalent tissue, m. Eq. (5): DIS = 2 (1-nu^2) sigma a / E_eq."""
    return 2 * (1 - nu**2) * sigma * a / E_eq


@check_numbers
def compute_displacement_total(
    sigma: float, a: float, d: float, D: float, *, nu: float, E_matrix: float, E_object: float
) -> float:
    """Return the total displacement, m. Eq. (6): DIS = DIS_A + DIS_B + DIS_C, by eqs. (2) to (4)."""
    a_and_b = compute_displacement_matrix(sigma, a, nu, E_matrix) + compute_displacement_object(sigma, a, d, D, E_object)
    return a_and_b + compute_displacement_below(sigma, a, d, D, nu=nu, E_matrix=E_matrix)


@check_numbers
def compute_modulus_from_compatibility(a: float, d: float, D: float, *, nu: float, E_matrix: float, E_object: float) -> float:
    """Return the equivalent modulus E_eq by eq. (7), Pa: eq. (5) set equal to eq. (6); sigma cancels."""
    return 2 * (1 - nu**2) * a / compute_displacement_total(1.0, a, d, D, nu=nu, E_matrix=E_matrix, E_object=E_object)


@check_numbers
def compute_modulus_printed(a: float, d: float, D: float, *, nu: float, E_matrix: float, E_object: float) -> float:
    """Return the equivalent modulus E_eq as printed, Pa.

    Eq. (8): E_eq = 4 E_matrix E_object (1-nu^2) d^2 / [E_object (1-nu)^2 (4 d^2 + 3 a D) + 3 a D E_matrix].
    """
    denominator = E_object * (1 - nu) ** 2 * (4 * d**2 + 3 * a * D) + 3 * a * D * E_matrix
    return 4 * E_matrix * E_object * (1 - nu**2) * d**2 / denominator


@check_numbers
def compute_layer_shortenings(sigma: float, a: float, nu_1: float, nu_2: float, E_1: float) -> tuple[float, float, float]:
    """Return the shortenings of the tissue above, the tumour and the tissue below by eq. (9), m.

    Index 1 is the tissue, 2 the tumour, whose shortening is printed with E_1, too.
    """
    tissue = 2 * (1 - nu_1**2) * sigma * a / E_1
    return tissue, 2 * (1 - nu_2**2) * sigma * a / E_1, tissue


@check_numbers
def compute_modulus_from_shortenings(sigma: float, a: float, nu_1: float, shortenings: tuple[float, float, float]) -> float:
    """Return the equivalent modulus E_eq from shortenings, Pa.

    Eq. (10): E_eq = 2 (1-nu_1^2) sigma a / (sum of the shortenings).
    """
    return 2 * (1 - nu_1**2) * sigma * a / sum(shortenings)


@check_numbers
def compute_modulus_of_layers(E_1: float, E_2: float, E_3: float) -> float:
    """Return the equivalent modulus E_eq of three layers, Pa. Eq. (11): 1 / E_eq = 1/E_1 + 1/E_2 + 1/E_3."""
    return 1 / (1 / E_1 + 1 / E_2 + 1 / E_3)


@check_numbers
def compute_film_force(Q: float, psi_1: float, psi_2: float, *, d31: float, d32: float, d33: float) -> float:
    """Return the force on a film from its charge Q, N. Eq. (12): F = Q / (psi_1 d31 + psi_2 d32 + d33).

    Raises
    ------
    InputError
        The charge per force is zero.
    """
    charge_per_force = psi_1 * d31 + psi_2 * d32 + d33
    if charge_per_force == 0:
        raise InputError("psi_1 d31 + psi_2 d32 + d33", charge_per_force, "other than 0 C/N")
    return Q / charge_per_force


EQUATIONS: dict[int, Callable[..., float | tuple[float, float, float]]] = {
    1: compute_stress_at_depth, 2: compute_displacement_matrix, 3: compute_displacement_object, 4: compute_displacement_below,
    5: compute_displacement_equivalent, 6: compute_displacement_total, 7: compute_modulus_from_compatibility,
    8: compute_modulus_printed, 9: compute_layer_shortenings, 10: compute_modulus_from_shortenings,
    11: compute_modulus_of_layers, 12: compute_film_force,
}  # fmt: skip
"""The equations by their numbers."""


@check_numbers
def compute_object_modulus(E_eq: float, E_1: float) -> float:
    """Return E_object from eq. (11) with E_2 = E_object and E_3 = E_1, Pa, as at the end of section 2.3.

    Raises
    ------
    InputError
        E_eq is not below E_1 / 2: no positive modulus fits.
    """
    if E_eq >= E_1 / 2:
        raise InputError("E_eq", E_eq, f"below E_1 / 2 = {format_maximum(E_1 / 2)} Pa, else eq. (11) has no positive E_object")
    return E_eq * E_1 / (E_1 - 2 * E_eq)


@check_numbers
def compute_modulus_corrected(a: float, d: float, D: float, *, E_matrix: float, E_object: float) -> float:
    """Return the equivalent modulus E_eq with the defects of eqs. (4) and (6) to (8) corrected, by eq. PU.1, Pa.

    Raises
    ------
    InputError
        k, the object's fraction of the shortening, is not below 1.
    """
    k = 3 * a * D / (4 * d**2)
    if k >= 1:
        raise InputError("3 a D / (4 d^2)", Words(f"{k:.4g}"), "below 1: a smaller or deeper object")
    return 1 / ((1 - k) / E_matrix + k / E_object)
