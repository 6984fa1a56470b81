r"""Compute the forces between two lines that touch, by augmented Lagrangians: pressure, and friction if there is any.

The constraint g >= 0 is that of the normal distance; its multiplier, per undeformed area, works along dg, which is normal to the
line. With the multiplier l of the last round and a penalty e the energy of a point is (max(0, l - e g)^2 - l^2) / (2 e) (CT.3).

Friction holds a point at its position on the master at the last load, by a spring that slips where the shear exceeds Coulomb's
law: with the shear m of that load and the slip d since then

    shear = m + f d,  within +- friction x pressure                                                     (CT.6)

both per undeformed area, along and normal to the deformed line (J. C. Simo & T. A. Laursen, Computers & Structures 42, 1992, 97).
Here friction is Coulomb's coefficient. The spring f, a fraction of the full penalty, is no multiplier: there are more contact
points than the lines have degrees of freedom, so that multipliers that hold all points would not be unique.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from solver.contact.boundary_lines import multiply_outer
from solver.contact.footpoints import Footpoints, PointGaps
from solver.contact.pairs import Pair

FRICTION_SPRING_RELATIVE = 0.01  # of the penalty: with stiffer springs Newton's method cycles between sets of sliding points
REST_CONTACT_GAP_M = 1e-12  # lines nearer than this touch before there is any load


@dataclass(frozen=True)
class Grip:
    """Friction history of a pair's points.

    Attributes
    ----------
    place
        Positions on the undeformed master, m from its start, shape (points,).
    shear
        m of eq. CT.6, Pa, shape (points,).
    sliding
        1 or -1 where points last slid forward or backward along the master, 0 where they did not slide.
    """

    place: Floats
    shear: Floats
    sliding: Ints


@dataclass(frozen=True)
class Touch:
    """Gaps and forces of a pair in a deformed state.

    Attributes
    ----------
    feet
        Gaps at the slave's points.
    pressure
        Pressure of eq. CT.3, Pa, per undeformed area and along g, shape (points,).
    forces
        Forces on the elements' values, shape (n (8 p),).
    stiffness
        Tangent of the forces, sparse; not symmetric with friction; None where nothing touches.
    grip
        Friction history after this state.
    normal
        Pressure normal to the master, Pa, per undeformed area, shape (points,).
    max_violation
        Maximum penetration of the lines, or separation where they are tied or press, m.
    sliding_reversed
        Whether a point reversed its sliding direction: it is held, and its shear is too large.
    """

    feet: PointGaps
    pressure: Floats
    forces: Floats
    stiffness: sp.coo_array | None
    grip: Grip
    normal: Floats
    max_violation: float = 0.0
    sliding_reversed: bool = False

    @property
    def gap(self) -> Floats:
        """Gap at the slave's points, m, infinite where the master does not reach, shape (points,)."""
        return self.feet.gap

    @property
    def min_gap(self) -> float:
        """Minimum gap, m."""
        return float(np.min(self.gap, initial=np.inf))


def compute_touch(
    pair: Pair,
    displacements: Floats,
    multiplier: Floats,
    penalty_fraction: float = 1.0,
    blur: float = 0.0,
    *,
    grip: Grip | None = None,
    expected: Floats | None = None,
) -> Touch:
    """Compute the gaps of a pair of lines, the contact forces and their tangent in a deformed state.

    Parameters
    ----------
    pair
        The two lines that may touch.
    displacements
        Displacements on the elements' corners and edges, m, shape (n, 8 p).
    multiplier
        Multipliers of the last round, Pa, shape (points,).
    penalty_fraction
        Fraction of the penalty that is used.
    blur
        Gap, m, over which the kink of eq. CT.3 is rounded; 0 at rest, where all that touches is closed.
    grip
        Friction history of the last load; None without friction.
    expected
        Pressures, Pa, shape (points,), with which the tangent takes the lines to turn; None: those of eq. CT.3.

    Raises
    ------
    SolveError
        A line folds over.
    """
    size, penalty, feet = displacements.size, penalty_fraction * pair.penalty, PointGaps.from_displacements(pair, displacements)
    gap, inside = feet.gap, feet.inside
    pressure, rising = compute_pressure(multiplier - penalty * gap, penalty * blur, penalty * REST_CONTACT_GAP_M)
    if pair.tied.size:  # tied points keep to the master: their pressure may be negative
        _check_edge(pair, feet)
        pressure, rising = np.where(pair.tied, multiplier - penalty * gap, pressure), np.where(pair.tied, 1.0, rising)
    violation = np.where(pair.tied, np.abs(gap), -gap) if pair.tied.size else -gap
    if not pair.loose:  # a multiplier that is too large presses at a distance
        violation = np.maximum(violation, np.minimum(gap, pressure / penalty))
    max_violation = float(np.max(violation, initial=0.0))
    active, zeros = rising > 0, np.zeros(len(gap))  # active: points whose pressure depends on their gap
    place = feet.place if grip is None else np.where(inside, feet.place, grip.place)
    if not np.any(active):
        return Touch(feet, pressure, np.zeros(size), None, Grip(place, zeros, zeros.astype(int)), zeros, max_violation)
    footpoints, weight = feet.select_points(active), pair.weights[active]
    opening, bending = footpoints.differentiate_gap()  # first and second derivatives of the gap
    force, normal, shear = pressure[active], zeros.copy(), zeros.copy()
    sliding, sliding_reversed = zeros.astype(int), False
    forces, penalty_stiffness = -force[:, None] * opening, (penalty * rising[active])[:, None]
    turning = force if expected is None else expected[active]
    stiffness = multiply_outer(penalty_stiffness * opening, opening) - turning[:, None, None] * bending
    normal[active] = footpoints.stretch * force
    if grip is not None:
        slip = np.nan_to_num((place - grip.place)[active])  # a point that the master did not reach before has no slip yet
        spring = pair.spring * pair.penalty
        trial, bound = grip.shear[active] + spring * slip, pair.friction * normal[active]
        direction = np.where(np.abs(trial) <= bound, 0, np.sign(trial)).astype(int)
        # a stiff spring makes sliding points oscillate between both directions: hold them first
        reversed_points = direction * grip.sliding[active] < 0
        direction[reversed_points], sliding_reversed = 0, bool(np.any(reversed_points))
        sliding[active] = direction
        shear[active] = np.where(direction == 0, trial, direction * bound)
        friction_forces, friction_stiffness = _compute_friction(
            footpoints, direction == 0, shear[active], spring, -penalty_stiffness * opening
        )
        forces, stiffness = forces + friction_forces, stiffness + friction_stiffness
    pulls, matrix = footpoints.assemble(weight[:, None] * forces, weight[:, None, None] * stiffness, displacements.shape[1], size)
    return Touch(feet, pressure, pulls, matrix, Grip(place, shear, sliding), normal, max_violation, sliding_reversed)


def _check_edge(pair: Pair, feet: PointGaps) -> None:
    """Raise ``SolveError`` if tied points lie beyond the edge of the face: such contact is not defined."""
    if np.any(pair.tied & ~(feet.place <= pair.master_edge.place)):
        raise SolveError("tissue slides past the edge of a face that it cannot leave")


def _compute_friction(
    footpoints: Footpoints, held: Floats, shear: Floats, spring: float, pressing: Floats
) -> tuple[Floats, Floats]:
    """Compute the friction forces of j points on the values of both lines, and the derivatives of these forces.

    Parameters
    ----------
    footpoints
        The points in contact and where they meet the master.
    held
        Mask of the points that the spring of eq. CT.6 holds, shape (j,); the others slide.
    shear
        Shear of the points, Pa, shape (j,).
    spring
        Stiffness f of eq. CT.6, Pa/m.
    pressing
        Derivative of the pressure with respect to both lines' values, shape (j, 4 (p + 1)).

    Returns
    -------
    tuple[Floats, Floats]
        Forces per undeformed area, shape (j, 4 (p + 1)), and their derivatives, shape (j, 4 (p + 1), 4 (p + 1)).
    """
    tangent, slope_derivative, place_derivative, stretch = (
        footpoints.tangent,
        footpoints.slope_derivative,
        footpoints.place_derivative,
        footpoints.stretch[:, None],
    )
    forward = footpoints.compute_relative_motion(tangent)
    lengths = footpoints.pair.master.lengths[footpoints.master_edges][:, None]
    # derivative of the bound, friction x stretch x pressure: shear equals plus or minus the bound
    pressed = footpoints.pair.friction * stretch * pressing * np.sign(shear)[:, None]
    sliding = pressed + (shear * footpoints.k)[:, None] / stretch**2 * slope_derivative
    shear_derivative = np.where(held[:, None], spring * lengths * place_derivative, sliding)  # derivative of the shear
    # derivative of the direction along which the shear acts
    direction_derivative = multiply_outer(
        footpoints.compute_relative_motion(footpoints.opening_direction / stretch**3), slope_derivative
    ) - multiply_outer(footpoints.compute_tangent_change(tangent), place_derivative)
    return shear[:, None] * forward, multiply_outer(forward, shear_derivative) + shear[:, None, None] * direction_derivative


def compute_pressure(trial: Floats, blur: Floats | float, rest_threshold: float = 0.0) -> tuple[Floats, Floats]:
    """Return the pressure max(0, trial) of eq. CT.3, with its kink rounded, and its derivative with respect to ``trial``.

    Parameters
    ----------
    trial
        l - e g of eq. CT.3, Pa, shape (points,).
    blur
        The kink is rounded from -blur to blur, Pa; 0 leaves it sharp. A number or shape (points,), none of them 0.
    rest_threshold
        Where the kink is sharp, the derivative is 1 above ``-rest_threshold``, Pa: lines closed at rest count as touching.
    """
    if np.ndim(blur) == 0 and blur == 0:
        return np.maximum(trial, 0.0), np.where(trial > -rest_threshold, 1.0, 0.0)
    low, high = trial <= -blur, trial >= blur
    ramp = (np.clip(trial, -blur, blur) + blur) / (2 * blur)  # from 0 to 1 over the rounded kink: a parabola joins both lines
    return np.where(low, 0.0, np.where(high, trial, blur * ramp**2)), np.where(low, 0.0, np.where(high, 1.0, ramp))
