"""Compute the first-order effect of a tumour anywhere in the tissue about a loaded state without it.

A tumour whose moduli differ little from the tissue's changes the outputs q_i, film forces and charges, at constant indentation by
an integral over the place where it lay at rest, wherever that is:

    dq_i = Int [dK/K d_v,i + dmu/mu d_s,i] dV,   d_v,i = p_K dJ_i,   d_s,i = mu f' dI/dF : grad a_i          (CT.9)

with the adjoint displacement a_i of output i, the change dJ_i of the volume ratio J that it causes, the pressure p_K of the bulk
modulus K and the law f of eq. LW.2. Both fields are axisymmetric, so that the densities are functions of r and z alone. In the
limit of no load they are the strain products of eq. EI.1, K tr eps_i tr eps and 2 mu e_i:e, times the indentation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.axisymmetric.tissue_elements import TissueElements
from solver.contact.elements import ElementValues
from solver.contact.model import ContactModel
from solver.contact.states import Equilibrium
from solver.elements.shape_functions import evaluate_functions, evaluate_legendre, evaluate_pressures
from solver.equivalent_inclusion.first_order import build_half_ball
from solver.inclusions.tumours import Tumours

BALL_POINTS = (4, 7, 7)  # of a sphere: along radius, height and half the azimuth, as the densities change more under load
POINTS_PER_CHUNK = 20_000  # evaluated at once, which limits the memory


@dataclass(frozen=True)
class TumourResponse:
    """What small tumours change about one loaded state of a section without tumours.

    Attributes
    ----------
    model
        The section on its mesh.
    tissue
        The tissue's elements, in which points are located.
    values
        Displacements and pressures of the elements.
    adjoints
        Displacements and pressures of the adjoint fields of the k outputs, shapes (n, 2 s, k) and (n, m, k).
    indentation
        Indentation of the base, m.
    outputs
        Film forces, N, and after them the charges that are modelled, C, shape (k,).
    tangent
        Derivatives of the outputs with respect to indentation, shape (k,).
    """

    model: ContactModel
    tissue: TissueElements
    values: ElementValues
    adjoints: tuple[Floats, Floats]
    indentation: float
    outputs: Floats
    tangent: Floats

    @classmethod
    def from_equilibrium(cls, model: ContactModel, equilibrium: Equilibrium) -> TumourResponse:
        """Solve for the adjoint fields about a state in equilibrium: what each output gains from a force anywhere in the tissue.

        Raises
        ------
        SolveError
            The residual of a solution is too large.
        """
        state, equations = equilibrium.state, model.factorise_tangent(equilibrium.equations)
        solutions = model.compute_adjoints(equations)  # values on the elements' edges, one array for each output
        at_rest = model.elements.build_rest_values()
        fields = [model.elements.move(at_rest, equations.elimination, solution) for solution in solutions]  # and inside elements
        adjoints = tuple(np.stack([getattr(field, key) for field in fields], axis=-1) for key in ("u", "p"))
        _, derivatives = model.compute_responses(state, equations)
        tangent = derivatives[:, 0]  # by the indentation
        tissue = TissueElements(model.section, model.mesh)
        outputs = model.compute_outputs(equations)
        return cls(model, tissue, state.elements, (adjoints[0], adjoints[1]), state.indentation, outputs, tangent)

    def evaluate(self, r: Floats, z: Floats) -> Floats:
        """Return the densities d_v and d_s of eq. CT.9 at m points of the undeformed tissue, shape (2, k, m).

        ``r`` and ``z`` are the points' coordinates at rest, m, shape (m,), z out of the tissue. The densities are those at
        constant indentation, in N/m^3 for forces and C/m^3 for charges.

        Raises
        ------
        InputError
            A point lies outside the tissue.
        """
        points = np.stack([r, z], axis=-1)
        self.tissue.check_points(points)
        chunks = range(0, len(points), POINTS_PER_CHUNK)
        parts = [self._evaluate_chunk(points[low : low + POINTS_PER_CHUNK]) for low in chunks]
        return np.concatenate(parts, axis=2) if parts else np.zeros((2, len(self.outputs), 0))

    def integrate(self, tumours: Tumours) -> Floats:
        """Integrate the densities over each of t spheres, shape (2, k, t): d_v, then d_s; N for forces and C for charges.

        ``tumours`` are arrays of shape (t,), relative to the probe's axis.

        Raises
        ------
        InputError
            A sphere lies partly outside the tissue.
        """
        ball, weights = build_half_ball(*BALL_POINTS)
        radius = tumours.diameter / 2
        x, y, height = (radius[:, None] * ball[:, k] for k in range(3))
        r, z = np.hypot(tumours.offset[:, None] + x, y), height - tumours.depth[:, None]
        densities = self.evaluate(r.ravel(), z.ravel()).reshape(2, -1, *r.shape)
        return np.asarray(densities @ weights[:, 0] * (4 / 3 * np.pi * radius**3))

    def convert_to_constant_force(self, changes: Floats) -> Floats:
        """Convert changes of the outputs at constant indentation, shape (k, ...), to changes of logarithms at constant force.

        Returns the changes of ln of each output and last that of ln of the secant stiffness, shape (k + 1, ...): the base rises
        where the forces grow, by their sum over the tangent stiffness.
        """
        rise = changes[:2].sum(axis=0) / self.tangent[:2].sum()
        logs = np.moveaxis((np.moveaxis(changes, 0, -1) - rise[..., None] * self.tangent) / self.outputs, -1, 0)
        return np.concatenate([logs, (rise / self.indentation)[None]])

    def _evaluate_chunk(self, points: Floats) -> Floats:
        """Return the densities at points, (m, 2), shape (2, k, m)."""
        element, places, jacobian = self.tissue.locate(points)
        functions, legendre = self.model.elements.shapes, evaluate_legendre(places, self.model.elements.shapes.order)
        value, (by_u, by_v) = evaluate_functions(places, functions.degrees, legendre)
        inverse = np.linalg.inv(jacobian)
        by_r, by_z = (by_u * inverse[:, 0, k, None] + by_v * inverse[:, 1, k, None] for k in (0, 1))
        shapes = np.stack([value, by_r, by_z], axis=1)
        fields = np.concatenate([self.values.u[..., None], self.adjoints[0]], axis=-1)[element]
        gradients = _compute_gradients(shapes, fields, points[:, 0])
        pressures = evaluate_pressures(places, functions.order, legendre)
        p = (pressures * self.values.p[element]).sum(axis=1)
        adjoint_pressures = (pressures[:, None] @ self.adjoints[1][element])[:, 0]
        return self._combine(element, gradients, p, adjoint_pressures)

    def _combine(self, element: Ints, gradients: Floats, p: Floats, adjoint_pressures: Floats) -> Floats:
        """Combine fields at m points to densities, (2, k, m).

        ``gradients`` are those of the displacement and after it of the adjoints, (5, m, 1 + k); ``p`` are the pressures, (m,),
        and ``adjoint_pressures`` theirs in the adjoint fields, (m, k).
        """
        material = self.model.elements.material.select(element)
        compliance = material.compute_dilation(p[:, None])[1]
        # p carries lam of the bulk modulus: see eq. LW.3
        bulk = (1 + material.bulk / material.lam) * p
        volume = bulk[:, None] * compliance * adjoint_pressures
        stress = material.compute_stress(gradients[:, :, :1]).shear_stress
        shear = (stress * gradients[:, :, 1:]).sum(axis=0)
        return np.stack([volume.T, shear.T])


def _compute_gradients(shapes: Floats, fields: Floats, r: Floats) -> Floats:
    """Return the displacement gradients of fields at m points, shape (5, m, fields); see ``solver/materials/hyperelastic.py``.

    Parameters
    ----------
    shapes
        Functions and their derivatives by r and z, shape (m, 3, s).
    fields
        Coefficients of the fields, u_r before u_z, shape (m, 2 s, fields).
    r
        Distances of the points from the axis, m, shape (m,).
    """
    m, count = len(r), fields.shape[-1]
    u, by_r, by_z = (shapes @ fields.reshape(m, 2, -1, count).transpose(0, 2, 1, 3).reshape(m, -1, 2 * count)).transpose(1, 0, 2)
    (u_r, _), (rr, zr), (rz, zz) = (part.reshape(m, 2, count).transpose(1, 0, 2) for part in (u, by_r, by_z))
    radius = r[:, None]
    hoop = np.where(radius > 0, u_r / np.where(radius > 0, radius, 1.0), rr)  # u_r / r -> u_r,r on the axis
    return np.stack([rr, rz, zr, zz, hoop])
