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

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from probe_design.maps.scan_line import ScanLine
from probe_design.populations.film_totals import check_charge_signs, check_films_compressed, stack_totals
from probe_design.populations.loaded_scan import LoadedChange, PressedScan
from probe_design.populations.noise import compute_reading_deviations
from probe_design.populations.population import TumourDraw, is_of_tumour, name_host_modulus
from probe_design.populations.scan_errors import ERROR_CAUSES, LOAD_CAUSE, bound_film_errors
from probe_design.populations.scan_readings import ScanReadings
from probe_design.populations.tables import NoiseModel, Protocol
from probe_design.populations.tissue_scan import BASE_ACCURACY, InclusionScan
from solver.contact.pressed_tissue import PressedTissue
from solver.equivalent_inclusion.readings import Readings
from solver.planning.load_check import LoadChanges, check_load
from solver.planning.load_limits import build_load_rule

Progress = Callable[[int, int], None]
NEGLECTED_CHANGE_PER_NOISE = (
    0.03  # of a reading's noise: reflections with smaller bounds are neglected, and counted in the errors
)
MAX_REFLECTED_READINGS, MAX_LAYERED_REFLECTED_READINGS = (
    400,
    160,
)  # tumours with reflections, on one material and on layers: about 10 and 50 ms each
MAX_LOAD_CHANGE_RELATIVE = 0.5  # relative change of the ratio by the load; loads far beyond it are refused anyway


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
    pressed: tuple[PressedTissue, ...] = (),
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
    pressed
        Each tissue under a load beyond linear elasticity, whose changes of the signals are added; none: the load is small.
    progress
        Called with the number of tissues done and the number of all.

    Raises
    ------
    InputError
        The probe would leave the tissue.
    Refusal
        The evaluator cannot model the scene, or linear elasticity has no error bound at its load.
    """
    farthest = float(np.abs(protocol.list_places(draw.scene.placement.y)[:, 1]).max())
    ScanLine(draw.scene, "x", farthest, BASE_ACCURACY).check_positions(protocol.places)
    best, first = (_create_empty_readings(draw, protocol, names) for _ in range(2))
    allowed = (MAX_LAYERED_REFLECTED_READINGS if draw.scene.tissue.layer else MAX_REFLECTED_READINGS) // protocol.count
    reflected, tissue_count = [], len(draw.tissues)
    for number in range(tissue_count):
        scan = InclusionScan.from_draw(draw, protocol, number)
        reflected.append(scan.select_reflected(allowed))
        _fill_tissue(best, first, scan, noise, reflected[-1], pressed=pressed[number] if pressed else None)
        if progress is not None:
            progress(number + 1, tissue_count)
    for scan_readings in (best, first):  # ``_write_signals`` has summed the logarithms of the forces over the tumours
        scan_readings.mean_forces[:] = np.exp(scan_readings.mean_forces / len(draw))
    return InclusionReadings(best, first, np.concatenate(reflected))


def _create_empty_readings(draw: TumourDraw, protocol: Protocol, names: tuple[str, ...]) -> ScanReadings:
    """Return readings filled with zeros, of n tumours in t tissues from p positions in c channels."""
    n, c, tissue_count, p = len(draw), protocol.channels, len(draw.tissues), protocol.count
    totals = 4 if draw.scene.observable == "charge" else 2
    return ScanReadings(
        np.zeros((n, p * c)), {cause: np.zeros((n, p * c)) for cause in ERROR_CAUSES}, draw.tissue,
        np.zeros((tissue_count, totals)), np.zeros((p, totals)), np.zeros((tissue_count, c)),
        {name: np.zeros((n, p * c)) for name in names},
        {name: np.zeros((tissue_count, c)) for name in names if not is_of_tumour(name)},
    )  # fmt: skip


def _fill_tissue(
    best: ScanReadings,
    first: ScanReadings,
    scan: InclusionScan,
    noise: NoiseModel,
    reflected: Ints,
    *,
    pressed: PressedTissue | None,
) -> None:
    """Compute the readings of one tissue and write them into the arrays of all tumours.

    ``best`` has the readings with reflections, ``first`` those to first order; ``reflected`` are the indices of the tumours
    whose reflections are computed, unless they are far below the noise; ``pressed`` is the tissue under its load, see
    ``compute_inclusion_readings``.
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
    names = tuple(best.derivatives)
    loaded = None if pressed is None else PressedScan.from_tumours(replace(pressed, base=scan.base), tumours, names)
    for target, readings in ((first, first_and_best[0]), (best, first_and_best[1])):
        check_films_compressed(readings.totals, scene)
        check_charge_signs(blank_totals, stack_totals(scene, readings))
        change = None if loaded is None else loaded.compute_change(readings)
        _write_signals(target, scan, readings, indices, scene, change=change)
        if pressed is not None:
            _write_loaded_baseline(target, scan, pressed, indices)
        # eq. PO.15
        load_change = 0.0 if change is None else scan.join_channels((-change.signal - change.derivatives["object"])[indices])
        # eq. PO.9: what reflections add to d/d ln E_object, they take from d/d ln E_host
        for name, (derivatives, blank) in tissue_derivatives.items():
            is_host = np.array([name_host_modulus(scan.draw, member) == name for member in scan.members.tolist()])
            target.derivatives[name][scan.members] = (
                derivatives - (is_host[:, None] * reflection_change if target is best else 0.0) + is_host[:, None] * load_change
            )
            target.blank_derivatives[name][number] = blank


def _write_signals(
    target: ScanReadings, scan: InclusionScan, readings: Readings, indices: Ints, scene: Scene, *, change: LoadedChange | None
) -> None:
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
    change
        What the load adds at the u pairs; None: the load is small.
    """
    films, rows, number, channels = scan.base.films, scan.members, scan.number, range(target.channels)
    blank_totals, totals = stack_totals(scene, films), stack_totals(scene, readings)
    blank = scan.take_logarithms(blank_totals[None])
    # of logarithms; ``compute_inclusion_readings`` takes the mean
    target.mean_forces[:] += np.log(np.abs(totals[indices])).sum(axis=0)
    target.signal[rows] = scan.take_logarithms(totals[indices]) - np.repeat(blank, scan.protocol.count)
    read = films.get_observable(scene)
    ratio_errors = bound_film_errors(scan.base, read, readings.get_observable(scene))
    for cause, errors in bound_film_errors(scan.base, films, readings).items():
        # ln ratio errs by at most the sum of both films' errors, ln stiffness by at most the larger of the forces'
        stated = np.stack([ratio_errors[cause].sum(axis=1), errors.max(axis=1)], axis=1)
        target.errors[cause][rows] = np.concatenate([stated[indices, k] for k in channels], axis=1)
    if change is None:
        load_changes = np.tile(_bound_load_change(scene, readings)[indices], (1, target.channels))
        target.errors[LOAD_CAUSE][rows] = load_changes * np.abs(target.signal[rows])
    else:
        target.errors[LOAD_CAUSE][rows] = scan.join_channels(change.error[indices])
        target.signal[rows] += scan.join_channels(change.signal[indices])
    target.blank[number] = np.abs(blank_totals)
    target.blank_error[number] = [read.bound.log_ratio, films.relative_errors.max()][: target.channels]
    for name in target.derivatives:
        if is_of_tumour(name):
            target.derivatives[name][rows] = scan.compute_tumour_derivatives(readings, indices, name)
            if change is not None:
                target.derivatives[name][rows] += scan.read_change_derivatives(change, indices, name)


def _write_loaded_baseline(target: ScanReadings, scan: InclusionScan, pressed: PressedTissue, indices: Ints) -> None:
    """Write the totals without tumours under the load, and their errors, in place of the linear ones."""
    films, scene, number = pressed.bare.films, scan.base.scene, scan.number
    totals = np.abs(stack_totals(scene, films))
    # charges over tumours, of which the noise depends, grow as those without them do
    target.mean_forces[:] += len(indices) * np.log(totals / target.blank[number])
    target.blank[number] = totals
    read = films.get_observable(scene)
    target.blank_error[number] = [read.bound.log_ratio, films.relative_errors.max()][: target.channels]


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
