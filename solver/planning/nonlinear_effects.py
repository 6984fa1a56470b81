"""What no evaluator can model yet, estimated at the scene's load: walls that meet, surfaces that part, finite strain."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from geometry.scenes.scene import Scene
from solver.planning.coarse_model import CoarseModel
from solver.results.film_forces import strains
from solver.results.result import Decision, Effect

NEARLY = 0.9  # of the gap closed: what the coarsest mesh cannot tell from all of it


def unmodelled(scene: Scene, rough: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """Yield what would change at the scene's load if nothing were linear."""
    totals = rough.forces.sum(axis=1)
    stiffness = float(totals.sum())
    load = scene.load
    indentation = load.indentation if load.indentation is not None else (load.force or 0.0) / stiffness
    yield _gap_contact(scene, rough, stiffness, indentation, accuracy)
    yield _lift_off(scene, rough, indentation, accuracy)
    stress = totals * indentation / np.array([scene.probe.inner_area, scene.probe.outer_area])
    where, strain = max(strains(scene.probe, stress, indentation).items(), key=lambda item: item[1])
    limit = f"{accuracy * stiffness * indentation / strain:.2g} N" if strain > 0 else "any load"
    reason = f"no evaluator: a strain of about {strain:.2g} in {where}; linear elasticity is good to {accuracy:g} up to {limit}"
    yield _decision("finite strain", strain, accuracy, reason)


def _gap_contact(scene: Scene, rough: CoarseModel, stiffness: float, indentation: float, accuracy: float) -> Decision:
    """Beyond the load that closes the gap the walls bear on each other: about the share of the load above it."""
    closed = rough.approach * indentation / scene.probe.gap
    effect = max(0.0, 1 - NEARLY / closed) if closed > 0 else 0.0
    reason = "no evaluator: the blocks' walls do not near each other"
    if rough.approach > 0:
        at = stiffness * scene.probe.gap / rough.approach
        reason = f"no evaluator: this load closes about {closed:.2g} of the gap, which closes at about {at:.2g} N"
    return _decision("gap contact", effect, accuracy, reason)


def _lift_off(scene: Scene, rough: CoarseModel, indentation: float, accuracy: float) -> Decision:
    """The share of forces that pull, and what a tilt raises in shares of the indentation."""
    tilted = math.tan(abs(scene.placement.tilt)) * scene.probe.tube_radius
    raised = max(0.0, 1 - indentation / tilted) if tilted > 0 else 0.0
    pulled = rough.pulled
    tie = "" if scene.contact.interface == "unilateral" else f" (interface = '{scene.contact.interface}' ties them)"
    reason = f"no evaluator: about {pulled:.2g} of the contact's force would pull the surfaces apart{tie}"
    if raised > 0:
        reason += f"; the tilt raises one side by {1e3 * tilted:.2g} mm at an indentation of {1e3 * indentation:.2g} mm"
    return _decision("lift-off", max(pulled, raised), accuracy, reason)


def _decision(feature: str, effect: float, accuracy: float, reason: str) -> Decision:
    return Decision.of(feature, False, Effect(effect, effect, effect), accuracy, reason)
