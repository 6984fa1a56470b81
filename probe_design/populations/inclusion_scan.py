"""Compute a population's readings with equivalent-inclusion, including reflections from surface, blocks and bottom.

The probe is solved once on each tissue. All tumours are computed to first order at once. As many as time allows are computed
again with reflections: the first of each tissue, which are as good a sample as all, and the same ones if more are drawn.
Derivatives with respect to the tissue's numbers are differences of first-order results on one mesh that moves with them.
A signal s does not change if all moduli change by the same factor, neither to first order nor with reflections. The changes by
reflections in the derivatives with respect to all moduli therefore sum to 0. Those of blocks and other layers, already part of
the first order, are neglected. With E_host the modulus of the tissue around the tumour and E_object that of the tumour,

    ds/d ln E_host = first order - (ds/d ln E_object - first order of that)                           (PO.9)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Placement
from geometry.scenes.variables import list_values
from probe_design.maps.scan_line import ScanLine
from probe_design.populations.film_totals import check_charge_signs, check_films_compressed, stack_totals
from probe_design.populations.noise import compute_reading_deviations
from probe_design.populations.population import ScenePopulation, TumourDraw, get_scene_key, is_of_tumour, name_host_modulus
from probe_design.populations.scan_errors import ERROR_CAUSES, LOAD_CAUSE, bound_film_errors
from probe_design.populations.scan_readings import ScanReadings, compute_logarithms
from probe_design.populations.tables import NoiseModel, Protocol
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_other_tissue
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import LoadChanges, check_load
from solver.planning.load_limits import build_load_rule

Progress = Callable[[int, int], None]
BASE_ACCURACY = 0.01  # relative, of the probe without tumours: in a signal only this fraction of the signal remains
NEGLECTED_CHANGE_PER_NOISE = (
    0.03  # of a reading's noise: reflections with smaller bounds are neglected, and counted in the errors
)
MAX_REFLECTED_READINGS, MAX_LAYERED_REFLECTED_READINGS = (
    400,
    160,
)  # tumours with reflections, on one material and on layers: about 10 and 50 ms each
MIN_REFLECTED = 16  # minimum of tumours with reflections for any number of positions, as they are a sample
LOG_DIFFERENCE_STEP = 0.002  # step of the logarithms of the tissue's numbers
MAX_LOAD_CHANGE_RELATIVE = 0.5  # relative change of the ratio by the load; loads far beyond it are refused anyway
TARGET_KEYS = {"depth": "depth", "diameter": "diameter", "object": "youngs_modulus", "x": "offset"}


@dataclass(frozen=True)
class InclusionScan:
    """One tissue with its tumours under a protocol.

    Attributes
    ----------
    draw, protocol
        The tumours and the readings.
    number
        Number of the tissue.
    base
        The probe on the tissue without tumours.
    """

    draw: TumourDraw
    protocol: Protocol
    number: int
    base: Undisturbed

    @classmethod
    def from_draw(cls, draw: TumourDraw, protocol: Protocol, number: int) -> InclusionScan:
        """Solve the probe on one tissue; its error bounds are those of the position farthest from the tissue's middle.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene.
        """
        scene = draw.tissues[number]
        farthest_placement = Placement(
            x=float(np.abs(protocol.places).max()), y=abs(scene.placement.y), tilt=scene.placement.tilt
        )
        return cls(
            draw,
            protocol,
            number,
            EquivalentInclusion().prepare(scene.model_copy(update={"placement": farthest_placement}), BASE_ACCURACY),
        )

    @property
    def members(self) -> Ints:
        """Numbers of the tumours in this tissue, shape (k,)."""
        return self.draw.find_members(self.number)

    def list_distinct(self) -> tuple[Ints, Floats, Ints]:
        """List the distinct pairs of a tumour and its lateral distance from the probe, so that each is computed only once.

        Returns
        -------
        tuple[Ints, Floats, Ints]
            Of u pairs the index of the tumour in ``draw`` and the distance, m, shape (u,) each; and for each of k tumours in
            this tissue at each of p positions the index of its pair, shape (k, p).
        """
        x_distances, lateral_offset = self._x_distances, self.draw.lateral_offset
        offset = np.round(np.hypot(x_distances, lateral_offset), 12)
        pairs = np.stack([np.repeat(self.members, x_distances.shape[1]), offset.ravel()], axis=1)
        # np.round above: equal distances on both sides of a tumour may differ in the last digits
        rows, indices = np.unique(pairs, axis=0, return_inverse=True)
        return rows[:, 0].astype(int), rows[:, 1], indices.reshape(x_distances.shape)

    def build_tumours(self, which: Ints, offset: Floats) -> Tumours:
        """Return the tumours with u indices in ``draw`` at lateral distances ``offset`` from the probe, m; fields (u, 1)."""
        draw = self.draw
        columns = (offset, 0.0, draw.depth[which], draw.diameter[which], draw.youngs_modulus[which], draw.poisson_ratio)
        return Tumours(*(np.asarray(column)[..., None] for column in columns))

    @property
    def _x_distances(self) -> Floats:
        """The x of each tumour in this tissue less that of the probe at each position, m, shape (k, p)."""
        return np.asarray(self.draw.x[self.members, None] - self.protocol.places)

    def compute_readings(self, tumours: Tumours, tolerance: Floats, allowed: Bools) -> tuple[Readings, Readings]:
        """Return readings to first order, and those of the allowed tumours with reflections where these matter.

        Reflections are the fields of a tumour that surface, blocks and bottom send back to it.

        Parameters
        ----------
        tumours
            The tumours at their distances from the probe, shape (u, 1).
        tolerance
            Change of ln ratio and of ln stiffness up to which reflections are neglected, shape (2,).
        allowed
            Which tumours may have reflections computed, shape (u,).
        """
        first = compute_readings(self.base, tumours, 0, True, reflect=False)
        best = deepcopy(first)
        # error bounds of both films' forces due to the tumour alone: those of the probe without it are subtracted
        read, films = best.get_observable(self.base.scene), self.base.films.get_observable(self.base.scene)
        ratio_changes = np.maximum(read.bound - films.bound.totals, 0.0) / np.abs(read.totals)
        force_changes = np.maximum(best.bound - self.base.films.bound.totals, 0.0)
        neglected_changes = np.stack([ratio_changes.sum(axis=1), force_changes.sum(axis=1) / best.stiffness], axis=1)
        chosen = np.flatnonzero(allowed & np.any(neglected_changes > tolerance, axis=1))
        if not len(chosen):
            return first, first
        reflected_readings = compute_readings(self.base, tumours.select(chosen), 0, True, reflect=True)
        best.store(chosen, reflected_readings)
        return first, best

    def compute_tumour_derivatives(self, readings: Readings, indices: Ints, name: str) -> Floats:
        """Return the derivatives of the signals with respect to a number of the tumours.

        Parameters
        ----------
        readings
            Readings at u distinct pairs of a tumour and a distance.
        indices
            Index of the pair for each tumour and position, shape (k, p), see ``list_distinct``.
        name
            One of ``TARGET_KEYS``.

        Returns
        -------
        Floats
            Derivatives of the m signals of k tumours, shape (k, m).
        """
        read = readings.get_observable(self.base.scene)
        film_derivatives, read_derivatives = (part.derivatives[TARGET_KEYS[name]].sum(axis=2) for part in (readings, read))
        channel_derivatives = [
            read_derivatives[:, 0] / read.totals[:, 0] - read_derivatives[:, 1] / read.totals[:, 1],
            film_derivatives.sum(axis=1) / readings.stiffness,
        ]
        # ln ratio, then ln stiffness; with only one channel read, the slices below keep ln ratio
        if name == "x":  # the readings know only the distance: chain rule, with 0 in place of 0 / 0 on the axis
            d_offset_by_x = self._x_distances / np.maximum(np.hypot(self._x_distances, self.draw.lateral_offset), 1e-300)
            return np.concatenate(
                [part[indices] * d_offset_by_x for part in channel_derivatives[: self.protocol.channels]], axis=1
            )
        return np.concatenate([part[indices] for part in channel_derivatives[: self.protocol.channels]], axis=1)

    def select_reflected(self, count: int) -> Ints:
        """Return the indices of the tumours in this tissue whose reflections are computed, a sample of them: the first ones.

        Each tissue has an equal part of ``count``, the number over all tissues, but at least its part of ``MIN_REFLECTED``; all
        its tumours if these are fewer.
        """
        tissue_count = len(self.draw.tissues)
        minimum = math.ceil(MIN_REFLECTED / tissue_count)
        return self.members[: max(minimum, count // tissue_count)]  # a slice beyond the end holds all

    def compute_tissue_derivatives(self, tumours: Tumours, indices: Ints, name: str) -> tuple[Floats, Floats]:
        """Return derivatives with respect to the logarithm of a number of the tissue, by central differences to first order.

        The tumours are at their distances from the probe, (u, 1), ``indices`` those of ``list_distinct``; the name is one of
        ``ScenePopulation.ranges``. The derivatives are those of the signals, (k, m), and of readings without tumours, (c,).
        """
        scene, key = self.base.scene, get_scene_key(name)
        start_value, step_results = list_values(scene)[key], []
        for step in (LOG_DIFFERENCE_STEP, -LOG_DIFFERENCE_STEP):
            base = solve_other_tissue(
                self.base, ScenePopulation.replace_tissue_numbers(scene, {name: start_value * math.exp(step)})
            )
            totals = stack_totals(scene, compute_readings(base, tumours, 0, reflect=False))
            blank = stack_totals(scene, base.films)[None]
            step_results.append((self._take_logarithms(totals[indices]), self._take_logarithms(blank)))
        derivatives, blank_slopes = (
            (upper - lower) / (2 * LOG_DIFFERENCE_STEP) for upper, lower in zip(*step_results, strict=True)
        )
        return derivatives - np.repeat(blank_slopes, len(self.protocol.positions)), blank_slopes

    def _take_logarithms(self, totals: Floats) -> Floats:
        """Return ln ratio and, if it is read, ln stiffness of totals, shape (..., p, 2 or 4): shape (..., m)."""
        return np.asarray(compute_logarithms(totals, self.protocol.stiffness))


@dataclass(frozen=True)
class InclusionReadings:
    """Readings over n tumours, of which r have reflections.

    Attributes
    ----------
    best
        Readings of all tumours, with reflections where they are computed.
    first
        Readings of all tumours to first order.
    reflected
        Numbers of the tumours with reflections, shape (r,), tissue by tissue.
    """

    best: ScanReadings
    first: ScanReadings
    reflected: Ints


def compute_inclusion_readings(
    draw: TumourDraw,
    protocol: Protocol,
    names: tuple[str, ...] = (),
    *,
    noise: NoiseModel,
    progress: Progress | None = None,
) -> InclusionReadings:
    """Return readings over a population, see ``ScanReadings``.

    Parameters
    ----------
    draw
        The tumours.
    protocol
        The readings; the probe has to stay on the tissue.
    names
        Names of ``ScenePopulation.ranges`` with respect to which derivatives are computed.
    noise
        Noise of a reading; reflections that change it by less than ``NEGLECTED_CHANGE_PER_NOISE`` are neglected.
    progress
        Called with the number of tissues done and the number of all.

    Raises
    ------
    InputError
        The probe would leave the tissue.
    Refusal
        The evaluator cannot model the scene, or linear elasticity has no error bound at its load.
    """
    ScanLine(draw.scene, "x", draw.scene.placement.y, BASE_ACCURACY).check_positions(protocol.places)
    best, first = (_create_empty_readings(draw, protocol, names) for _ in range(2))
    allowed = (MAX_LAYERED_REFLECTED_READINGS if draw.scene.tissue.layer else MAX_REFLECTED_READINGS) // len(protocol.positions)
    reflected, tissue_count = [], len(draw.tissues)
    for number in range(tissue_count):
        scan = InclusionScan.from_draw(draw, protocol, number)
        reflected.append(scan.select_reflected(allowed))
        _fill_tissue(best, first, scan, noise, reflected[-1])
        if progress is not None:
            progress(number + 1, tissue_count)
    for scan_readings in (best, first):  # ``_write_signals`` has summed the logarithms of the forces over the tumours
        scan_readings.mean_forces[:] = np.exp(scan_readings.mean_forces / len(draw))
    return InclusionReadings(best, first, np.concatenate(reflected))


def _create_empty_readings(draw: TumourDraw, protocol: Protocol, names: tuple[str, ...]) -> ScanReadings:
    """Return readings filled with zeros, of n tumours in t tissues from p positions in c channels."""
    n, c, tissue_count, p = len(draw), protocol.channels, len(draw.tissues), len(protocol.positions)
    totals = 4 if draw.scene.observable == "charge" else 2
    return ScanReadings(
        np.zeros((n, p * c)), {cause: np.zeros((n, p * c)) for cause in ERROR_CAUSES}, draw.tissue,
        np.zeros((tissue_count, totals)), np.zeros((p, totals)), np.zeros((tissue_count, c)),
        {name: np.zeros((n, p * c)) for name in names},
        {name: np.zeros((tissue_count, c)) for name in names if not is_of_tumour(name)},
    )  # fmt: skip


def _fill_tissue(best: ScanReadings, first: ScanReadings, scan: InclusionScan, noise: NoiseModel, reflected: Ints) -> None:
    """Compute the readings of one tissue and write them into the arrays of all tumours.

    ``best`` has the readings with reflections, ``first`` those to first order; ``reflected`` are the indices of the tumours
    whose reflections are computed, unless they are far below the noise.
    """
    which, offset, indices = scan.list_distinct()
    tumours, number = scan.build_tumours(which, offset), scan.number
    films, scene = scan.base.films, scan.draw.tissues[number]
    check_films_compressed(films.totals, scene)
    blank_totals = stack_totals(scene, films)
    tolerance = NEGLECTED_CHANGE_PER_NOISE * compute_reading_deviations(noise, scan.protocol, scene, blank_totals)
    first_and_best = scan.compute_readings(tumours, tolerance, np.isin(which, reflected))
    reflection_change = scan.compute_tumour_derivatives(first_and_best[1], indices, "object") - scan.compute_tumour_derivatives(
        first_and_best[0], indices, "object"
    )
    tissue_derivatives = {
        name: scan.compute_tissue_derivatives(tumours, indices, name) for name in best.derivatives if not is_of_tumour(name)
    }
    for target, readings in ((first, first_and_best[0]), (best, first_and_best[1])):
        check_films_compressed(readings.totals, scene)
        check_charge_signs(blank_totals, stack_totals(scene, readings))
        _write_signals(target, scan, readings, indices, scene)
        # eq. PO.9: what reflections add to d/d ln E_object, they take from d/d ln E_host
        for name, (derivatives, blank) in tissue_derivatives.items():
            is_host = np.array([name_host_modulus(scan.draw, member) == name for member in scan.members.tolist()])
            target.derivatives[name][scan.members] = derivatives - (
                is_host[:, None] * reflection_change if target is best else 0.0
            )
            target.blank_derivatives[name][number] = blank


def _write_signals(target: ScanReadings, scan: InclusionScan, readings: Readings, indices: Ints, scene: Scene) -> None:
    """Write the signals of one tissue, their errors and their derivatives by the tumours' numbers into the common arrays.

    Parameters
    ----------
    target
        Readings of all tumours; the rows of this tissue's tumours are filled, and its forces added to the means.
    scan
        The tissue with its tumours.
    readings
        Readings at u distinct pairs of a tumour and a distance.
    indices
        Index of the pair for each tumour and position, shape (k, p).
    scene
        The scene with this tissue, without tumours.
    """
    films, rows, number, channels = scan.base.films, scan.members, scan.number, range(target.channels)
    blank_totals, totals = stack_totals(scene, films), stack_totals(scene, readings)
    blank = scan._take_logarithms(blank_totals[None])
    # of logarithms; ``compute_inclusion_readings`` takes the mean
    target.mean_forces[:] += np.log(np.abs(totals[indices])).sum(axis=0)
    target.signal[rows] = scan._take_logarithms(totals[indices]) - np.repeat(blank, len(scan.protocol.positions))
    read = films.get_observable(scene)
    ratio_errors = bound_film_errors(scan.base, read, readings.get_observable(scene))
    for cause, errors in bound_film_errors(scan.base, films, readings).items():
        # ln ratio errs by at most the sum of both films' errors, ln stiffness by at most the larger of the forces'
        stated = np.stack([ratio_errors[cause].sum(axis=1), errors.max(axis=1)], axis=1)
        target.errors[cause][rows] = np.concatenate([stated[indices, k] for k in channels], axis=1)
    load_changes = np.tile(_bound_load_change(scene, readings)[indices], (1, target.channels))
    target.errors[LOAD_CAUSE][rows] = load_changes * np.abs(target.signal[rows])
    target.blank[number] = np.abs(blank_totals)
    target.blank_error[number] = [read.bound.log_ratio, films.relative_errors.max()][: target.channels]
    for name in target.derivatives:
        if is_of_tumour(name):
            target.derivatives[name][rows] = scan.compute_tumour_derivatives(readings, indices, name)


def _bound_load_change(scene: Scene, readings: Readings) -> Floats:
    """Return a bound on the relative change of each signal by finite strain under the load: that of the log-sensitivity, (u,).

    Raises
    ------
    Refusal
        No bound is available.
    """
    rule = build_load_rule(scene)
    changes = LoadChanges.from_stiffness(scene, rule, readings.stiffness)
    if not changes.is_known.all():
        check_load(scene, changes.weakest, MAX_LOAD_CHANGE_RELATIVE, False)
        raise Refusal("load", "too large", "a load of which linear elasticity knows what it leaves out")
    return changes.log_sensitivity
