"""Film forces of one section on one mesh."""

from __future__ import annotations

import numpy as np

from geometry.common.errors import SolveError
from geometry.meridian.frame import Fineness, Kind
from geometry.meridian.grading import Floats
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import base_states, model
from solver.axisymmetric.modulus_response import response
from solver.axisymmetric.refinement import Sample
from solver.axisymmetric.sections import Sections


def sample(
    section: Section, of: Sections, scene: Scene, level: Fineness, moduli: Floats | None = None, kind: Kind | None = None
) -> Sample:
    """Solve one section on one mesh, at the inclusion's modulus or at all ``moduli``.

    Raises:
        SolveError: the equations cannot be solved in double precision.
    """
    materials, interface = dict(of.materials), scene.contact.interface
    assert interface != "unilateral"  # refused before
    if moduli is not None:
        shift = _middle(moduli, scene.tissue.youngs_modulus)
        ratio = scene.inclusion[0].poisson_ratio
        materials[Body.INCLUSION] = Material(youngs_modulus=shift, poisson_ratio=ratio)
    try:
        states = base_states(model(section, materials, interface, level, kind))
    except np.linalg.LinAlgError as fault:  # Poisson's ratio within rounding of 1/2
        raise SolveError(f"an element's matrix cannot be inverted: {fault}") from fault
    if moduli is None:
        slope = states.slope() if scene.inclusion else np.zeros((2, 2))
        return Sample(states.forces[None], slope[None], states, np.ones(1))
    times = moduli / shift
    spanned = response(states, times.min(), times.max())
    return Sample(*spanned.forces(times), states, times, spanned)


def _middle(moduli: Floats, tissue: float) -> float:
    """The modulus from which a curve is spanned: the middle of its part in which the film forces change."""
    low, high = np.clip([moduli.min(), moduli.max()], 0.01 * tissue, 100 * tissue)
    return float(np.sqrt(low * high))
