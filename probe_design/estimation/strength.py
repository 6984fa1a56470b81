"""Compute the strength of an inclusion: the combination of size and stiffness that determines its effect from far.

Far from a sphere of diameter D its effect depends on its strength S alone (PHYSICS section 2),

    S = D^3 (c - 1) / (1 + beta (c - 1)),   c = E_object / E_tissue,   beta = 2 (4 - 5 nu) / (15 (1 - nu))     (ES.1)

in m^3, with nu the tissue's Poisson's ratio; S is positive where the sphere is stiffer than the tissue, at most D^3 / beta and at
least -D^3 / (1 - beta).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from geometry.scenes.scene import Inclusion

Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class DepthAndStrength:
    """Best fit and 95 % intervals; an end is None where the search range ends before the interval.

    Attributes
    ----------
    depth
        m.
    strength
        m^3.
    modulus, diameter
        Of a body with this strength, Pa and m.
    """

    depth: float
    depth_interval: Interval
    strength: float
    strength_interval: Interval
    modulus: float
    diameter: float


def compute_strength(tissue: Material, body: Inclusion, modulus: Floats | None = None, diameter: Floats | None = None) -> Floats:
    """Return the strength, eq. ES.1, of a body, or of bodies with other moduli (Pa) or diameters (m), in m^3."""
    beta = eshelby_beta(tissue)
    contrast_minus_one = np.asarray(body.youngs_modulus if modulus is None else modulus, dtype=float) / tissue.youngs_modulus - 1
    size = np.asarray(body.diameter if diameter is None else diameter, dtype=float)
    with np.errstate(invalid="ignore"):
        relative_strength = np.where(np.isinf(contrast_minus_one), 1 / beta, contrast_minus_one / (1 + beta * contrast_minus_one))
    return np.asarray(size**3 * relative_strength)


def eshelby_beta(tissue: Material) -> float:
    """Return beta of eq. ES.1, the shear part of Eshelby's tensor of a sphere in a tissue."""
    nu = tissue.poisson_ratio
    return 2 * (4 - 5 * nu) / (15 * (1 - nu))
