"""Hold one tissue with its tumours under a protocol, and compute its readings with equivalent-inclusion."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.scenes.scene_tables import Placement
from geometry.scenes.variables import list_values
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.loaded_scan import LoadedChange
from probe_design.populations.population import PLACE_AXES, ScenePopulation, TumourDraw, get_scene_key
from probe_design.populations.scan_readings import compute_logarithms
from probe_design.populations.tables import Protocol
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_other_tissue
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours

BASE_ACCURACY = 0.01  # relative, of the probe without tumours: in a signal only this fraction of the signal remains
MIN_REFLECTED = 16  # minimum of tumours with reflections for any number of positions, as they are a sample
LOG_DIFFERENCE_STEP = 0.002  # step of the logarithms of the tissue's numbers
TARGET_KEYS = {"depth": "depth", "diameter": "diameter", "object": "youngs_modulus", "x": "offset", "y": "offset"}


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
        x, y = np.abs(protocol.list_places(scene.placement.y)).max(axis=0).tolist()
        farthest_placement = Placement(x=x, y=y, tilt=scene.placement.tilt)
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
        offset = np.round(np.linalg.norm(self._distances, axis=-1), 12)
        pairs = np.stack([np.repeat(self.members, offset.shape[1]), offset.ravel()], axis=1)
        # np.round above: equal distances on both sides of a tumour may differ in the last digits
        rows, indices = np.unique(pairs, axis=0, return_inverse=True)
        return rows[:, 0].astype(int), rows[:, 1], indices.reshape(offset.shape)

    def build_tumours(self, which: Ints, offset: Floats) -> Tumours:
        """Return the tumours with u indices in ``draw`` at lateral distances ``offset`` from the probe, m; fields (u, 1)."""
        draw = self.draw
        columns = (offset, 0.0, draw.depth[which], draw.diameter[which], draw.youngs_modulus[which], draw.poisson_ratio)
        return Tumours(*(np.asarray(column)[..., None] for column in columns))

    @property
    def _distances(self) -> Floats:
        """Place of each tumour in this tissue less that of the probe at each position, m, shape (k, p, 2)."""
        return np.asarray(self.draw.compute_distances(self.protocol)[self.members])

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
        return self._join_derivatives(np.stack([part[indices] for part in channel_derivatives], axis=-1), name)

    def read_change_derivatives(self, change: LoadedChange, indices: Ints, name: str) -> Floats:
        """Return the derivatives of what a load adds to the signals by a number of the tumours, shape (k, m)."""
        return self._join_derivatives(change.derivatives["x" if name in PLACE_AXES else name][indices], name)

    def _join_derivatives(self, values: Floats, name: str) -> Floats:
        """Return derivatives of ratio and stiffness, (k, p, 2), as those of the m signals; by x or y if by the distance."""
        if name in PLACE_AXES:  # chain rule, with 0 in place of 0 / 0 on the axis
            distance = np.maximum(np.linalg.norm(self._distances, axis=-1, keepdims=True), 1e-300)
            values = values * self._distances[..., [PLACE_AXES.index(name)]] / distance
        return self.join_channels(values)

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
            step_results.append((self.take_logarithms(totals[indices]), self.take_logarithms(blank)))
        derivatives, blank_slopes = (
            (upper - lower) / (2 * LOG_DIFFERENCE_STEP) for upper, lower in zip(*step_results, strict=True)
        )
        return derivatives - np.repeat(blank_slopes, self.protocol.count), blank_slopes

    def join_channels(self, values: Floats) -> Floats:
        """Return values of ratio and stiffness at each position, (k, p, 2), as those of the m signals that are read, (k, m)."""
        return np.concatenate([values[..., k] for k in range(self.protocol.channels)], axis=-1)

    def take_logarithms(self, totals: Floats) -> Floats:
        """Return ln ratio and, if it is read, ln stiffness of totals, shape (..., p, 2 or 4): shape (..., m)."""
        return np.asarray(compute_logarithms(totals, self.protocol.stiffness))
