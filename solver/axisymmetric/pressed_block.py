"""Compute the charge of a film when its block alone is pressed on its lower face, as by a pin or a ring on the bench.

The block hangs on a rigid base with its stack: bond, film, bond. A flat punch moves its lower face, all of it or a part, by one
unit towards the base, or an even pressure loads it. With u the displacement and u* that of ``solver.axisymmetric.film_states``,
the film's charge is the energy of both under its electrode,

    Q = a_film(u*, u) = -a(s, u) + a(w, u),   s = w - u*        (AX.16)

and the error of Q on a mesh is the energy of the errors of s and of u, so that it falls at twice the rate of either. The state w
has the forces of u*, and no displacement where u is prescribed. A modulus E outside the film changes the charge by

    dQ / d ln E = -a_E(s, u)        (AX.17)

the energy in the body with that modulus, and the force F of a punch by a_E(u, u) per unit displacement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Refusal, SolveError
from geometry.scenes.film import Bond, Film
from geometry.scenes.probe import Material
from solver.axisymmetric.condensed_system import System
from solver.axisymmetric.dofs import Numbering, build_gather, build_pattern, number_functions
from solver.elements.quadrilateral import Condensed, compute_geometry, integrate_stiffness
from solver.elements.shape_functions import Shapes, build_shapes, evaluate_functions
from solver.linalg.threads import limit_to_one_thread
from solver.materials.linear import Isotropic

Load = Literal["frictionless", "stuck", "pressure"]
ORDERS = (4, 5)  # polynomial orders of the two solutions that are compared
ERROR_FACTOR = 2.0  # times the change between them: bounds the error of the second, as errors at corners fall as its order^-2
MIN_ERROR = 5e-5  # relative: rounding, and corners, which the smallest cells leave to about this
CELL_RATIO = 0.15  # ratio of sizes of neighbouring cells towards a corner
SMALLEST_CELL_SHARE = 0.05  # of the thinnest layer and of the shortest part of the face: the cells at corners


@dataclass(frozen=True)
class PressedBlock:
    """A block with its stack on a rigid base, and how it is pressed.

    Attributes
    ----------
    inner_radius, outer_radius
        Of the block, m; an inner radius of 0 is a disc.
    height
        Of the block alone, m.
    material
        Of the block.
    film
        The block's film with its bonds, without ``outer``.
    load
        A flat rigid punch, ``frictionless`` or ``stuck`` to the face, or an even ``pressure``.
    pressed
        Radii from which and to which the face is pressed, m; None for the whole face.
    varied
        Whether ``bond_derivative`` varies the modulus of the bond towards the block, and of that towards the base.
    """

    inner_radius: float
    outer_radius: float
    height: float
    material: Material
    film: Film
    load: Load = "frictionless"
    pressed: tuple[float, float] | None = None
    varied: tuple[bool, bool] = (True, True)

    @property
    def span(self) -> tuple[float, float]:
        """The radii between which the face is pressed, m; a punch that is wider than the face presses all of it."""
        low, high = self.pressed or (self.inner_radius, self.outer_radius)
        return max(low, self.inner_radius), min(high, self.outer_radius)


@dataclass(frozen=True)
class PressedCharge:
    """What the film of a pressed block gives.

    Attributes
    ----------
    charge_per_force
        Charge per compressive force on the block, C/N, of the sign of d33 where an evenly pressed film is free.
    charge_error
        Relative bound on its error.
    stiffness
        Force per displacement of the punch, or, under a pressure, per mean displacement of the pressed part, N/m.
    stiffness_error
        Relative bound on its error.
    bond_derivative
        Derivative of ln |charge_per_force| with respect to ln of the moduli of the varied bonds together.
    """

    charge_per_force: float
    charge_error: float
    stiffness: float
    stiffness_error: float
    bond_derivative: float


def press_block(block: PressedBlock) -> PressedCharge:
    """Return the film's charge per force and the stiffness of a block that is pressed on its lower face.

    Raises
    ------
    InputError
        The film has ``psi1`` or ``psi2``, which take the place of its stress, or the pressed part is not on the face.
    Refusal
        The equations cannot be solved in double precision.
    """
    coarse, fine = (press_once(block, order) for order in ORDERS)
    charge_error, stiffness_error = (
        ERROR_FACTOR * abs(a / b - 1) + MIN_ERROR
        for a, b in ((coarse.charge_per_force, fine.charge_per_force), (coarse.stiffness, fine.stiffness))
    )
    return replace(fine, charge_error=charge_error, stiffness_error=stiffness_error)


def press_once(block: PressedBlock, order: int = ORDERS[0]) -> PressedCharge:
    """Return what ``press_block`` does by one solution, with elements of one order and unknown errors, which are infinite.

    Raises
    ------
    InputError, Refusal
        See ``press_block``.
    """
    low, high = block.span
    if not low < high:
        allowed = f"radii between {block.inner_radius:.4g} and {block.outer_radius:.4g} m, the first below the second"
        raise InputError("pressed", block.pressed, allowed)
    if block.film.uses_psi:
        raise InputError("psi1", block.film.psi1, "left out, as psi1 and psi2 take the place of the film's stress")
    with limit_to_one_thread():
        try:
            return _solve(block, order)
        except (SolveError, np.linalg.LinAlgError) as fault:
            raise Refusal("pressed", block.load, f"a block and a stack whose sizes lie closer together ({fault})") from fault


@dataclass(frozen=True)
class _Grid:
    """The rectangles of a block and its stack, column by column.

    Attributes
    ----------
    corners
        Of the n rectangles, counter-clockwise (r, z), m; z = 0 is the block's lower face, shape (n, 4, 2).
    labels
        The same by numbers of lines, shape (n, 4, 2).
    layer
        Of each rectangle: 0 for the block, then the layers upwards, shape (n,).
    """

    corners: Floats
    labels: Floats
    layer: Ints


def _build_grid(block: PressedBlock, layers: list[Bond | Film]) -> _Grid:
    """Return the rectangles between radii and levels that are graded towards walls, interfaces and the pressed part's ends."""
    film, (low, high) = block.film, block.span
    inset = film.electrode_inset
    ends = {block.inner_radius, low, high, block.outer_radius, block.outer_radius - inset}
    if block.inner_radius:
        ends.add(block.inner_radius + inset)
    radii, heights = _merge(ends), np.cumsum([0.0, block.height, *(layer.thickness for layer in layers)])
    smallest = SMALLEST_CELL_SHARE * min(*np.diff(heights), *np.diff(radii))
    columns = _join(radii, smallest, from_axis=block.inner_radius == 0)
    rows = [_grade(a, b, smallest, (True, True)) for a, b in pairwise(heights)]
    levels = np.concatenate([rows[0], *(row[1:] for row in rows[1:])])
    layer = np.repeat(np.arange(len(rows)), [len(row) - 1 for row in rows])
    i, j = (index.ravel() for index in np.meshgrid(range(len(columns) - 1), range(len(levels) - 1), indexing="ij"))
    labels = np.stack([np.stack([i + x, j + y], axis=-1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    corners = np.stack([columns[labels[..., 0]], levels[labels[..., 1]]], axis=-1)
    return _Grid(corners, labels.astype(float), layer[j])


def _merge(radii: set[float]) -> Floats:
    """Return radii in order, without those that are equal but for rounding."""
    ordered = np.array(sorted(radii))
    return np.asarray(ordered[np.append(True, np.diff(ordered) > 1e-9 * ordered[-1])])


def _join(radii: Floats, smallest: float, from_axis: bool) -> Floats:
    """Return the lines of all intervals between radii, graded towards every one but the axis."""
    parts = [_grade(a, b, smallest, (not (from_axis and k == 0), True)) for k, (a, b) in enumerate(pairwise(radii))]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def _grade(low: float, high: float, smallest: float, towards: tuple[bool, bool]) -> Floats:
    """Return lines from ``low`` to ``high`` whose distances grow by the cell ratio away from the ends that are ``towards``."""
    length = (high - low) / (2 if all(towards) else 1)
    steps = length * CELL_RATIO ** np.arange(max(1, round(np.log(smallest / length) / np.log(CELL_RATIO))), -1, -1)
    if towards == (True, True):
        return np.concatenate([[low], low + steps, high - steps[-2::-1], [high]])
    return np.concatenate([[low], high - steps[-2::-1], [high]])


def _solve(block: PressedBlock, order: int) -> PressedCharge:
    """Return the film's charge and the stiffness with elements of one order; errors are not known."""
    layers = [layer for layer in block.film.stack if layer.thickness > 0]
    grid, shapes = _build_grid(block, layers), build_shapes(order)
    box = grid.corners[:, 0, None], (grid.corners[:, 2] - grid.corners[:, 0])[:, None]
    materials = [block.material, *(_get_material(layer) for layer in layers)]
    law = Isotropic.from_materials(materials).select(grid.layer)
    geometry = compute_geometry(box[0] + box[1] * shapes.places, shapes)
    condensed = Condensed.from_blocks([integrate_stiffness(geometry, shapes, law)], len(grid.layer))
    numbering, press = _number(grid, block, order)
    system = System.from_stiffness(numbering, condensed.stiffness)
    is_under_electrode, actuation = _build_actuation(grid, block, layers, shapes.skeleton)
    lift = np.concatenate([press if block.load != "pressure" else np.zeros_like(press), -actuation], axis=2)
    forces = np.zeros((numbering.unknowns, 2))
    if block.load == "pressure":
        forces[:, :1] = system.assemble_forces(_build_pressure(grid, block, shapes))
    solution = system.solve(forces, lift, passes=2)
    u, s = np.moveaxis(solution.values, -1, 0)
    loads = solution.loads[..., 0]  # of u
    # in the toolkit's sign: that of d33 under compression, where the lower face moves towards the base, to +z
    charge = float(np.sum(actuation[is_under_electrode, :, 0] * loads[is_under_electrode]))
    layers_varied = zip(block.film.stack, (block.varied[0], False, block.varied[1]), strict=True)
    is_varied = [varied for layer, varied in layers_varied if layer.thickness > 0]
    bonds = np.isin(grid.layer, 1 + np.flatnonzero(is_varied))
    charge_derivative, energy = -float(np.sum(s[bonds] * loads[bonds])), float(np.sum(u * loads))  # eq. AX.17
    if block.load == "pressure":
        force, force_derivative = 1.0, 0.0
        stiffness = 1 / energy  # the mean displacement under a force of 1 N is the work of that force
    else:
        force = stiffness = energy
        force_derivative = float(np.sum(u[bonds] * loads[bonds]))
    derivative = charge_derivative / charge - force_derivative / force
    # the film is compressed by u: its s_z < 0, and Q of eq. AX.16 has the sign of -d33
    return PressedCharge(-charge / force, np.inf, stiffness, np.inf, derivative)


def _get_material(layer: Bond | Film) -> Material:
    """Return the material of a layer with a thickness."""
    assert layer.youngs_modulus is not None  # checked by ``Bond``
    assert layer.poisson_ratio is not None
    return Material(youngs_modulus=layer.youngs_modulus, poisson_ratio=layer.poisson_ratio)


def _number(grid: _Grid, block: PressedBlock, order: int) -> tuple[Numbering, Floats]:
    """Return the numbering of the unknowns, and the elements' values of a unit displacement of the pressed part, (n, 8 p, 1).

    The top is fixed; the axis does not move sideways; a punch prescribes u_z of the pressed part, a stuck one u_r, too.
    """
    n = len(grid.layer)
    functions, signs, ends = number_functions(grid.labels, np.zeros(n, dtype=bool), order)
    r0, z0, r1, z1, _, degree = ends.T
    is_pressed = (z0 == 0) & (z1 == 0) & _find_pressed(grid, block, r0, r1)
    is_top = (z0 == grid.labels[..., 1].max()) & (z0 == z1)
    is_axis = (r0 == 0) & (r1 == 0) & (block.inner_radius == 0)
    is_punch = is_pressed & (block.load != "pressure")
    fixed = np.stack([is_top | is_axis | (is_punch & (block.load == "stuck")), is_top | is_punch], axis=-1)
    number = np.full(fixed.shape, -1)
    number[~fixed] = np.arange(np.count_nonzero(~fixed))
    dofs, all_signs = number[functions].transpose(0, 2, 1).reshape(n, -1), np.tile(signs, 2)
    press, vertical = np.zeros((n, 2, functions.shape[1], 1)), np.zeros((2, functions.shape[1]))
    press[:, 1, :, 0] = (is_pressed & (degree == 1))[functions]
    vertical[1, :4] = 1.0
    unknowns, degrees = int(np.count_nonzero(~fixed)), np.repeat(degree.astype(int), 2)[~fixed.ravel()]
    moved = press.reshape(n, -1, 1)
    gather, pattern = build_gather(dofs, all_signs, unknowns), build_pattern(dofs, all_signs, unknowns)
    return Numbering(gather, moved, *pattern, all_signs, degrees, vertical.ravel()), moved


def _find_pressed(grid: _Grid, block: PressedBlock, start: Floats, end: Floats) -> Bools:
    """Return whether both ends of functions, numbers of radii, are within the pressed part."""
    radii, numbers = grid.corners[..., 0].ravel(), grid.labels[..., 0].ravel()
    low, high = (numbers[np.argmin(np.abs(radii - radius))] for radius in block.span)
    return np.asarray((low <= np.minimum(start, end)) & (np.maximum(start, end) <= high))


def _build_actuation(grid: _Grid, block: PressedBlock, layers: list[Bond | Film], skeleton: int) -> tuple[Ints, Floats]:
    """Return the elements under the electrode, and the elements' values u*, zero elsewhere, shape (n, 2 skeleton, 1)."""
    film, values = block.film, np.zeros((len(grid.layer), 2, skeleton))
    start = block.inner_radius + film.electrode_inset if block.inner_radius else 0.0
    middle = grid.corners[..., 0].mean(axis=1)
    number = 1 + next(k for k, layer in enumerate(layers) if isinstance(layer, Film))
    is_within = (middle > start) & (middle < block.outer_radius - film.electrode_inset)
    chosen = np.flatnonzero((grid.layer == number) & is_within)
    coefficients = np.array([film.mean_lateral_charge, film.d33]) / film.thickness
    values[chosen, :, :4] = np.swapaxes(coefficients * grid.corners[chosen], -1, -2)
    return chosen, values.reshape(len(grid.layer), -1, 1)


def _build_pressure(grid: _Grid, block: PressedBlock, shapes: Shapes) -> Floats:
    """Return the elements' forces under an even pressure, 1 N in all, on the pressed part, shape (n, 2 skeleton, 1)."""
    (low, high), skeleton = block.span, shapes.skeleton
    forces, radii = np.zeros((len(grid.layer), 2, skeleton)), grid.corners[:, :2, 0]
    middle = radii.mean(axis=1)
    chosen = np.flatnonzero((grid.labels[:, 0, 1] == 0) & (middle > low) & (middle < high))
    x, weights = np.polynomial.legendre.leggauss(shapes.order + 2)
    x, weights = (x + 1) / 2, weights / 2
    functions = evaluate_functions(np.stack([x, np.zeros_like(x)], axis=-1), shapes.degrees[:skeleton])[0]
    start, width = radii[chosen, :1], np.diff(radii[chosen], axis=1)
    areas = 2 * np.pi * (start + width * x) * width * weights  # of the rings round the quadrature's points, (elements, points)
    forces[chosen, 1] = areas @ functions / (np.pi * (high**2 - low**2))
    return forces.reshape(len(grid.layer), -1, 1)
