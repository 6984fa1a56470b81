"""Compute readings over a population with the closed form, for the many probes of a search.

Everything that does not depend on the probe is prepared once: each pair of a tumour and a position of the probe is a column of
``closed_form.designs.compute_forces``. Each probe then takes one evaluation on arrays, complex where derivatives are requested.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal
from geometry.scenes.scene import Inclusion, Placement, Scene
from probe_design.populations.population import TumourDraw, is_of_tumour
from probe_design.populations.scan_readings import ScanReadings, compute_logarithms
from probe_design.populations.tables import Protocol
from solver.closed_form.designs import (
    LAYER_PARAMETERS,
    PROBE_PARAMETERS,
    SPHERE_PARAMETERS,
    TISSUE_PARAMETERS,
    Shape,
    build_parameters,
    compute_forces,
)
from solver.closed_form.evaluator import ClosedForm

NODE_ROUNDING = 8  # nodes by which groups differ: fewer groups, each a little more exact
MIN_OFFSET_PER_DIAMETER = 1e-6  # of the diameter: smallest lateral offset that counts as off the axis
COMPLEX_STEP_RELATIVE = 1e-30  # of complex steps, relative
FIRST_BALL = len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)


@dataclass(frozen=True)
class Columns:
    """Columns of one structure.

    Attributes
    ----------
    shape
        The structure.
    values
        Parameters, shape (parameters, k).
    tumour
        Number of each column's tumour, or of its tissue where there is none, shape (k,).
    """

    shape: Shape
    values: Floats
    tumour: Ints

    def compute_totals(self, probe: Any, changed: Any = None) -> Any:
        """Return the film forces per unit indentation for probes of shape (PROBE, d), or other values; shape (d, k, 2)."""
        values = self.values if changed is None else changed
        d, k = probe.shape[1], values.shape[1]
        all_values = np.tile(values, (1, d)).astype(np.result_type(values, probe))
        all_values[: len(PROBE_PARAMETERS)] = np.repeat(probe, k, axis=1)
        with np.errstate(all="ignore"):  # the caller refuses values that are not finite
            return compute_forces(self.shape, all_values)[0].sum(axis=2).reshape(d, k, 2)


@dataclass(frozen=True)
class ClosedFormScan:
    """The scans of a population under a protocol, prepared for any probe.

    Attributes
    ----------
    draw
        The tumours.
    protocol
        The readings.
    groups
        Columns of all tumours at all distinct distances from the probe.
    blanks
        Columns of the tissues without tumours.
    place
        Column of each tumour at each position, counted over all groups, shape (n, p).
    """

    draw: TumourDraw
    protocol: Protocol
    groups: tuple[Columns, ...]
    blanks: tuple[Columns, ...]
    place: Ints

    @classmethod
    def from_draw(cls, draw: TumourDraw, protocol: Protocol, radius: float | None = None) -> ClosedFormScan:
        """Prepare a population.

        Parameters
        ----------
        draw
            The tumours.
        protocol
            The readings.
        radius
            Largest outer radius of the probes, m; default: that of the draw's scene.

        Raises
        ------
        Refusal
            The closed form cannot model the scene.
        """
        scenes = [_widen_probe(scene, radius) for scene in draw.tissues]
        for scene in draw.tissues:
            _check_closed_form(scene)
        offset = np.hypot(draw.x[:, None] - protocol.places, draw.lateral_offset)
        grouped: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
        for number in range(len(draw)):
            shape, values = build_parameters(
                _add_tumour(scenes[draw.tissue[number]], draw, number, float(offset[number].max())), merged=False
            )
            grouped[replace(shape, nodes=-(-shape.nodes // NODE_ROUNDING) * NODE_ROUNDING)].append((number, values))
        groups, place, start = [], np.empty(offset.shape, dtype=int), 0
        for shape, members in grouped.items():
            columns, start = _build_columns(shape, members, offset, draw.diameter, place=place, start=start), start
            groups.append(columns)
            start += columns.values.shape[1]
        return cls(draw, protocol, tuple(groups), tuple(_build_baseline_columns(scenes)), place)

    def compute_totals(self, probe: Any) -> tuple[Any, Any]:
        """Return the film forces of d probes per unit indentation, N/m.

        Parameters
        ----------
        probe
            The parameters ``PROBE_PARAMETERS`` of each probe, SI, real or complex, shape (9, d).

        Returns
        -------
        tuple[Any, Any]
            Forces over the tumours, shape (d, n, p, 2), and without them, shape (d, t, 2); not finite where the closed form
            fails.
        """
        all_totals = np.concatenate([group.compute_totals(probe) for group in self.groups], axis=1)
        return all_totals[:, self.place], self._compute_baseline_totals(probe)

    def compute_signals(self, probe: Any) -> tuple[Any, Any]:
        """Return the signals, eq. PO.1, shape (d, n, m), and the forces without tumours, shape (d, t, 2)."""
        return self.convert_totals(*self.compute_totals(probe))

    def convert_totals(self, tumour_totals: Any, blank: Any) -> tuple[Any, Any]:
        """Return ``compute_signals`` from ``compute_totals``."""
        with np.errstate(all="ignore"):
            baseline = np.repeat(self._take_logarithms(blank[:, :, None]), len(self.protocol.positions), axis=-1)
            return self._take_logarithms(tumour_totals) - baseline[:, self.draw.tissue], blank

    def compute_readings(self, scene: Scene, names: tuple[str, ...] = ()) -> ScanReadings:
        """Return readings with one scene's probe, and their derivatives by the names of ``ScenePopulation.ranges``.

        Raises
        ------
        Refusal
            The closed form fails for this probe.
        """
        probe = build_parameters(scene.model_copy(update={"inclusion": ()}))[1][: len(PROBE_PARAMETERS), None]
        totals, blanks = self.compute_totals(probe)
        signal, blank = (array[0] for array in self.convert_totals(totals, blanks))
        if not (np.all(np.isfinite(signal)) and np.all(blank > 0)):
            raise Refusal("evaluator", "closed-form", "equivalent-inclusion, as the formulas break down for this probe")
        derivatives, blank_by, mean_forces = {}, {}, np.exp(np.log(totals[0]).mean(axis=0))
        for name in names:
            derivatives[name], baseline_derivative = self._compute_derivatives(probe, name)
            if not is_of_tumour(name):
                blank_by[name] = baseline_derivative
        c = self.protocol.channels
        return ScanReadings(signal, {}, self.draw.tissue, blank, mean_forces, np.zeros((len(blank), c)), derivatives, blank_by)

    def _compute_derivatives(self, probe: Floats, name: str) -> tuple[Floats, Floats]:
        """Return derivatives of the signals (n, m) and, for a number of the tissue, of the readings without tumours (t, c)."""
        group_totals, slopes = [], np.zeros((len(self.draw.tissues), self.protocol.channels))
        for group in self.groups:
            group_totals.append(group.compute_totals(probe, _add_complex_step(group, name))[0])
        totals = np.concatenate(group_totals)[self.place]
        signal = self._take_logarithms(totals).imag / COMPLEX_STEP_RELATIVE
        if name == "x":
            toward = np.sign(self.draw.x[:, None] - self.protocol.places) * np.abs(self._offset_derivative)
            signal = signal * np.tile(toward, (1, self.protocol.channels))
        if is_of_tumour(name):
            return signal, slopes
        blank = np.concatenate([group.compute_totals(probe, _add_complex_step(group, name))[0] for group in self.blanks])[
            self._order
        ]
        slopes = self._take_logarithms(blank[:, None]).imag / COMPLEX_STEP_RELATIVE
        return signal - np.repeat(slopes[self.draw.tissue], len(self.protocol.positions), axis=1), slopes

    @property
    def _offset_derivative(self) -> Floats:
        """Return the magnitude of the derivative of the offset with respect to x, shape (n, p)."""
        dx = self.draw.x[:, None] - self.protocol.places
        return np.asarray(np.abs(dx) / np.maximum(np.hypot(dx, self.draw.lateral_offset), 1e-300))

    def _compute_baseline_totals(self, probe: Any) -> Any:
        return np.concatenate([group.compute_totals(probe) for group in self.blanks], axis=1)[:, self._order]

    @property
    def _order(self) -> Ints:
        return np.argsort(np.concatenate([group.tumour for group in self.blanks]))

    def _take_logarithms(self, totals: Any) -> Any:
        return compute_logarithms(totals, self.protocol.stiffness)


def _check_closed_form(scene: Scene) -> None:
    reason = ClosedForm().refusal(scene)
    if reason is not None:
        raise Refusal("evaluator", "closed-form", reason)


def _widen_probe(scene: Scene, radius: float | None) -> Scene:
    """Return the scene with a probe of outer radius ``radius``, so that the nodes suffice for it."""
    if radius is None or radius <= scene.probe.tube_radius:
        return scene
    probe = scene.probe.model_copy(update={"outer_radius": radius, "area_ratio": None})
    return scene.model_copy(update={"probe": probe})


def _add_tumour(scene: Scene, draw: TumourDraw, number: int, offset: float) -> Scene:
    """Return the scene with one tumour at a distance from the probe; not validated, as the draw is."""
    body = Inclusion.model_construct(
        diameter=float(draw.diameter[number]), depth=float(draw.depth[number]), x=offset, y=0.0, target=True,
        youngs_modulus=float(draw.youngs_modulus[number]), poisson_ratio=draw.poisson_ratio,
    )  # fmt: skip
    return scene.model_copy(update={"inclusion": (body,), "placement": Placement()})


def _build_columns(
    shape: Shape, members: list[tuple[int, Floats]], offset: Floats, diameter: Floats, *, place: Ints, start: int
) -> Columns:
    """Return the columns of tumours of one structure, each distance once; fill ``place`` with their numbers."""
    values: list[Floats] = []
    numbers: list[int] = []
    for number, parameter_values in members:
        min_offset = 0.0 if shape.on_axis[0] else MIN_OFFSET_PER_DIAMETER * diameter[number]
        distinct, positions = np.unique(np.maximum(offset[number], min_offset), return_inverse=True)
        place[number] = start + len(numbers) + positions
        repeated = np.tile(parameter_values[:, None], (1, len(distinct)))
        repeated[FIRST_BALL + SPHERE_PARAMETERS.index("offset")] = distinct
        values.append(repeated)
        numbers += [number] * len(distinct)
    return Columns(shape, np.concatenate(values, axis=1), np.array(numbers))


def _build_baseline_columns(scenes: list[Scene]) -> list[Columns]:
    grouped: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
    for number, scene in enumerate(scenes):
        shape, values = build_parameters(scene.model_copy(update={"inclusion": ()}), merged=False)
        grouped[shape].append((number, values))
    return [
        Columns(shape, np.stack([values for _, values in members], axis=1), np.array([number for number, _ in members]))
        for shape, members in grouped.items()
    ]


def _add_complex_step(group: Columns, name: str) -> Any:
    """Return the columns' values with a complex step of the logarithm; for x, of the value itself."""
    values, bodies = group.values.astype(complex), len(group.shape.on_axis)
    rows = {"diameter": "radius", "object": "modulus", "depth": "depth", "x": "offset"}
    if name in rows:
        row = FIRST_BALL + SPHERE_PARAMETERS.index(rows[name])
    elif name == "tissue":
        row = len(PROBE_PARAMETERS) + TISSUE_PARAMETERS.index("tissue_modulus")
    else:
        _, number, key = name.split("_")
        row = (
            FIRST_BALL
            + bodies * len(SPHERE_PARAMETERS)
            + int(number) * len(LAYER_PARAMETERS)
            + LAYER_PARAMETERS.index(f"layer_{key}")
        )
    values[row] += 1j * COMPLEX_STEP_RELATIVE * (1.0 if name == "x" else values[row])
    return values
