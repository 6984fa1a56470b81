"""Readings over a population by the equivalent-inclusion level, with what surface, blocks and floor send back: what a judge asks.

The probe is solved once on each tissue. All tumours are answered to first order at once, and those of which that is not good to a
share of the readings' noise once more with reflections. Derivatives by the tissue's numbers are differences of the first order on
one mesh that moves with them. Signals s do not change where all moduli grow alike, in either answer, so that what reflections
add to all slopes by them is 0 together; blocks and other layers, which meet in the first order already, have hardly any of it:

    ds/d ln E_host = first order - (ds/d ln E_object - first order of that)                           (PO.9)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, fields

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Placement, Scene
from geometry.scenes.variables import values
from probe_design.maps.scan_line import ScanLine
from probe_design.maps.sphere_effects import CHANGES
from probe_design.populations.noise import reading_deviations
from probe_design.populations.population import ScenePopulation, TumourDraw, host_modulus, is_of_tumour, scene_key
from probe_design.populations.readings import ScanReadings, logarithms
from probe_design.populations.tables import NoiseModel, Protocol
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, in_other_tissue
from solver.equivalent_inclusion.readings import Readings, readings
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import LoadChanges, check_load, load_rule

Progress = Callable[[int, int], None]
ACCURACY = 0.01  # of the probe without tumours: it cancels in what tumours change, but for its share of that
SHARE = 0.15  # of a reading's noise: bounds on what reflections change that are left out, and counted in the errors
MOST, MOST_LAYERED = 400, 80  # readings with reflections, of one material and of layers, where each takes half a second
STEP = 0.002  # of logarithms of the tissue's numbers
LARGEST_CHANGE = 0.5  # of the ratio by the load: what is far beyond it is refused anyway
OF_TARGET = {"depth": "depth", "diameter": "diameter", "object": "youngs_modulus", "x": "offset"}


@dataclass(frozen=True)
class InclusionScan:
    """One tissue with its tumours under a protocol.

    Attributes:
        draw, protocol: the tumours and the readings.
        number: of the tissue.
        base: the probe on it.
    """

    draw: TumourDraw
    protocol: Protocol
    number: int
    base: Undisturbed

    @classmethod
    def of(cls, draw: TumourDraw, protocol: Protocol, number: int) -> InclusionScan:
        """Solve the probe on one tissue; its bounds are those of the position farthest from the middle.

        Raises:
            Refusal: the level cannot take the scene.
        """
        scene = draw.tissues[number]
        far = Placement(x=float(np.abs(protocol.places).max()), y=abs(scene.placement.y), tilt=scene.placement.tilt)
        return cls(draw, protocol, number, EquivalentInclusion().prepared(scene.model_copy(update={"placement": far}), ACCURACY))

    @property
    def members(self) -> Ints:
        """Numbers of the tumours in this tissue, shape (k,)."""
        return self.draw.of_tissue(self.number)

    def distinct(self) -> tuple[Ints, Floats, Ints]:
        """Return tumours and distances of what differs, shape (u,), and where each position is among it, shape (k, p)."""
        along, across = self._along, self.draw.beside
        offset = np.round(np.hypot(along, across), 12)
        pairs = np.stack([np.repeat(self.members, along.shape[1]), offset.ravel()], axis=1)
        rows, where = np.unique(pairs, axis=0, return_inverse=True)
        return rows[:, 0].astype(int), rows[:, 1], where.reshape(along.shape)

    def tumours(self, which: Ints, offset: Floats) -> Tumours:
        """Return tumours at distances from the probe, shape (u, 1)."""
        draw = self.draw
        columns = (offset, 0.0, draw.depth[which], draw.diameter[which], draw.youngs_modulus[which], draw.poisson_ratio)
        return Tumours(*(np.asarray(one)[..., None] for one in columns))

    @property
    def _along(self) -> Floats:
        return np.asarray(self.draw.x[self.members, None] - self.protocol.places)

    def answered(self, tumours: Tumours, tolerance: Floats) -> tuple[Readings, Readings]:
        """Return readings to first order, and those in which no reflection is left out that matters.

        That is one that may change a signal by more than ``tolerance``, shape (c,). Beyond so many as there is time for, those
        that may change most are made; what is left out counts in ``errors``.
        """
        first = readings(self.base, tumours, 0, True, reflect=False)
        answers = deepcopy(first)
        own = np.maximum(answers.bound - self.base.films.bound.totals, 0.0)
        left_out = np.stack([(own / np.abs(answers.totals)).sum(axis=1), own.sum(axis=1) / answers.stiffness], axis=1)
        worst = (left_out[:, : len(tolerance)] / tolerance).max(axis=1)
        most = (MOST_LAYERED if self.base.strata.interfaces else MOST) // len(self.draw.tissues)
        chosen = np.sort(np.array([k for k in np.argsort(-worst)[:most].tolist() if worst[k] > 1], dtype=int))
        if not len(chosen):
            return first, first
        better = readings(self.base, tumours.of_index(chosen), 0, True, reflect=True)
        for one in fields(answers):
            if one.name not in ("areas", "by"):
                getattr(answers, one.name)[chosen] = getattr(better, one.name)
        for key, slopes in answers.by.items():
            slopes[chosen] = better.by[key]
        return first, answers

    def errors(self, answers: Readings) -> Floats:
        """Bounds on what the logarithms of both totals are off beyond what they are without the tumour, shape (u, 2)."""
        films, totals = self.base.films, np.abs(answers.totals)
        own = np.maximum(answers.bound - films.bound.totals, 0.0) / totals
        effect = np.abs(answers.totals - films.totals) / totals
        return np.asarray(-np.log1p(-np.minimum(own + CHANGES * films.relative_errors * effect, 0.999999)))

    def slopes(self, answers: Readings, where: Ints, name: str) -> Floats:
        """Derivatives of the signals by a number of the tumours, shape (k, m)."""
        by = answers.by[OF_TARGET[name]].sum(axis=2)
        parts = [by[:, 0] / answers.totals[:, 0] - by[:, 1] / answers.totals[:, 1], by.sum(axis=1) / answers.stiffness]
        if name == "x":
            toward = self._along / np.maximum(np.hypot(self._along, self.draw.beside), 1e-300)
            return np.concatenate([part[where] * toward for part in parts[: self.protocol.channels]], axis=1)
        return np.concatenate([part[where] for part in parts[: self.protocol.channels]], axis=1)

    def by_tissue(self, tumours: Tumours, where: Ints, name: str) -> tuple[Floats, Floats]:
        """Derivatives by a number of the tissue, of the signals (k, m) and of what is read without tumours (c,)."""
        scene, key = self.base.scene, scene_key(name)
        size, sides = values(scene)[key], []
        for step in (STEP, -STEP):
            base = in_other_tissue(self.base, ScenePopulation.varied(scene, {name: size * math.exp(step)}))
            totals = readings(base, tumours, 0, reflect=False).totals
            sides.append((self._logs(totals[where]), self._logs(base.films.totals[None])))
        whole, blank = ((above - below) / (2 * STEP) for above, below in zip(*sides, strict=True))
        return whole - np.repeat(blank, len(self.protocol.positions)), blank

    def _logs(self, totals: Floats) -> Floats:
        return np.asarray(logarithms(totals, self.protocol.stiffness))


def inclusion_readings(
    draw: TumourDraw,
    protocol: Protocol,
    names: tuple[str, ...] = (),
    *,
    noise: NoiseModel,
    progress: Progress | None = None,
) -> ScanReadings:
    """Return readings over a population, see ``ScanReadings``.

    Args:
        draw: the tumours.
        protocol: the readings; the probe has to stay on the tissue.
        names: of ``ScenePopulation.ranges``, by which derivatives are wanted.
        noise: of a reading, of which reflections that may change it by less than ``SHARE`` are left out.
        progress: called with tissues done and all.

    Raises:
        InputError: the probe would leave the tissue.
        Refusal: the level cannot take the scene, or nothing is known of its load in linear elasticity.
    """
    ScanLine(draw.scene, "x", draw.scene.placement.y, ACCURACY).check(protocol.places)
    n, c, t = len(draw), protocol.channels, len(draw.tissues)
    m = c * len(protocol.positions)
    found = ScanReadings(
        np.zeros((n, m)), np.zeros((n, m)), draw.tissue, np.zeros((t, 2)), np.zeros((m // c, 2)), np.zeros((t, c)),
        {name: np.zeros((n, m)) for name in names}, {name: np.zeros((t, c)) for name in names if not is_of_tumour(name)},
    )  # fmt: skip
    for number in range(t):
        _fill(found, InclusionScan.of(draw, protocol, number), noise)
        if progress is not None:
            progress(number + 1, t)
    found.over[:] = np.exp(found.over / n)
    return found


def _fill(found: ScanReadings, scan: InclusionScan, noise: NoiseModel) -> None:
    """Put the readings of one tissue where they belong."""
    which, offset, where = scan.distinct()
    tumours, rows, number = scan.tumours(which, offset), scan.members, scan.number
    films, scene = scan.base.films, scan.draw.tissues[number]
    check_pressed(films.totals, scene)
    first, answers = scan.answered(tumours, SHARE * reading_deviations(noise, scan.protocol, scene, films.totals))
    check_pressed(answers.totals, scene)
    blank = scan._logs(films.totals[None])
    found.over[:] += np.log(answers.totals[where]).sum(axis=0)  # of the logarithms; ``inclusion_readings`` takes their mean
    found.signal[rows] = scan._logs(answers.totals[where]) - np.repeat(blank, len(scan.protocol.positions))
    errors = scan.errors(answers)
    stated = np.stack([errors.sum(axis=1), errors.max(axis=1)], axis=1)[:, : found.channels]
    found.error[rows] = np.concatenate([stated[where, k] for k in range(found.channels)], axis=1)
    by_load = np.tile(_by_load(scene, answers)[where], (1, found.channels))
    found.error[rows] += by_load * np.abs(found.signal[rows])
    found.blank[number] = films.totals
    found.blank_error[number] = [films.bound.log_ratio, films.relative_errors.max()][: found.channels]
    added = scan.slopes(answers, where, "object") - scan.slopes(first, where, "object")
    for name in found.by:
        if is_of_tumour(name):
            found.by[name][rows] = scan.slopes(answers, where, name)
        else:
            found.by[name][rows], found.blank_by[name][number] = scan.by_tissue(tumours, where, name)
            hosted = np.array([host_modulus(scan.draw, one) == name for one in rows.tolist()])
            found.by[name][rows] -= hosted[:, None] * added


def check_pressed(totals: Floats, scene: Scene) -> None:
    """Refuse forces on films, shape (..., 2), of which one is pulled on: their ratio is negative and has no logarithm.

    Raises:
        Refusal: there is one, as under a stiff skin that bends beside the block which carries most.
    """
    if np.all(totals > 0):
        return
    film = "inner" if np.any(totals[..., 0] <= 0) else "outer"
    moduli = " and ".join(f"{one.youngs_modulus / 1e3:.4g} kPa" for one in (scene.probe.inner, scene.probe.outer))
    other = f"blocks of other areas, or of moduli, now {moduli}, that lie closer together"
    raise Refusal("probe", Words(f"the {film} film is pulled on"), other)


def _by_load(scene: Scene, answers: Readings) -> Floats:
    """Bound on what the load changes of each signal, relative, shape (u,): as of the log-sensitivity, both being a tumour's.

    Raises:
        Refusal: nothing is known of it.
    """
    rule = load_rule(scene)
    changes = LoadChanges.of(scene, rule, answers.stiffness)
    if not changes.known.all():
        check_load(scene, changes.weakest, LARGEST_CHANGE, False)
        raise Refusal("load", "too large", "a load of which linear elasticity knows what it leaves out")
    return changes.log_sensitivity
