"""Details that a rotationally symmetric level leaves out, each as a compliance between block and base.

Films, an elastic base and the groove all make the blocks' ends give way. With F the film forces
per unit displacement and C the compliance that a detail adds, (F^-1 + C)^-1 lies between
F - F C F and F, eq. (D1): the size of F C F bounds what the detail changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.grading import Floats
from geometry.probe import Base, Film, Probe


@dataclass(frozen=True)
class Detail:
    """A detail's name and the compliance that it adds, m/N, shape (2, 2)."""

    name: str
    compliance: Floats

    def change(self, forces: Floats) -> Floats:
        """Bound on the change of the film forces, eq. (D1); shape (2, 2)."""
        return np.abs(forces) @ self.compliance @ np.abs(forces)


def details(probe: Probe) -> Iterator[Detail]:
    """Yield what the probe has beyond two blocks on a rigid base."""
    areas = np.array([probe.inner_area, probe.outer_area])
    if probe.groove is not None:
        yield Detail("groove", _groove(probe))
    if probe.film is not None:
        yield Detail("film compliance", np.diag(_film(probe.film) / areas))
    if probe.base.youngs_modulus is not None:
        yield Detail("elastic base", _base(probe.base, probe.tube_radius))


def _groove(probe: Probe) -> Floats:
    """Eq. (D2): the strain energy of the material cut away, times 3 for what the stress does round the notch.

    A column of area A_1 whose share f of the section is missing over the groove's depth g is
    more compliant by f g / (A_1 E_1) to first order.
    """
    assert probe.groove is not None
    missing = probe.groove_footprint / probe.outer_area
    give = 3 * missing / (1 - missing) * probe.groove.depth / (probe.outer_area * probe.outer.youngs_modulus)
    return np.diag([0.0, give])


def _film(film: Film) -> float:
    """Compliance times area of film and adhesive in series, m/Pa; the adhesive is as soft as its modulus says."""
    adhesive = film.adhesive_thickness / (film.adhesive_modulus or film.youngs_modulus)
    return film.thickness / film.youngs_modulus + adhesive


def _base(base: Base, radius: float) -> Floats:
    """Eq. (D3): a half-space under the probe's footprint, 2 (1 - nu^2) / (pi R E), for each block and between them.

    Twice the rigid punch's compliance (1 - nu^2) / (2 R E) is 1 / (R E); uniform pressure gives
    16 (1 - nu^2) / (3 pi^2 R E). The bound taken covers both.
    """
    assert base.youngs_modulus is not None
    assert base.poisson_ratio is not None
    give = (1 - base.poisson_ratio**2) / (radius * base.youngs_modulus)
    return give * np.array([[2.0, 1.0], [1.0, 2.0]])
