"""How strong an inclusion is, whatever its size and stiffness are by themselves.

Far from a sphere only its strength is felt (PHYSICS section 2),

    S = D^3 (c - 1) / (1 + beta (c - 1)),   c = E_object / E_tissue,   beta = 2 (4 - 5 nu) / (15 (1 - nu))     (ES.1)

in m^3, positive where it is stiffer than the tissue, at most D^3 / beta and at least -D^3 / (1 - beta).
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
    """Best fit and 95 % intervals; an end is None where it is beyond what could be searched.

    Attributes:
        depth: m.
        strength: m^3.
        modulus, diameter: of the body that stands for the strength, Pa and m.
    """

    depth: float
    depth_interval: Interval
    strength: float
    strength_interval: Interval
    modulus: float
    diameter: float


def strength(tissue: Material, body: Inclusion, modulus: Floats | None = None, diameter: Floats | None = None) -> Floats:
    """Eq. ES.1 of a body, or of the same with other moduli (Pa) or diameters (m), in m^3; a modulus may be inf."""
    beta = share_of_shear(tissue)
    more = np.asarray(body.youngs_modulus if modulus is None else modulus, dtype=float) / tissue.youngs_modulus - 1
    size = np.asarray(body.diameter if diameter is None else diameter, dtype=float)
    with np.errstate(invalid="ignore"):
        share = np.where(np.isinf(more), 1 / beta, more / (1 + beta * more))
    return np.asarray(size**3 * share)


def share_of_shear(tissue: Material) -> float:
    """Return beta of eq. ES.1."""
    nu = tissue.poisson_ratio
    return 2 * (4 - 5 * nu) / (15 * (1 - nu))
