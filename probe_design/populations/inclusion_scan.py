"""Readings over a population by equivalent-inclusion, with what surface, blocks and floor send back, to verify designs by.

The probe is solved once on each tissue. All tumours are computed to first order at once, and as many of them as there is time
for once more with reflections: the first of each tissue, so that they are as good a sample as all of them, and the same ones
where more are drawn. Derivatives by the tissue's numbers are differences of the first order on one mesh that moves with them.
Signals s do not change where all moduli grow alike, in either result, so that what reflections add to all slopes by them is 0
together; blocks and other layers, which meet in the first order already, have hardly any of it:

    ds/d ln E_host = first order - (ds/d ln E_object - first order of that)                           (PO.9)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, fields

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Placement, Scene
from geometry.scenes.variables import values
from probe_design.maps.scan_line import ScanLine
from probe_design.populations.noise import reading_deviations
from probe_design.populations.population import ScenePopulation, TumourDraw, host_modulus, is_of_tumour, scene_key
from probe_design.populations.readings import ScanReadings, logarithms
from probe_design.populations.scan_errors import CAUSES, LOAD, film_errors
from probe_design.populations.tables import NoiseModel, Protocol
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, in_other_tissue
from solver.equivalent_inclusion.readings import Readings, readings
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import LoadChanges, check_load
from solver.planning.load_limits import load_rule

Progress = Callable[[int, int], None]
ACCURACY = 0.01  # of the probe without tumours: it cancels in what tumours change, but for its share of that
SHARE = 0.03  # of a reading's noise: bounds on what reflections change that are left out, and counted in the errors
READINGS, LAYERED_READINGS = 400, 160  # with reflections, of one material and of layers: some 10 and 50 ms each
MIN_REFLECTED = 16  # tumours with reflections at least, however many positions: their mean is a sample's
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

    def answered(self, tumours: Tumours, tolerance: Floats, within: Bools) -> tuple[Readings, Readings]:
        """Return readings to first order, and those of some tumours in which no reflection is left out that matters.

        That is one that may change a signal by more than ``tolerance``, shape (2,); ``within``: which may be reflected, (u,).
        """
        first = readings(self.base, tumours, 0, True, reflect=False)
        answers = deepcopy(first)
        own = np.maximum(answers.bound - self.base.films.bound.totals, 0.0)
        left_out = np.stack([(own / np.abs(answers.totals)).sum(axis=1), own.sum(axis=1) / answers.stiffness], axis=1)
        chosen = np.flatnonzero(within & np.any(left_out > tolerance, axis=1))
        if not len(chosen):
            return first, first
        better = readings(self.base, tumours.of_index(chosen), 0, True, reflect=True)
        for one in fields(answers):
            if one.name not in ("areas", "by"):
                getattr(answers, one.name)[chosen] = getattr(better, one.name)
        for key, slopes in answers.by.items():
            slopes[chosen] = better.by[key]
        return first, answers

    def slopes(self, answers: Readings, where: Ints, name: str) -> Floats:
        """Derivatives of the signals by a number of the tumours, shape (k, m)."""
        by = answers.by[OF_TARGET[name]].sum(axis=2)
        parts = [by[:, 0] / answers.totals[:, 0] - by[:, 1] / answers.totals[:, 1], by.sum(axis=1) / answers.stiffness]
        if name == "x":
            toward = self._along / np.maximum(np.hypot(self._along, self.draw.beside), 1e-300)
            return np.concatenate([part[where] * toward for part in parts[: self.protocol.channels]], axis=1)
        return np.concatenate([part[where] for part in parts[: self.protocol.channels]], axis=1)

    def reflected(self, count: int) -> Ints:
        """Return the numbers of the tumours in this tissue that get reflections, ``count`` of all tissues' being allowed."""
        t, k = len(self.draw.tissues), len(self.members)
        return self.members[: max(min(k, -(-MIN_REFLECTED // t)), count // t)]

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


@dataclass(frozen=True)
class InclusionReadings:
    """Readings over n tumours, of which r have reflections.

    Attributes:
        best: of each tumour the best that is computed.
        first: to first order, of all.
        reflected: numbers of those with reflections, shape (r,), each tissue's in its order.
    """

    best: ScanReadings
    first: ScanReadings
    reflected: Ints


def inclusion_readings(
    draw: TumourDraw,
    protocol: Protocol,
    names: tuple[str, ...] = (),
    *,
    noise: NoiseModel,
    progress: Progress | None = None,
) -> InclusionReadings:
    """Return readings over a population, see ``ScanReadings``.

    Args:
        draw: the tumours.
        protocol: the readings; the probe has to stay on the tissue.
        names: of ``ScenePopulation.ranges``, by which derivatives are wanted.
        noise: of a reading, of which reflections that may change it by less than ``NEGLECTED_CHANGE_PER_NOISE`` are left out.
        progress: called with tissues done and all.

    Raises:
        InputError: the probe would leave the tissue.
        Refusal: the level cannot take the scene, or nothing is known of its load in linear elasticity.
    """
    ScanLine(draw.scene, "x", draw.scene.placement.y, ACCURACY).check(protocol.places)
    best, first = (_empty(draw, protocol, names) for _ in range(2))
    allowed = (LAYERED_READINGS if draw.scene.tissue.layer else READINGS) // len(protocol.positions)
    reflected, t = [], len(draw.tissues)
    for number in range(t):
        scan = InclusionScan.of(draw, protocol, number)
        reflected.append(scan.reflected(allowed))
        _fill(best, first, scan, noise, reflected[-1])
        if progress is not None:
            progress(number + 1, t)
    for one in (best, first):
        one.over[:] = np.exp(one.over / len(draw))
    return InclusionReadings(best, first, np.concatenate(reflected))


def _empty(draw: TumourDraw, protocol: Protocol, names: tuple[str, ...]) -> ScanReadings:
    n, c, t, p = len(draw), protocol.channels, len(draw.tissues), len(protocol.positions)
    return ScanReadings(
        np.zeros((n, p * c)), {cause: np.zeros((n, p * c)) for cause in CAUSES}, draw.tissue,
        np.zeros((t, 2)), np.zeros((p, 2)), np.zeros((t, c)),
        {name: np.zeros((n, p * c)) for name in names}, {name: np.zeros((t, c)) for name in names if not is_of_tumour(name)},
    )  # fmt: skip


def _fill(best: ScanReadings, first: ScanReadings, scan: InclusionScan, noise: NoiseModel, reflected: Ints) -> None:
    """Put the readings of one tissue where they belong."""
    which, offset, where = scan.distinct()
    tumours, number = scan.tumours(which, offset), scan.number
    films, scene = scan.base.films, scan.draw.tissues[number]
    check_pressed(films.totals, scene)
    tolerance = SHARE * reading_deviations(noise, scan.protocol, scene, films.totals)
    both = scan.answered(tumours, tolerance, np.isin(which, reflected))
    added = scan.slopes(both[1], where, "object") - scan.slopes(both[0], where, "object")
    by_tissue = {name: scan.by_tissue(tumours, where, name) for name in best.by if not is_of_tumour(name)}
    for into, answers in ((first, both[0]), (best, both[1])):
        check_pressed(answers.totals, scene)
        _put(into, scan, answers, where, scene)
        for name, (slopes, blank) in by_tissue.items():
            hosted = np.array([host_modulus(scan.draw, one) == name for one in scan.members.tolist()])
            into.by[name][scan.members] = slopes - (hosted[:, None] * added if into is best else 0.0)
            into.blank_by[name][number] = blank


def _put(into: ScanReadings, scan: InclusionScan, answers: Readings, where: Ints, scene: Scene) -> None:
    """Put the signals of one tissue, their errors and their derivatives by the tumours' numbers where they belong."""
    films, rows, number, channels = scan.base.films, scan.members, scan.number, range(into.channels)
    blank = scan._logs(films.totals[None])
    into.over[:] += np.log(answers.totals[where]).sum(axis=0)  # of logarithms; ``compute_inclusion_readings`` takes the mean
    into.signal[rows] = scan._logs(answers.totals[where]) - np.repeat(blank, len(scan.protocol.positions))
    for cause, errors in film_errors(scan.base, answers).items():
        stated = np.stack([errors.sum(axis=1), errors.max(axis=1)], axis=1)
        into.errors[cause][rows] = np.concatenate([stated[where, k] for k in channels], axis=1)
    by_load = np.tile(_by_load(scene, answers)[where], (1, into.channels))
    into.errors[LOAD][rows] = by_load * np.abs(into.signal[rows])
    into.blank[number] = films.totals
    into.blank_error[number] = [films.bound.log_ratio, films.relative_errors.max()][: into.channels]
    for name in into.by:
        if is_of_tumour(name):
            into.by[name][rows] = scan.slopes(answers, where, name)


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
