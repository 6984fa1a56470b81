"""How a block gives way at its tissue end, held by the base at the other: Ritz's method with few functions.

A block is a disc, y = r / radius, or a tube, y = (r - hole) / wall, of height h; zeta runs from its tissue end (0) to the base
(h). Displacements, w towards the tissue and u outwards, are products

    w = sum W_ij P_i f_j(zeta),     u = (1/r) sum a_ij U_i g_j(zeta)                              (CF.8)

with Legendre's polynomials P_i on (0, 1), of y^2 in a disc, of y in a tube, and U_i = Int P_i r dr, in a tube a constant too.
The trace of the strain is d(r u)/dr / r - dw/dzeta; every dU/dr / r g is also a dw/dzeta, as f_0 = 1 - zeta/h and
f_j = -Int_zeta^h g / h. So volume can be kept wherever shape changes and nothing locks as nu nears 1/2. With v = 1 - zeta/h and a
decay b of the block's width,

    g_j = (1 - exp(-b h v)) / (1 - exp(-b h)) ((exp(-b zeta) - exp(-b h)) / (1 - exp(-b h)))^j      (CF.9)

which are v, v^2, v^3 in a flat block and, in a tall one, a column clamped at the base with what decays from its loaded end.
The stiffness K of these functions and the work B of tractions on them give the compliance B K^-1 B^T of the end.

With each u goes the w that keeps its volume, -h f_j+1 P_i, so that lambda is in the stiffness of w alone; of these, of modes that
diagonalise the integrals, D is diagonal. What is left to solve for are the amounts a,

    K = [S + X D^-1 X^T, X; X^T, D],   B K^-1 B^T = E S^-1 E^T + C D^-1 C^T,   E = A - C D^-1 X^T     (CF.23)

with the work A of tractions on the u, and C on the modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from solver.closed_form.bessel import Array
from solver.closed_form.block_functions import (
    AXIAL,
    FINE_AXIAL,
    RADIAL,
    AxialIntegrals,
    RadialIntegrals,
    axial_integrals,
    radial_integrals,
)


def _polynomials() -> Any:
    P = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADIAL)]
    return P, [p.deriv() for p in P], [p.integ(lbnd=0) for p in P]


_POLYNOMIALS = _polynomials()


@dataclass(frozen=True)
class ElasticBlocks:
    """Blocks, all solid (``hole`` None) or all tubes: radii, height, modulus, Poisson's ratio; arrays of shape (n,), SI.

    ``fine`` asks for more functions, in the block and under it.
    """

    hole: Array | None
    radius: Array
    height: Array
    E: Array
    nu: Array
    fine: bool = False

    @property
    def start(self) -> Array:
        """Inner radius, m."""
        return 0 * self.radius if self.hole is None else self.hole

    @property
    def width(self) -> Array:
        """Radius of a disc, wall of a tube, m."""
        return self.radius - self.start

    @property
    def area(self) -> Array:
        """Area of the end, m^2."""
        return np.pi * self.width * (self.radius + self.start)

    @property
    def steepness(self) -> Array:
        """The decay b of eq. CF.9 times the height."""
        return (2.2 if self.hole is None else 2.0) * self.height / self.width

    def radii(self, y: Any) -> Array:
        """Radii at shares y (k,) of the width, shape (n, k)."""
        return self.start[:, None] + self.width[:, None] * np.asarray(y)


def end_compliance(block: ElasticBlocks, bonded: bool) -> Array:
    """Work of the end's displacements under unit loads on each other, pressures before shears, shape (n, loads, loads).

    m^3/N times m^2; the shears' functions are meant times r / radius.
    """
    wall = None if block.hole is None else block.width / block.radius
    across = radial_integrals(wall, block.fine)
    along = axial_integrals(block.steepness, FINE_AXIAL if block.fine else AXIAL)
    slender = block.height / block.width
    pressures, shears = len(across.pressed), len(across.sheared)
    kept, rows = len(across.sheared[0]) - len(across.tilt), pressures + shears
    on_u = np.zeros((rows, kept + len(across.tilt), len(along.f_end), len(slender)), dtype=slender.dtype)
    on_u[:pressures, kept:] = across.pressed[:, :, None] * (along.f_end * slender)
    on_u[pressures:] = across.sheared[:, :, None]
    on_modes = np.zeros((rows, len(across.slope), len(along.end), len(slender)), dtype=slender.dtype)
    on_modes[:pressures] = across.pressed_modes[:, :, None] * along.end
    system = reduced(block.nu, slender, (across, along), (on_u, on_modes))
    mu = _softened(block, bonded) / (2 * (1 + block.nu))
    return system.compliance(system.answer) * (block.width * block.width * block.radius / mu)[:, None, None]


def radial(radius: Array, r: Array) -> tuple[Array, Array, Array]:
    """P_i, dP_i/dr and U_i / r of discs at distances r (n, k) > 0 from the axis, shapes (n, functions, k)."""
    s = (r / radius[:, None]) ** 2
    P, slope, U = (np.stack([p(s) for p in kind], axis=1) for kind in _POLYNOMIALS)
    return P, slope * (2 * s / r)[:, None], U * (r / (2 * s))[:, None]


@dataclass(frozen=True)
class RitzSystem:
    """Eq. CF.23 of blocks of width 1, shear modulus 1, all divided by the outer radius.

    Attributes:
        S: shape (n, u, u).
        E: shape (n, loads, u).
        C: shape (n, loads, modes).
        X_over_D, C_over_D: X D^-1 and C D^-1, shapes (n, u, modes) and (n, loads, modes).
    """

    S: Array
    E: Array
    C: Array
    X_over_D: Array
    C_over_D: Array

    @property
    def answer(self) -> Array:
        """The amounts a under unit loads, shape (n, u, loads)."""
        return np.linalg.solve(self.S, self.E.swapaxes(1, 2))

    def compliance(self, answer: Array) -> Array:
        """B K^-1 B^T, shape (n, loads, loads)."""
        return self.E @ answer + self.C @ self.C_over_D.swapaxes(1, 2)

    def modes(self, answer: Array) -> Array:
        """The amounts of the modes that go with the a, shape (n, modes, loads)."""
        return self.C_over_D.swapaxes(1, 2) - self.X_over_D.swapaxes(1, 2) @ answer


def reduced(
    nu: Array, slender: Array, integrals: tuple[RadialIntegrals, AxialIntegrals], loads: tuple[Array, Array]
) -> RitzSystem:
    """Set up eq. CF.23.

    Args:
        nu: Poisson's ratios, shape (n,).
        slender: heights over widths, shape (n,).
        integrals: across the blocks and along them.
        loads: work of l loads on each u and mode, shapes (l, U_i, g_j, n) and (l, P_i, f_j, n).
    """
    across, along = integrals
    share = 1 - 2 * nu
    soft = share / ((2 - 2 * nu) / slender * along.slope + (across.slope * (share * slender))[:, None])  # D^-1
    mixed = _mixed(across, along, slender)
    u, modes = mixed.shape[0] * mixed.shape[1], mixed.shape[2] * mixed.shape[3]
    rows = np.empty((u + len(loads[0]), u + 2 * modes, len(nu)), dtype=soft.dtype)
    _own(across, along, slender, rows[:u, :u].reshape(*mixed.shape[:2], *mixed.shape[:2], -1))
    for at, on_u, on_modes in ((slice(None, u), None, mixed), (slice(u, None), *loads)):
        if on_u is not None:
            rows[at, :u] = on_u.reshape(len(on_u), u, -1)
        rows[at, u : u + modes] = on_modes.reshape(-1, modes, len(nu))
        rows[at, u + modes :] = (on_modes * soft).reshape(-1, modes, len(nu))
    full = np.ascontiguousarray(rows.transpose(2, 0, 1))  # blocks were last, which is fast for all but products
    on_modes, over = full[:, :, u : u + modes], full[:, :, u + modes :]
    left = full[:, :, :u] - on_modes @ over[:, :u].swapaxes(1, 2)
    return RitzSystem(left[:, :u], left[:, u:], on_modes[:, u:], over[:, :u], over[:, u:])


def _own(across: RadialIntegrals, along: AxialIntegrals, slender: Array, K: Array) -> None:
    """Write the stiffness of the u and of the w that goes with each into K, shape (U_i, g_j, U_i, g_j, n)."""
    np.multiply(across.strain[:, None, :, None], (along.gg * slender)[None, :, None], out=K)
    K += across.slide[:, None, :, None] * (along.dg_dg / slender)[None, :, None]
    beside = K[:, :, -len(across.tilt) :]
    turn = across.turn[:, None, :, None] * (along.dg_f * slender)[None, :, None]
    beside -= turn
    K[-len(across.tilt) :] -= np.moveaxis(turn, (0, 1), (2, 3))
    beside[-len(across.tilt) :] += across.tilt[:, None, :, None] * (along.ff * slender**3)[None, :, None]


def _mixed(across: RadialIntegrals, along: AxialIntegrals, slender: Array) -> Array:
    """X of eq. CF.23, shape (U_i, g_j, P_i, f_j, n)."""
    X = across.turned[:, None, :, None] * -along.dg_mode[None, :, None]
    bent = (across.slope * slender * slender)[:, None] * along.f_mode[:, None]
    X[-len(across.lift) :] += across.lift[:, None, :, None] * (2 * along.g_dmode[:, None] + bent)
    return X


# by which share the functions are too stiff, with w the width:
# (2 nu)^power / (tall h/w (w/radius)^(3/2) + constant + flat w/h) (CF.10)
_STIFF = {
    (True, True): (4.05, 3.97, 4.51, 5.92),
    (True, False): (8.24, 8.17, 1.89, 4.89),
    (False, True): (1.65, 8.19, 1.58, 7.06),
    (False, False): (8.72, 4.27, 4.68, 3.50),
}  # solid or tube; bonded or frictionless


def _softened(block: ElasticBlocks, bonded: bool) -> Array:
    """E without what the few functions are too stiff by, as they leave out the corners' singularities: eq. CF.10.

    Fitted to finite elements of 300 blocks on stiff ground by ``benchmarks/closed_form/blocks.py``; what is left is
    below 1.5 % of a disc, 6 % of a tube. More functions are taken as they are.
    """
    if block.fine:
        return block.E
    tall, constant, flat, power = _STIFF[block.hole is None, bonded]
    slender, thin = block.height / block.width, block.width / block.radius
    return block.E / (1 + (2 * block.nu) ** power / (tall * slender * thin**1.5 + constant + flat / slender))
