"""Press a design to the largest force that is allowed: by contact, where that is beyond linear elasticity.

``contact`` presses the design on the population's tissues without tumours, and so knows the force at each limit of indentation,
and where the gap closes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.design_search.loaded_limits import PressedDesign, list_indentation_limits
from probe_design.design_search.loads import PressingRule
from probe_design.populations.film_totals import check_loaded_charges
from probe_design.populations.loaded_scan import CONTACT_ACCURACY, press_tissue
from probe_design.populations.several_loads import limit_loads
from probe_design.populations.tables import DesignLimits
from solver.contact.pressed_tissue import PressedTissue
from solver.contact.states import StoppedError
from solver.contact.tumours_anywhere import prepare_tissue
from solver.planning.strains import compute_tissue_strain

LINEARITY_LIMITS = ("linearity", "gap_closure")  # of the force, due to linear elasticity
FORCE_LIMITS = ("scene", "force", "loads", "largest force", "pressure", "charge")  # of the force, whatever models it
MAX_PRESSES, LESS_LOAD = 6, 0.9  # of tries with less load each, where a finer mesh does not reach the load of the first one


def press_design(
    rule: PressingRule, scene: Scene, tissues: tuple[Scene, ...]
) -> tuple[Scene, PressedDesign, tuple[tuple[PressedTissue, ...], ...]]:
    """Return a scene under the largest allowed force, the force, and, if it is beyond linear elasticity, the pressed tissues.

    These are under each load of the protocol, or under the force. ``tissues`` are those of the tumours that verify; where
    ``contact`` fails, the force is that of linear elasticity.

    Raises
    ------
    Refusal
        See ``compute_pressed_design``.
    """
    linear = replace(rule, loaded=False).apply_force(scene)
    if not rule.loaded or linear[1].limited_by not in LINEARITY_LIMITS:
        return *linear, ()
    scenes = tuple(tissue.model_copy(update={"probe": scene.probe}) for tissue in tissues)
    allowed = {name: force for name, force in linear[1].allowed.items() if name in FORCE_LIMITS}
    try:
        for tissue in scenes:
            contact_limits = find_contact_limits(rule.design.limits, tissue, min(allowed.values()))
            allowed |= {name: min(force, allowed.get(name, force)) for name, force in contact_limits.items()}
        limited_by = min(allowed, key=lambda key: allowed[key])
        force, pressed, reached = press_tissues(scenes, allowed[limited_by], rule._choose_force)
        by_load = [
            pressed if load == force else [press_tissue(tissue, load) for tissue in scenes]
            for load in limit_loads(rule.design.protocol, force) or [force]
        ]
        for item in (item for items in by_load for item in items):
            check_loaded_charges(item.base.scene, item.bare.films)
    except (Refusal, SolveError):  # what linear elasticity allows remains
        return *linear, ()
    if force <= linear[1].force:
        return *linear, ()
    if not reached:
        limited_by = "last_converged"
        allowed[limited_by] = force
    indentation, strain, charges = read_pressed(pressed, force, rule.charge_per_force)
    charge_range = float(charges.min()), float(charges.max())
    design = PressedDesign(force, indentation, strain, charge_range, limited_by, allowed, loaded=True)
    return scene.model_copy(update={"load": Load(force=force)}), design, tuple(map(tuple, by_load))


def find_contact_limits(limits: DesignLimits, scene: Scene, force: float) -> dict[str, float]:
    """Return what ``contact`` and limits of indentation allow on one tissue, N: the smallest by its name, if below a force.

    Raises
    ------
    Refusal
        The scene is so extreme that it cannot be solved.
    """
    indentations = list_indentation_limits(limits, scene)
    name = min(indentations, key=lambda key: indentations[key], default="")
    tissue = prepare_tissue(scene.model_copy(update={"inclusion": ()}), CONTACT_ACCURACY)
    allowed, limited_by = tissue.find_largest_load(force, indentations.get(name, math.inf))
    return {} if limited_by == "force" else {name if limited_by == "indentation" else limited_by: allowed}


def press_tissues(
    tissues: tuple[Scene, ...], force: float, choose: Callable[[float], float]
) -> tuple[float, list[PressedTissue], bool]:
    """Press a probe on tissues to a force, or to less where the finer meshes do not reach it.

    Returns the force, N, the tissues under it, and whether it is the one that was asked for; ``choose`` returns the largest
    force up to an allowed one that is a value of the design file's variable.

    Raises
    ------
    Refusal
        ``contact`` presses the probe to no force.
    """
    fault: Exception | None = None
    for number in range(MAX_PRESSES):
        chosen = choose(force)
        try:
            return chosen, [press_tissue(tissue, chosen) for tissue in tissues], number == 0
        except StoppedError as stopped:
            fault, force = stopped, LESS_LOAD * min(chosen, stopped.last.force)
        except (Refusal, SolveError) as refused:
            fault, force = refused, LESS_LOAD * chosen
    raise Refusal("load.force", force, f"less: {fault}")


def read_pressed(pressed: list[PressedTissue], force: float, charge_per_force: float) -> tuple[float, float, Floats]:
    """Return the largest indentation, m, and tissue strain, and the charges of all films, C, without sign, under a force, N."""
    indentations = [float(item.bare.point.indentation) for item in pressed]
    scenes = [item.base.scene for item in pressed]
    strains = [
        x * float(compute_tissue_strain(scene.probe.tube_radius, scene.tissue))
        for x, scene in zip(indentations, scenes, strict=True)
    ]
    charges = []
    for item, scene in zip(pressed, scenes, strict=True):
        films = item.bare.films
        read = films.get_observable(scene)
        factor = charge_per_force if read is films else 1.0
        charges.append(np.abs(read.totals) / films.totals.sum() * force * factor)
    return max(indentations), max(strains), np.concatenate(charges)
