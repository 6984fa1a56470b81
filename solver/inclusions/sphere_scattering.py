"""Compute the scattering of elastic fields by a sphere of another material, bonded into an unbounded matrix.

The incident field consists of regular modes with coefficients c. Outside the sphere, outgoing modes S c are added. Inside, the
field consists of regular modes of the sphere's own material with coefficients ``inside`` c. T is the work matrix: the sphere
changes the energy F_ij of two incident fields, with coefficients c_i and c_j, by dF_ij = c_i^T T c_j. For uniform strain this is
Eshelby's sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Ints
from solver.inclusions.mode_sums import Values
from solver.inclusions.solid_harmonics import Side
from solver.inclusions.vector_modes import Modes, compute_scales
from solver.linalg.workspace import keep_table


@dataclass(frozen=True)
class Scattering:
    """Sparse (modes, modes) matrices of one sphere.

    Attributes
    ----------
    S
        Outgoing coefficients per regular ones, both in m.
    T
        Work, symmetric, in N/m: dF = c^T T c in J for c in m. Semi-definite, positive where the sphere is stiffer in both moduli,
        zero for rigid motions.
    inside
        Coefficients inside, of ``Modes`` with the sphere's nu, per regular ones.
    by_log_modulus
        Derivatives of S and T by the logarithm of the sphere's Young's modulus.
    """

    S: Any
    T: Any
    inside: Any
    by_log_modulus: tuple[Any, Any]


def compute_scattering(modes: Modes, E: complex, sphere_E: complex, sphere_nu: complex, radius: float) -> Scattering:
    """Match displacement and traction at the sphere's surface.

    Moduli may be complex: an imaginary part of 1e-30 gives derivatives. T is proportional to both moduli together, so that
    its derivative by ln E of the matrix at constant ratios is T minus that by the sphere's.

    Parameters
    ----------
    modes
        Regular and outgoing modes of the matrix, with its Poisson's ratio.
    E
        The matrix's Young's modulus, Pa.
    sphere_E
        The sphere's Young's modulus, Pa, 1e-6 to 1e6 times the matrix's.
    sphere_nu
        The sphere's Poisson's ratio, up to 0.499999.
    radius
        R, m.
    """
    ratio = sphere_E / E * (1 + modes.nu) / (1 + sphere_nu)
    S, T, inside, derivative, work = _match_modes(modes, sphere_nu, ratio)
    unit = E / (1 + modes.nu) * radius
    return Scattering(S, unit * T, inside, (derivative, unit * work))


@keep_table
def _match_modes(modes: Modes, sphere_nu: complex, ratio: complex) -> tuple[Any, Any, Any, Any, Any]:
    """Return S, T, inside, dS and dT, with T in units of 2 mu R, so that spheres of one material share them.

    dS and dT, here and below, are derivatives with respect to the logarithm of the sphere's Young's modulus, that is of
    ``ratio``, the shear modulus of the sphere over that of the matrix.
    """
    pairs, singles = _match_spheroidal(modes.degree, modes.nu, sphere_nu, ratio), _match_toroidal(modes.degree, ratio)
    S, inside, derivative = (_assemble_sparse(modes, pair, single) for pair, single in zip(pairs, singles, strict=True))
    work = sp.diags_array(-modes.work)
    return S, (work @ S).tocsr(), inside, derivative, (work @ derivative).tocsr()


def _assemble_sparse(modes: Modes, pair: Values, single: Values) -> Any:
    """Assemble a sparse (modes, modes) matrix from its blocks by degree l.

    ``pair`` couples the two spheroidal kinds 0 and 1, (degree + 1, 2, 2); ``single`` is for toroidal kind 2, (degree + 1,).
    """
    kind, ell, index = modes.kind, modes.ell, np.arange(len(modes))
    diagonal = np.where(kind == 2, single[ell], pair[ell, kind % 2, kind % 2])
    (two,) = np.nonzero(modes.partner != index)
    values = np.concatenate([diagonal, pair[ell[two], kind[two], 1 - kind[two]]])
    rows, columns = np.concatenate([index, two]), np.concatenate([index, modes.partner[two]])
    return sp.csr_array((values, (rows, columns)), shape=(len(modes), len(modes)))


def _match_spheroidal(degree: int, nu: complex, inner_nu: complex, ratio: complex) -> tuple[Values, Values, Values]:
    """Return S, inside and dS of kinds 0 and 1, each (degree + 1, 2, 2)."""
    out: Values = np.zeros((3, degree + 1, 2, 2), np.result_type(nu, inner_nu, ratio, float))
    out[:, 0, 1, 1] = _match_single(_compute_dilation(nu), (1, -2), _compute_dilation(inner_nu), ratio)
    if degree:
        out[:, 1] = _match_first_degree(nu, inner_nu, ratio)
    if degree > 1:
        ell = np.arange(2, degree + 1)
        out[:, 2:] = _match_pairs(
            compute_surface_values(ell, nu, "regular"),
            compute_surface_values(ell, nu, "outgoing"),
            compute_surface_values(ell, inner_nu, "regular"),
            ratio,
        )
    return out[0], out[1], out[2]


def _match_toroidal(degree: int, ratio: complex) -> tuple[Values, Values, Values]:
    """Return S, inside and dS of kind 2, each (degree + 1,): tractions are mu (q - 1), q = l and -l - 1; l = 1 is a rotation."""
    ell = np.arange(degree + 1)
    return _match_single((1, (ell - 1) / 2), (1, -(ell + 2) / 2), (1, (ell - 1) / 2), ratio)


def compute_surface_values(ell: Ints, nu: complex, side: Side) -> Values:
    """Return displacement and traction of modes l > 0 at rho = 1, shape (l, 4, 2), columns kinds 0 and 1.

    The displacement is u = a Y e_r + b grad_s Y, the traction 2 mu (tau_r Y e_r + tau_t grad_s Y); rows are a, b, tau_r, tau_t.
    For the gradient of a solid harmonic f and for the other spheroidal field they are, with n = l for regular and -l - 1 for
    outgoing modes

        grad f:       n, 1;                             n (n-1), n - 1
        other field:  (n+1) (n-2+4 nu), n + 5 - 4 nu;   (n+1) (n^2-n-2-2 nu), n^2 + 2n - 1 + 2 nu      (IN.12)
    """
    n = ell if side == "regular" else -ell - 1
    gradient_field = np.stack([n, np.ones_like(n), n * (n - 1), n - 1])  # eq. IN.12, and the next line
    other_field = [(n + 1) * (n - 2 + 4 * nu), n + 5 - 4 * nu, (n + 1) * (n**2 - n - 2 - 2 * nu), n**2 + 2 * n - 1 + 2 * nu]
    fields = (gradient_field, np.stack(other_field)) if side == "regular" else (np.stack(other_field), gradient_field)
    out: Values = np.stack(
        [values * scale for values, scale in zip(fields, compute_scales(ell, nu, side)[:2], strict=True)], axis=-1
    )
    return np.moveaxis(out, 1, 0)


def _match_pairs(regular: Values, outgoing: Values, inner: Values, ratio: complex) -> tuple[Values, Values, Values]:
    """Return S, inside and dS of the pairs of spheroidal modes, from their surface values (l, 4, 2) on each side.

    S are the outgoing amplitudes per unit incident one, ``inside`` the sphere's own, dS the derivative of S by ln ratio.

    With U displacement, t traction / (2 mu) and D = t_out U_out^-1, all of order one,
    (D U_in - ratio t_in) inside = D U_reg - t_reg (IN.13). Both terms on the left are quadratic forms of the same sign: no
    contrast makes them cancel. Then U_out S = U_in inside - U_reg, and dS follows from these two equations.
    ``ratio`` is the shear modulus of the sphere over that of the matrix. Indices in, reg and out are for the sphere's own modes
    (``inner``), the incident regular ones and the outgoing ones.
    """
    (U_reg, t_reg), (U_out, t_out), (U_in, t_in) = ((values[:, :2], values[:, 2:]) for values in (regular, outgoing, inner))
    D = t_out @ np.linalg.inv(U_out)
    left, ratio_t_in = D @ U_in - ratio * t_in, ratio * t_in
    inside = np.linalg.solve(left, D @ U_reg - t_reg)
    d_inside = np.linalg.solve(left, ratio_t_in @ inside)
    return np.linalg.solve(U_out, U_in @ inside - U_reg), inside, np.linalg.solve(U_out, U_in @ d_inside)


def _match_single(regular: Any, outgoing: Any, inner: Any, ratio: complex) -> tuple[Values, Values, Values]:
    """Solve eq. IN.13 for one mode on each side, each given by displacement and traction / (2 mu); see ``_match_pairs``."""
    (U_reg, t_reg), (U_out, t_out), (U_in, t_in) = regular, outgoing, inner
    denominator = t_out * U_in - ratio * t_in * U_out
    inside = (t_out * U_reg - t_reg * U_out) / denominator
    return (ratio * t_in * U_reg - t_reg * U_in) / denominator, inside, ratio * t_in * U_in * inside / denominator


def _compute_dilation(nu: complex) -> tuple[complex, complex]:
    """Return radial displacement and traction / (2 mu) at rho = 1 of u = x, the regular mode of degree 0."""
    return 1, (1 + nu) / (1 - 2 * nu)


def _match_first_degree(nu: complex, inner_nu: complex, ratio: complex) -> Values:
    """Return S, inside and dS for l = 1, shape (3, 2, 2).

    A translation (kind 0) goes through unchanged, and no net force acts on the sphere: there is no outgoing kind 0. Left are kind
    1 on both sides and a translation inside. A translation has a = b, so that matching a - b leaves it out; of the traction
    tau_t alone is matched, as tau_r = -2 tau_t on both sides. The translation then follows from b.
    """
    ell = np.ones(1, np.int64)
    sides = (
        compute_surface_values(ell, nu, "regular"),
        compute_surface_values(ell, nu, "outgoing"),
        compute_surface_values(ell, inner_nu, "regular"),
    )
    regular, outgoing, inner = ((values[0, 0, 1] - values[0, 1, 1], values[0, 3, 1]) for values in sides)
    out: Values = np.zeros((3, 2, 2), np.result_type(nu, inner_nu, ratio, float))
    out[:, 1, 1] = _match_single(regular, outgoing, inner, ratio)
    translation = sides[0][0, 1, 1] + out[0, 1, 1] * sides[1][0, 1, 1] - out[1, 1, 1] * sides[2][0, 1, 1]
    out[1, 0] = 1, translation / sides[0][0, 1, 0]
    return out
