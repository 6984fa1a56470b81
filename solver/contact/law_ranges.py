"""Warn where materials are strained beyond the curves that their laws were fitted to.

Corners of blocks strain without limit in theory, so that a largest strain would warn always. What counts is the energy that is
stored beyond the curve's I - 3: the share of a part's response that its law extrapolates.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.meridian.section import LAYERS, Body
from geometry.scenes.scene import Scene
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.states import State
from solver.results.warnings import Note

MAX_ENERGY_SHARE = 0.01  # of a part's stored energy: an extrapolation of less changes stresses by less than other errors
NAMES = {Body.TISSUE: "tissue", Body.INNER: "probe.inner", Body.OUTER: "probe.outer", Body.INCLUSION: "inclusion"}
NAMES |= {body: f"tissue.layer[{k}]" for k, body in enumerate(LAYERS)}


def list_range_notes(scene: Scene, model: ContactModel, state: State) -> Iterator[Note]:
    """Yield a warning for each part of which more than ``MAX_ENERGY_SHARE`` of the energy is beyond its law's curve.

    Parameters
    ----------
    scene
        Its materials have ``law_strain`` where they were fitted to a curve.
    model, state
        The deformed section.
    """
    limits = {body: material.law_strain for body, material in build_sections(scene).materials.items()}
    if not any(limits.values()):
        return
    energies, distortions = model.elements.compute_energies(state.elements), model.elements.compute_distortions(state.elements.u)
    for body, strain in limits.items():
        if strain is None:
            continue
        elements = model.mesh.body == body
        share = _compute_share(energies[elements], distortions[elements] > compute_distortion(strain))
        if share > MAX_ENERGY_SHARE:
            text = f"{share:.0%} of its strain energy lies beyond a strain of {strain:g}, to which its law was measured"
            yield Note("law", f"{NAMES[body]}: {text}: the law is extrapolated there")


def compute_distortion(strain: float) -> float:
    """Return I - 3 of an incompressible body at a strain in uniaxial tension."""
    return float((1 + strain) ** 2 + 2 / (1 + strain) - 3)


def _compute_share(energies: Floats, beyond: Bools) -> float:
    """Return the share of the energies where ``beyond`` is true."""
    total = float(energies.sum())
    return float(np.sum(energies[beyond])) / total if total > 0 else 0.0
