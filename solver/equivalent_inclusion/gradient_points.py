"""Write first-order effects of tumours as quadratic forms of the elements' own values, for exact derivatives.

At the points of the tumours' quadratures, strain and dilation are linear in the elements' own values; the matrices are an
analytic function of the elements' corners and of the points' places, so that complex steps differentiate it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import compute_bilinear_shares, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from solver.axisymmetric.base_states import BaseStates
from solver.axisymmetric.tissue_elements import TissueElements, compute_jacobian
from solver.elements.quadrilateral import Geometry, compute_dilations
from solver.elements.shape_functions import evaluate_functions, evaluate_pressures
from solver.equivalent_inclusion.first_order import BALL_POINTS, build_half_ball
from solver.inclusions.tumours import Tumours

STRAIN_METRIC = np.array([1.0, 1.0, 1.0, 2.0])  # of rr, zz, hoop and rz in eps:eps


@dataclass(frozen=True)
class QuadraturePoints:
    """The points of t tumours' quadratures, q in all, in a mesh without them.

    Attributes
    ----------
    states
        Base states, in whose elements the points lie.
    tumour
        The number of each point's tumour, shape (q,).
    weight
        Each point's part of its tumour's volume, m^3, shape (q,).
    element
        Number of the element in which each point lies, shape (q,).
    place
        Coordinates of each point in its element's unit square, shape (q, 2).
    r
        Distances of the points from the axis, m, shape (q,).
    by_depth, by_log_diameter
        Derivatives of r and z of the points with respect to the depth and to ln of the diameter, m, (q, 2) each.
    """

    states: BaseStates
    tumour: Ints
    weight: Floats
    element: Ints
    place: Floats
    r: Floats
    by_depth: Floats
    by_log_diameter: Floats

    @classmethod
    def from_tumours(cls, states: BaseStates, tumours: Tumours) -> QuadraturePoints:
        """Build the quadrature points of t spheres, arrays of shape (t,)."""
        ball, ball_weights = build_half_ball(*BALL_POINTS)
        radius = tumours.diameter[:, None] / 2
        x, y, height = (radius * ball[:, k] for k in range(3))
        r, z = np.hypot(tumours.offset[:, None] + x, y), height - tumours.depth[:, None]
        # d (r, z) / d ln diameter
        growth = np.stack([((tumours.offset[:, None] + x) * x + y**2) / r, height], axis=-1)
        element, place, _ = TissueElements(states.model.section, states.model.mesh).locate(
            np.stack([r.ravel(), z.ravel()], axis=1)
        )
        weight = (4 / 3 * np.pi * radius**3 * ball_weights[:, 0]).ravel()
        number = np.repeat(np.arange(len(r)), len(ball))
        descent = np.broadcast_to([0.0, -1.0], (len(weight), 2))
        return cls(
            states,
            number,
            weight=weight,
            element=element,
            place=place,
            r=r.ravel(),
            by_depth=descent,
            by_log_diameter=growth.reshape(-1, 2),
        )

    @property
    def elements(self) -> Ints:
        """Numbers of the elements with points."""
        return np.unique(self.element)

    @property
    def row(self) -> Ints:
        """Index of each point's element in ``elements``, shape (q,)."""
        return np.searchsorted(self.elements, self.element)

    def compute_corners(self, section: Any) -> Any:
        """Return corners of ``elements`` in a section, perhaps with complex lengths of shape (), shape (e, 4, 2)."""
        return compute_nodes(section, self.states.model.mesh, UNIT_SQUARE, self.elements)

    def compute_forms(self, corners: Any, moved: Any = 0.0) -> tuple[Any, Any]:
        """Return the matrices from an element's own values to the strains rr, zz, hoop and rz and to the dilation at each point.

        Their shapes are (q, 4, 2, s) and (q, 2, s): 2 components, r and z, with s functions each.

        Parameters
        ----------
        corners
            Corners of ``elements``, (e, 4, 2), perhaps with imaginary parts; the points stay where they are in space.
        moved
            By how much the points moved, (q, 2), small and imaginary in derivatives.
        """
        model, point_corners = self.states.model, corners[self.row]
        # one Newton step finds the place in the moved element: exact to first order, as complex steps need
        real_corners = np.real(point_corners)
        offset = (
            np.real(compute_bilinear_shares(self.place)[:, None] @ real_corners)[:, 0]
            + moved
            - (compute_bilinear_shares(self.place)[:, None] @ point_corners)[:, 0]
        )
        place = self.place + np.linalg.solve(compute_jacobian(real_corners, self.place), offset[..., None])[..., 0]
        r = self.r + np.broadcast_to(moved, (len(self.r), 2))[:, 0]
        value, derivative = evaluate_functions(place, model.shapes.degrees)
        d_r, d_z = np.einsum("kqs,qkj->jqs", derivative, np.linalg.inv(compute_jacobian(point_corners, place)))
        strain = np.zeros((len(r), 4, 2, value.shape[1]), dtype=value.dtype)
        strain[:, 0, 0], strain[:, 1, 1], strain[:, 2, 0] = d_r, d_z, value / r[:, None]
        strain[:, 3, 0], strain[:, 3, 1] = d_z / 2, d_r / 2
        table = compute_dilations(_build_geometry(model.shapes, corners), model.shapes)[:, :, ::2]
        return strain, np.einsum("qk,qkcs->qcs", evaluate_pressures(place, model.shapes.order), table[self.row])


def _build_geometry(shapes: Any, corners: Any) -> Geometry:
    """Build the geometry of straight-sided elements, perhaps with complex corners."""
    points = compute_bilinear_shares(shapes.points) @ corners
    jacobians = np.stack(
        [compute_jacobian(corners, np.broadcast_to(point, (len(corners), 2))) for point in shapes.points], axis=1
    )
    area = jacobians[..., 0, 0] * jacobians[..., 1, 1] - jacobians[..., 0, 1] * jacobians[..., 1, 0]
    return Geometry(points[..., 0], 2 * np.pi * points[..., 0] * area * shapes.weights, np.linalg.inv(jacobians))
