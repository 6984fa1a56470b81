"""Compute what the films' charges need: each film as an actuator, by which its charge is an energy of two states.

The charge of a film of thickness t is the integral over its electrode of the mean stress over the thickness,

    Q = Int (1/t) [d_p (s_r + s_t) + d33 s_z] dV,   d_p = (d31 + d32) / 2        (AX.14)

with the stresses s_r, s_t and s_z along the radius, round the axis and along z; d31 and d32 are averaged over all directions as
stresses do not depend on the angle. A displacement u* = (d_p r, d33 z) / t of the electrode's part of the film has the uniform
strain (d_p, d_p, d33) / t there, so that Q = a_film(u*, u) is the energy of u* with the state u in that part alone. The film
state is s = w - u*, with w the displacement that the probe has under the forces of u*: a(w, .) = a_film(u*, .). As a base state u
is in equilibrium, a(w, u) = 0, and

    Q = -a(s, u),        (AX.15)

the same energy product as a film force, with an error that falls at twice the rate of the displacements. The toolkit's charge is
-Q: it has the sign of d33 where a film is pressed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric
from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import FILMS, Section
from geometry.scenes.film import Film
from solver.linalg.workspace import keep_table

Films = tuple[Film, Film]  # of the inner and of the outer block
COMPLEX_STEP = 1e-30  # relative: a complex step subtracts nothing, so that it can be this small
CHARGE_VARIABLES = tuple(f"{body.name.lower()}_{key}_charge" for body in FILMS for key in ("lateral", "normal"))  # d_p and d33
CHARGE_UNIT = 1e-9  # C: in it film states are about as large as base states, and neither is lost beside the other


def build_film_lift(section: Section, mesh: Topology, corners: Floats, skeleton: int, films: Films) -> Floats:
    """Return the elements' displacements -u* of both films, per ``CHARGE_UNIT``, for eq. AX.15.

    Parameters
    ----------
    section, mesh
        With layers on both blocks.
    corners
        Of the elements, m, shape (n, 4, 2).
    skeleton
        Number of an element's functions on corners and edges.
    films
        The inner and the outer film.

    Returns
    -------
    Floats
        Values of u_r and u_z on corners and edges, of n elements, shape (n, 2 skeleton, 2); zero outside the film's electrode.
    """
    lift = np.zeros((len(mesh.body), 2, skeleton, 2))
    for k, chosen in enumerate(_find_electrodes(mesh)):
        # linear displacements are those of the corners' functions alone
        lift[chosen, :, :4, k] = get_coefficients(films[k])[:, None] * _compute_actuation(section, k, corners[chosen])
    return lift.reshape(len(mesh.body), -1, 2)


def differentiate_film_lift(section: Section, mesh: Topology, skeleton: int, films: Films) -> list[tuple[Ints, Floats]]:
    """Return derivatives of the films' lifts, see ``build_film_lift``, by ln of each length, and by d_p and d33 of both films.

    Returns
    -------
    list[tuple[Ints, Floats]]
        For each film, the numbers of the c elements under its electrode, and the derivatives of their values, shape
        (lengths + 4, c, 2 skeleton), the last four by ``CHARGE_VARIABLES``, per C/N.
    """
    names = section.lengths
    steps = 1 + 1j * COMPLEX_STEP * np.eye(len(names))  # row k: a complex step of ln of each length in column k alone
    moved = replace(section, **{name: getattr(section, name) * steps[k] for k, name in enumerate(names)})
    electrodes, changes = _find_electrodes(mesh), []
    # of both films together: the mesh's lines, which take most of the time, are placed once
    nodes = np.split(compute_nodes(moved, mesh, UNIT_SQUARE, np.concatenate(electrodes)), [len(electrodes[0])], axis=-3)
    for k, chosen in enumerate(electrodes):
        corners = _compute_actuation(moved, k, nodes[k])
        changed = np.zeros((len(names) + len(CHARGE_VARIABLES), len(chosen), 2, skeleton))
        changed[: len(names), ..., :4] = get_coefficients(films[k])[:, None] * np.imag(corners) / COMPLEX_STEP
        for component in (0, 1):
            changed[len(names) + 2 * k + component, :, component, :4] = np.real(corners[0, :, component])
        changes.append((chosen, changed.reshape(len(changed), len(chosen), -1)))
    return changes


def get_coefficients(film: Film) -> Floats:
    """Return d_p and d33 of a film, C/N, which multiply the displacements u_r and u_z of its actuation."""
    return np.array([film.mean_lateral_charge, film.d33])


@keep_table
def _find_electrodes(mesh: Topology) -> list[Ints]:
    """Return the numbers of each film's elements under its electrode."""
    columns = mesh.vertices[..., 0]
    low, high = columns.min(axis=1), columns.max(axis=1)
    return [
        np.flatnonzero((mesh.body == body) & (low >= start) & (high <= end))
        for body, (start, end) in zip(FILMS, mesh.layout.electrodes, strict=True)
    ]


def _compute_actuation(section: Section, k: int, corners: Numeric) -> Numeric:
    """Return -u* of film k for d_p = d33 = 1 at elements' corners, (..., c, 4, 2), with the components before the corners."""
    thickness = np.asarray(getattr(section, FILMS[k].name.lower()))[..., None, None, None]
    return -np.swapaxes(corners, -1, -2) / (thickness * CHARGE_UNIT)
