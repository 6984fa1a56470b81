"""Effect of laws at finite strain that are not neo-Hookean on the rule for loads."""

from __future__ import annotations

import numpy as np

from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.materials.strain_energies import StrainEnergy, build_strain_energy

STIFFENING_COEFFICIENT, DISTORTION_COEFFICIENT = 0.24, 17.0  # of eq. PL.12: 11 scenes, c2 1 and 10, c3 1 and 30, need 0.7 of it
INNER_SHARE = 1 / 8  # likewise of blocks and inclusions: a soft tumour needs half of it
TESTED_COUNT, MIN_TESTED_X = 400, 1e-6


def compute_law_factor(scene: Scene, max_x: float) -> float:
    """Return the factor s by which the laws of a scene's materials increase x; 1 where all are neo-Hookean.

    A law f, in shear moduli, is stiffer or softer by 2 f' - 1 than a neo-Hookean one. In tissue and layers under x that adds

        0.24 max |2 f'(I) - 1|  over  I = I_1 - 3 up to 17 x^2      (PL.12)

    to x, in blocks and inclusions an eighth of it. It grows faster than x, of which the rule knows nothing above ``max_x``: s is
    the least number so that s x includes it for every x up to ``max_x`` / s.
    """
    probe, tissue = scene.probe, scene.tissue
    x = np.geomspace(MIN_TESTED_X, max_x, TESTED_COUNT)
    outer, inner = (_list_laws(bodies) for bodies in ((tissue, *tissue.layer), (probe.inner, probe.outer, *scene.inclusion)))
    if not outer and not inner:
        return 1.0
    added = np.zeros(TESTED_COUNT)
    for share, laws in ((1.0, outer), (INNER_SHARE, inner)):
        for law in laws:
            change = np.maximum.accumulate(np.abs(2 * law.evaluate(DISTORTION_COEFFICIENT * x**2)[1] - 1))
            added = np.maximum(added, share * STIFFENING_COEFFICIENT * change)
    factors = np.maximum.accumulate(1 + added / x)
    return max_x / float(np.interp(max_x, factors * x, x))


def _list_laws(materials: tuple[Material, ...]) -> list[StrainEnergy]:
    return [law for material in materials if (law := build_strain_energy(material)) is not None]
