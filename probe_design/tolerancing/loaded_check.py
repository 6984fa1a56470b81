"""Check a budget under load by ``contact``: two probes as built, one standard deviation of ln ratio apart from the drawing.

The samples' quotient q of eq. TO.2 is that of light loads. Along the unit vector e of standard normal numbers that changes ln
ratio most, with y+ and y- an output at e and -e, s its standard deviation to first order and a e that along e,

    q_e = (s^2 - (a e)^2 + (y+ - y-)^2 / 4 + (y+ + y- - 2 y)^2 / 2)^(1/2) / s                      (TO.8)

is the same quotient of first and second order along e alone. What ``contact`` and the closed form differ in it is an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from probe_design.tolerancing.film_numbers import TAPE_COEFFICIENT_PER_K, list_shared_moduli, list_tape_moduli
from probe_design.tolerancing.sample_statistics import SampleStatistics, build_output_function
from probe_design.tolerancing.uncertain_numbers import GAIN_NAMES, GAP_KEY, RADIUS_KEY, UncertainNumber
from solver.contact.evaluator import ContactEvaluator
from solver.results.result import Result


def _build_probe(scene: Scene, variables: Sequence[UncertainNumber], drawn: Mapping[str, float]) -> Scene:
    """Return the scene of a built probe, whose numbers ``drawn`` are given by name; gains are not part of it."""
    values, shared = list_values(scene), list_shared_moduli(scene)
    new = {
        key: drawn[item.name] for item in variables for key in shared.get(item.name, (item.name,))
        if item.kind not in ("gain", "temperature")
    }  # fmt: skip
    for variable in variables:
        if variable.kind == "temperature":  # eq. TO.7
            new |= {
                key: new.get(key, modulus) * math.exp(-TAPE_COEFFICIENT_PER_K * drawn[variable.name])
                for key, modulus in list_tape_moduli(scene).items()
            }
    if RADIUS_KEY in new:  # the workshop makes the hole, eq. TO.6
        new[GAP_KEY] = new.get(GAP_KEY, values[GAP_KEY]) - (new[RADIUS_KEY] - values[RADIUS_KEY])
    return scene.replace(new)


def compute_built_outputs(scene: Scene, variables: Sequence[UncertainNumber], eta: Floats, accuracy: float) -> Floats:
    """Return the four outputs of a built probe by ``contact``, shape (4,), at standard normal numbers ``eta``, shape (v,).

    Raises
    ------
    Refusal
        ``contact`` does not reach the load with this probe, or a film is not pressed.
    """
    drawn = {item.name: float(item.draw(number)) for item, number in zip(variables, eta, strict=True)}
    built, log_gains = _build_probe(scene, variables, drawn), np.log([drawn.get(name, 1.0) for name in GAIN_NAMES])
    return _read_outputs(scene, built, ContactEvaluator().evaluate(built, accuracy), log_gains)


def _read_outputs(drawn: Scene, built: Scene, result: Result, log_gains: Floats) -> Floats:
    """Return the four outputs of a result for a built probe; ``log_gains`` are those of both films, shape (2,)."""
    read, probe = result.reading, built.probe
    if read.ratio is None or read.ratio <= 0 or result.stiffness is None:
        raise Refusal("load", "ratio", "a scene whose films are both pressed")
    ln_ratio = math.log(read.ratio) + float(log_gains @ [1.0, -1.0])
    areas = math.log(probe.inner_area / probe.outer_area * drawn.probe.outer_area / drawn.probe.inner_area)
    forces = np.array([(result.stress_inner or 0.0) * probe.inner_area, (result.stress_outer or 0.0) * probe.outer_area])
    stiffness = result.stiffness * float(np.exp(log_gains) @ forces / forces.sum())
    return np.array([ln_ratio, ln_ratio + areas, math.log(stiffness), read.log_sensitivity or 0.0])


def compute_load_errors(
    scene: Scene, variables: Sequence[UncertainNumber], contributions: Floats, statistics: SampleStatistics, result: Result,
    *, accuracy: float,
) -> Floats | None:  # fmt: skip
    """Return by how much the load may change q of the four outputs, eq. TO.8, shape (4,); None where ``contact`` refuses.

    Parameters
    ----------
    scene
        Given by its outer radius.
    variables
        The v uncertain numbers.
    contributions
        a of eq. TO.4 under the load, shape (4, v).
    statistics
        Of samples of light loads.
    result
        Of the probe as drawn, by ``contact``.
    accuracy
        Of ``contact``.
    """
    size = float(np.linalg.norm(contributions[0]))
    if size == 0:
        return np.zeros(len(contributions))
    direction = contributions[0] / size
    light_sides = build_output_function(scene, variables)(np.column_stack([direction, -direction, 0 * direction])).T
    try:
        sides = [compute_built_outputs(scene, variables, side * direction, accuracy) for side in (1.0, -1.0)]
        middle = _read_outputs(scene, scene, result, np.zeros(2))
    except InputError:
        return None
    loaded = _compute_quotients(contributions, direction, [*sides, middle])
    return np.asarray(np.abs(loaded - _compute_quotients(statistics.derivatives, direction, light_sides)))


def _compute_quotients(contributions: Floats, direction: Floats, values: Sequence[Floats]) -> Floats:
    """Return q_e of eq. TO.8 of the four outputs, shape (4,), from their values at e, at -e and as drawn; 1 where s is 0."""
    upper, lower, middle = values
    variances = (contributions**2).sum(axis=1)
    along = (upper - lower) ** 2 / 4 + (upper + lower - 2 * middle) ** 2 / 2 - (contributions @ direction) ** 2
    return np.asarray(np.sqrt(1 + np.divide(along, variances, out=np.zeros_like(along), where=variances > 0)))
