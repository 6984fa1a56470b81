"""Compute derivatives of film forces and charges with respect to a sphere's position, size and Poisson's ratio.

If an interface moves by V_n along its normal n, energies of states that stay in equilibrium change by

    dF_ij = Int V_n [ s_i:e_j (in) - s_i:e_j (out) - s_i(out):(e_j(in) - e_j(out)) - s_j(out):(e_i(in) - e_i(out)) ] dS    (MS.10)

with stresses s and strains e of both states i, j, inside and outside (Eshelby, J. Elasticity 5 (1975) 321: the jump of the
energy-momentum tensor; the displacement gradient jumps by a vector times n, so that its product with the traction is the stress
times the jump of strain). All fields on the surface are given by modes: incident and scattered ones outside, those of the
sphere's own material inside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from solver.inclusions.projection import build_quadrature
from solver.inclusions.sphere_scattering import Scattering, compute_scattering
from solver.materials.linear import VOIGT_WEIGHTS, Isotropic
from solver.multiple_scattering.spheres import ScatteringSphere

COMPLEX_STEP = 1e-30  # complex step: no cancellation, so that it may be tiny


def compute_shape_derivatives(
    sphere: ScatteringSphere, scattering: Scattering, matrix: Material, material: Material, incident: Floats
) -> dict[str, Floats]:
    """Compute the shape derivatives of eq. MS.10 for a sphere in the whole incident field of the s states.

    Parameters
    ----------
    sphere
        The sphere.
    scattering
        Its scattering matrices.
    matrix, material
        The material about it and its own.
    incident
        Regular coefficients of the field, m per unit of each state, shape (modes, s).

    Returns
    -------
    dict
        Derivatives of the energy products, shapes (s, s), with respect to the logarithms of depth and diameter, to
        poisson_ratio, and to the offset from the probe's axis, per m; that is zero on the axis.
    """
    modes, radius = sphere.modes, sphere.radius
    points, weights = build_quadrature(modes, 6)
    outside = modes.evaluate_regular(points, incident)[1] + modes.evaluate_outgoing(points, scattering.S @ incident)[1]
    inside = replace(modes, nu=material.poisson_ratio).evaluate_regular(points, scattering.inside @ incident)[1]
    s_in, e_in = _compute_stress_and_strain(inside, material, radius)
    s_out, e_out = _compute_stress_and_strain(outside, matrix, radius)
    jump = e_in - e_out
    density = _contract(s_in, e_in) - _contract(s_out, e_out) - _contract(s_out, jump) - _contract(jump, s_out)

    def integrate(motion: Floats) -> Floats:
        """Integrate eq. MS.10 for a motion V_n of the surface at the points, shape (q,)."""
        return np.asarray(np.einsum("q,qij->ij", weights * radius**2 * motion, density))

    x, y, z = sphere.centre
    offset = float(np.hypot(x, y))
    outward = np.array([x, y, 0.0]) / offset if offset > 0 else np.zeros(3)
    nu = material.poisson_ratio + COMPLEX_STEP * 1j
    shifted = compute_scattering(modes, matrix.youngs_modulus, material.youngs_modulus, nu, radius)
    return {
        "depth": integrate(-points[:, 2]) * -z,  # the sphere moves along -z; times the depth -z for the logarithm
        "offset": integrate(points @ outward),
        "diameter": integrate(np.full(len(points), radius)),  # V_n = R per unit of ln R
        "poisson_ratio": incident.T @ (shifted.T.imag @ incident) / COMPLEX_STEP,
    }


def _compute_stress_and_strain(scaled: Floats, material: Material, radius: float) -> tuple[Floats, Floats]:
    """Return stress, Pa, and strain, (q, 6, s), from ``scaled``: stress times R / (2 mu), with radius R and shear modulus mu."""
    nu = material.poisson_ratio
    trace = scaled[:, :3].sum(axis=1, keepdims=True)
    strain = scaled.copy()
    strain[:, :3] -= nu / (1 + nu) * trace
    return scaled * (Isotropic.from_material(material).two_mu / radius), strain / radius


def _contract(first: Floats, second: Floats) -> Floats:
    """Return the products s_i:e_j of stresses and strains at all points, (q, s, s)."""
    return np.asarray(np.einsum("qai,a,qaj->qij", first, VOIGT_WEIGHTS, second, optimize=True))
