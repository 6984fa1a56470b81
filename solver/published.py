"""Level 0: the paper's equations (1) to (12) exactly as printed, defects included.

"Detecting Embedded Objects Using Haptics with Applications in Artificial Palpation of Tumors",
sections 2.3 and 2.4. Symbols are the paper's: ``a`` radius of the loaded circle, ``d`` depth and
``D`` diameter of the object, ``sigma`` the applied stress. SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

from geometry.errors import InputError, Refusal
from geometry.scene import Scene
from solver.result import Result

DEFECTS = (
    "eq. (1) is a far field: on the axis sigma [1 - (d / sqrt(a^2 + d^2))^3] holds",
    "eqs. (4), (6), (7) add the object's shortening without subtracting that of the tissue it replaces",
    "eq. (8) prints (1-nu)^2 where (1-nu^2) follows from eq. (7)",
    "eqs. (9)-(11) leave out thicknesses: a homogeneous block gets E/3",
)


def stress_at_depth(sigma: float, a: float, d: float) -> float:
    """Eq. (1): sigma_1 = 3 sigma a^2 / (2 d^2)."""
    return 3 * sigma * a**2 / (2 * d**2)


def displacement_matrix(sigma: float, a: float, nu: float, E_matrix: float) -> float:
    """Eq. (2): DIS_A = 2 (1-nu^2) sigma a / E_matrix."""
    return 2 * (1 - nu**2) * sigma * a / E_matrix


def displacement_object(sigma: float, a: float, d: float, D: float, E_object: float) -> float:
    """Eq. (3): DIS_B = 3 sigma a^2 D / (2 d^2 E_object)."""
    return 3 * sigma * a**2 * D / (2 * d**2 * E_object)


def displacement_below(sigma: float, a: float, d: float, D: float, nu: float, E_matrix: float) -> float:
    """Eq. (4): DIS_C = 3 (1-nu^2) sigma a^2 D / (2 E_matrix d^2)."""
    return 3 * (1 - nu**2) * sigma * a**2 * D / (2 * E_matrix * d**2)


def displacement_equivalent(sigma: float, a: float, nu: float, E_eq: float) -> float:
    """Eq. (5): DIS = 2 (1-nu^2) sigma a / E_eq."""
    return 2 * (1 - nu**2) * sigma * a / E_eq


def displacement_total(sigma: float, a: float, d: float, D: float, nu: float, E_matrix: float, E_object: float) -> float:
    """Eq. (6): DIS = DIS_A + DIS_B + DIS_C."""
    a_and_b = displacement_matrix(sigma, a, nu, E_matrix) + displacement_object(sigma, a, d, D, E_object)
    return a_and_b + displacement_below(sigma, a, d, D, nu, E_matrix)


def modulus_from_compatibility(a: float, d: float, D: float, nu: float, E_matrix: float, E_object: float) -> float:
    """Eq. (7) solved for E_eq."""
    return 2 * (1 - nu**2) * a / displacement_total(1.0, a, d, D, nu, E_matrix, E_object)


def modulus_printed(a: float, d: float, D: float, nu: float, E_matrix: float, E_object: float) -> float:
    """Eq. (8): E_eq = 4 E_m E_o (1-nu^2) d^2 / [E_o (1-nu)^2 (4 d^2 + 3 a D) + 3 a D E_m]."""
    return (
        4 * E_matrix * E_object * (1 - nu**2) * d**2 / (E_object * (1 - nu) ** 2 * (4 * d**2 + 3 * a * D) + 3 * a * D * E_matrix)
    )


def layer_shortenings(sigma: float, a: float, nu_1: float, nu_2: float, E_1: float) -> tuple[float, float, float]:
    """Eq. (9): the shortenings of tissue, tumour and tissue, the tumour's with E_1 as printed."""
    tissue = 2 * (1 - nu_1**2) * sigma * a / E_1
    return tissue, 2 * (1 - nu_2**2) * sigma * a / E_1, tissue


def modulus_from_shortenings(sigma: float, a: float, nu_1: float, shortenings: tuple[float, float, float]) -> float:
    """Eq. (10): E_eq = 2 (1-nu_1^2) sigma a / (sum of the shortenings)."""
    return 2 * (1 - nu_1**2) * sigma * a / sum(shortenings)


def modulus_of_layers(E_1: float, E_2: float, E_3: float) -> float:
    """Eq. (11): 1 / E_eq = 1/E_1 + 1/E_2 + 1/E_3."""
    return 1 / (1 / E_1 + 1 / E_2 + 1 / E_3)


def object_modulus_from_layers(E_eq: float, E_1: float) -> float:
    """Eq. (11) solved for E_2 = E_object, with E_3 = E_1.

    Raises:
        InputError: E_eq is not below E_1 / 2: no positive modulus fits.
    """
    if not 0 < E_eq < E_1 / 2:
        raise InputError("E_eq", E_eq, f"above 0 and below E_1 / 2 = {E_1 / 2!r} Pa")
    return 1 / (1 / E_eq - 2 / E_1)


def film_force(Q: float, psi_1: float, psi_2: float, d31: float, d32: float, d33: float) -> float:
    """Eq. (12): F = Q / (psi_1 d31 + psi_2 d32 + d33).

    Raises:
        InputError: the film gives no charge.
    """
    charge_per_force = psi_1 * d31 + psi_2 * d32 + d33
    if charge_per_force == 0:
        raise InputError("psi_1 d31 + psi_2 d32 + d33", charge_per_force, "other than 0 C/N")
    return Q / charge_per_force


@dataclass(frozen=True)
class Published:
    """The paper's equivalent modulus, eq. (8) as printed, with ``a`` the probe's outer radius."""

    name: str = "published"
    summary: str = "the paper's eqs. (1)-(12) as printed; an equivalent modulus, no stresses; for reproducing the paper"

    def refusal(self, scene: Scene) -> str | None:
        """Say what in the scene the paper's equations have no symbol for, or None."""
        if len(scene.inclusion) != 1 or scene.inclusion[0].diameter is None:
            return "axisymmetric or closed-form unless there is exactly one sphere: eq. (8) has one diameter, one depth"
        body, at = scene.inclusion[0], scene.placement
        if at.tilt != 0 or math.hypot(body.x - at.x, body.y - at.y) > 1e-9 * scene.inclusion[0].diameter:
            return "closed-form for an inclusion off the axis of an upright probe"
        return None

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Return ``equivalent_modulus``; the equations give no film stresses, so the rest is None.

        Raises:
            Refusal: the equations have no symbol for something in the scene.
        """
        start = perf_counter()
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        body, tissue = scene.inclusion[0], scene.tissue
        sizes = (scene.probe.tube_radius, body.depth, body.diameter or 0.0)
        modulus = modulus_printed(*sizes, tissue.poisson_ratio, tissue.youngs_modulus, body.youngs_modulus)
        why_null = (
            "stresses, ratio and error_estimate are null: the paper's equations give an equivalent modulus, not film stresses"
        )
        defects = "defects of the equations, kept as printed: " + "; ".join(DEFECTS)
        return Result(self.name, perf_counter() - start, equivalent_modulus=modulus, warnings=(why_null, defects))
