"""Bound the effect of details that a rotationally symmetric model leaves out, each as a compliance between block and base.

Films, an elastic base and the groove all make the support of the blocks more compliant. With F the film forces per unit
displacement, T = F 1 their totals and C the compliance that a detail adds, the forces become (F^-1 + C)^-1 and the totals change
by F C T to first order (RE.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.film import Film
from geometry.scenes.probe import Base, Probe
from solver.results.film_forces import Bound

FILM_DETAIL = "film compliance"
CHARGE_CHANGE_FACTOR = 2.0  # charges change more than forces where a detail changes the shear on a film, too


@dataclass(frozen=True)
class Detail:
    """A detail's name and the compliance that it adds, m/N, shape (2, 2).

    Attributes
    ----------
    is_exact
        Whether the compliance is exact and not an upper bound, so that equal changes of both films cancel in the ratio.
    lost_share
        Fraction of the outer film's force that the detail may remove in addition to the effect of its compliance.
    """

    name: str
    compliance: Floats
    is_exact: bool = False
    lost_share: float = 0.0

    def compute_bound(self, forces: Floats) -> Bound:
        """Return a bound on what the detail changes, by eq. RE.4, from the film forces without it, N/m, shape (2, 2)."""
        totals = forces.sum(axis=1)
        change = forces @ self.compliance @ totals  # eq. RE.4, of each film's total, N/m
        with np.errstate(divide="ignore"):
            inner, outer = change / totals
        ratio = abs(inner - outer) if self.is_exact else abs(inner) + abs(outer)
        return Bound(np.abs(change) + self.lost_share * np.abs(totals), float(ratio + self.lost_share))


def iterate_details(probe: Probe) -> Iterator[Detail]:
    """Yield the details of a probe beyond two blocks on a rigid base: groove, films, elastic base."""
    areas = np.array([probe.inner_area, probe.outer_area])  # of the films
    if probe.groove is not None:
        yield Detail("groove", _compute_groove_compliance(probe), lost_share=_compute_groove_loss(probe))
    if probe.film is not None:
        compliances = [_compute_stack_compliance(film) for film in probe.film.by_block]
        yield Detail(FILM_DETAIL, np.diag(compliances / areas), is_exact=True)
    if probe.base.youngs_modulus is not None:
        yield Detail("elastic base", _compute_base_compliance(probe.base, probe.tube_radius))


def _compute_groove_compliance(probe: Probe) -> Floats:
    """Return the compliance that a groove adds to the outer block, m/N.

    The block is a column of area A_1 and modulus E_1 that lacks a fraction f of its section over the groove's depth g.

    To first order it is more compliant by f g / (A_1 E_1) (RE.5); times 6, as stress concentrates round a
    notch. The converged 3D reference tests/reference/solid/groove-on-axis.toml asks for a factor of 3.
    """
    assert probe.groove is not None
    missing = probe.groove_footprint / probe.outer_area
    compliance = 6 * missing / (1 - missing) * probe.groove.depth / (probe.outer_area * probe.outer.youngs_modulus)
    return np.diag([0.0, compliance])


def _compute_groove_loss(probe: Probe) -> float:
    """Return the fraction of force lost because the floor under the groove bends: -1.5 ln(1 - f) g / h (RE.6).

    f is the fraction of the block's section that the groove removes, g the groove's depth and h the block's height. The formula
    is the loss of stiff blocks. A groove of 6 mm x 2.9 mm in blocks of 3 mm (f = 0.21) changes the ratio by 26 % at 10 MPa and 30
    % at 1 MPa in 3D finite elements; the bound is 34 % and more.
    """
    assert probe.groove is not None
    missing = probe.groove_footprint / probe.outer_area
    return -1.5 * float(np.log1p(-missing)) * probe.groove.depth / probe.tube_height


def _compute_stack_compliance(film: Film) -> float:
    """Return the compliance of film and bonds in series, times their area, m/Pa."""
    return sum(layer.thickness / layer.youngs_modulus for layer in film.stack if layer.youngs_modulus is not None)


def _compute_base_compliance(base: Base, radius: float) -> Floats:
    """Return the compliance of the elastic base for each block and between them, m/N: 2 (1 - nu^2) / (pi R E) (RE.7).

    The base is a half-space of modulus E and Poisson's ratio nu under the probe's footprint of radius R.

    Twice the rigid punch's compliance (1 - nu^2) / (2 R E) is 1 / (R E); uniform pressure gives
    16 (1 - nu^2) / (3 pi^2 R E). The value returned, (1 - nu^2) / (R E), covers both.
    """
    assert base.youngs_modulus is not None
    assert base.poisson_ratio is not None
    compliance = (1 - base.poisson_ratio**2) / (radius * base.youngs_modulus)
    return compliance * np.array([[2.0, 1.0], [1.0, 2.0]])
