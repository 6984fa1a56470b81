"""Define the readings of a scan over each tumour of a population, and compute them with the closed form.

The m readings are logarithms: of the ratio at all positions, then of the stiffness if it is read. With F_j the force on film j
per unit indentation, and a constant that contains the films' areas,

    ln ratio = ln F_inner - ln F_outer + const,   ln stiffness = ln (F_inner + F_outer)             (PO.1)

Where the scene reads charges, the films' charges Q_j stand in place of F_j in the ratio. What is computed of a film pair is thus
F_inner, F_outer or, with charges, F_inner, F_outer, Q_inner, Q_outer, and called its totals.
The signal of a tumour is the difference of the readings from those in the same tissue without it. Load and areas cancel.

The closed form computes them for all tumours at once: each pair of a tumour and a distance from the probe is a column of
parameters of ``closed_form.designs.compute_forces``. Derivatives are complex steps.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Placement
from probe_design.populations.film_totals import append_charges
from probe_design.populations.population import PLACE_AXES, TumourDraw, is_of_tumour
from probe_design.populations.tables import Protocol
from solver.closed_form.designs import (
    LAYER_PARAMETERS,
    PROBE_PARAMETERS,
    SPHERE_PARAMETERS,
    TISSUE_PARAMETERS,
    Shape,
    build_parameters,
    compute_products,
)
from solver.closed_form.evaluator import ClosedForm

NODE_ROUNDING = 8  # nodes by which groups differ: fewer groups, each a little more exact
MIN_OFFSET_PER_DIAMETER = 1e-6  # of the diameter: smallest lateral offset that counts as off the axis
COMPLEX_STEP_RELATIVE = 1e-30  # of complex steps, relative
FIRST_SPHERE_ROW = len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)
SPHERE_PARAMETER_NAMES = {"diameter": "radius", "object": "modulus", "depth": "depth", "x": "offset", "y": "offset"}


@dataclass(frozen=True)
class ScanReadings:
    """Readings over n tumours in t tissues, m readings of c channels each.

    Attributes
    ----------
    signal
        Readings of eq. PO.1 with the tumour less those without, shape (n, m).
    errors
        Error bounds of the signal by cause, see ``scan_errors.ERROR_CAUSES``, shape (n, m); may be empty.
    tissue
        Number of each tumour's tissue, shape (n,).
    blank
        Totals per unit indentation without tumours, N/m and C/m, without sign, shape (t, 2 or 4).
    mean_forces
        Geometric mean over the tumours of the totals at each position, without sign, shape (p, 2 or 4).
    blank_error
        Error bound of eq. PO.1 without tumours, shape (t, c).
    derivatives
        Of ``signal`` with respect to the parameters named in ``ScenePopulation.ranges``: to their logarithms, per m of x and y;
        shape (n, m).
    blank_derivatives
        Derivatives of eq. PO.1 without tumours by the tissue's numbers, shape (t, c).
    """

    signal: Floats
    errors: dict[str, Floats]
    tissue: Ints
    blank: Floats
    mean_forces: Floats
    blank_error: Floats
    derivatives: dict[str, Floats] = field(default_factory=dict)
    blank_derivatives: dict[str, Floats] = field(default_factory=dict)

    @property
    def positions(self) -> int:
        """Number of positions."""
        return int(self.signal.shape[1]) // self.channels

    @property
    def channels(self) -> int:
        """Number of readings at each position."""
        return int(self.blank_error.shape[1])

    @property
    def error(self) -> Floats:
        """Error bound of ``signal``, all causes together, shape (n, m)."""
        return np.asarray(sum(self.errors.values(), np.zeros_like(self.signal)))

    def list_columns(self, positions: Ints, channels: Sequence[int]) -> Ints:
        """Return the indices, among the m readings, of some channels at some positions, both given by their numbers.

        The readings are ordered by channel, then by position.
        """
        return np.asarray((np.asarray(channels)[:, None] * self.positions + positions).ravel())

    def select(self, positions: Ints, channels: Sequence[int]) -> ScanReadings:
        """Return the readings of some channels at some positions only, both given by their numbers."""
        columns, chosen = self.list_columns(positions, channels), list(channels)
        return replace(
            self,
            signal=self.signal[:, columns],
            errors={cause: error[:, columns] for cause, error in self.errors.items()},
            mean_forces=self.mean_forces[positions],
            blank_error=self.blank_error[:, chosen],
            derivatives={name: reading_derivatives[:, columns] for name, reading_derivatives in self.derivatives.items()},
            blank_derivatives={
                name: reading_derivatives[:, chosen] for name, reading_derivatives in self.blank_derivatives.items()
            },
        )

    def repeat_over_positions(self, values: Floats) -> Floats:
        """Repeat numbers of each channel, shape (..., c), for all readings, shape (..., m)."""
        return np.repeat(values, self.positions, axis=-1)


def compute_logarithms(totals: Any, stiffness: bool) -> Any:
    """Return the logarithms of ratio and stiffness, eq. PO.1 without its constant.

    Parameters
    ----------
    totals
        Totals of the films, shape (..., p, 2 or 4), real or complex; charges may be of either sign.
    stiffness
        Whether the stiffness is read.

    Returns
    -------
    Any
        Logarithms, shape (..., m): ln ratio at the p positions, then ln stiffness.
    """
    read = totals[..., -2:]
    read = np.where(np.real(read) < 0, -read, read) if totals.shape[-1] == 4 else read
    ratio = np.log(read[..., 0]) - np.log(read[..., 1])
    return np.concatenate([ratio, np.log(totals[..., :2].sum(axis=-1))], axis=-1) if stiffness else ratio


@dataclass(frozen=True)
class Columns:
    """Designs of the closed form, as columns of parameters in groups of one structure.

    Attributes
    ----------
    scene
        A scene with the films of all designs.
    groups
        The structure of each group, and its parameters, shape (parameters, k).
    index
        Number of the column of each result, counted over all groups; any shape.
    """

    scene: Scene
    groups: tuple[tuple[Shape, Floats], ...]
    index: Ints

    def compute_totals(self, stepped: str = "") -> Any:
        """Return the totals of the films per unit indentation, N/m and C/m, shape (*index.shape, 2 or 4).

        With ``stepped``, the name of a range of ``ScenePopulation.ranges``, they are complex: the imaginary part over
        ``COMPLEX_STEP_RELATIVE`` is the derivative by the logarithm of that number, or by the lateral offset for x and y. ""
        takes no step.
        """
        with np.errstate(all="ignore"):  # the caller refuses values that are not finite
            parts = [
                compute_products(shape, _add_complex_step(shape, values, stepped) if stepped else values)[0].sum(axis=2)
                for shape, values in self.groups
            ]
        return append_charges(self.scene, np.concatenate(parts)[self.index])


def compute_closed_form_readings(draw: TumourDraw, protocol: Protocol, names: tuple[str, ...] = ()) -> ScanReadings:
    """Return readings over a population, and their derivatives.

    Parameters
    ----------
    draw
        The tumours.
    protocol
        The readings.
    names
        Names of ``ScenePopulation.ranges`` with respect to which derivatives are computed.

    Raises
    ------
    Refusal
        The closed form cannot model the scene, or fails for this probe.
    """
    for scene in draw.tissues:
        if (reason := ClosedForm().refusal(scene)) is not None:
            raise Refusal("evaluator", "closed-form", reason)
    distances = draw.compute_distances(protocol)
    offset = np.linalg.norm(distances, axis=-1)
    tumours, tissues = _build_tumour_columns(draw, offset), _build_tissue_columns(draw.tissues)

    def repeat_over_positions(values: Floats) -> Floats:
        """Repeat numbers of each tissue and channel, shape (t, c), for all readings of each tumour, shape (n, m)."""
        return np.repeat(values, protocol.count, axis=1)[draw.tissue]

    totals, blank = tumours.compute_totals(), tissues.compute_totals()
    with np.errstate(all="ignore"):
        signal = compute_logarithms(totals, protocol.stiffness)
        signal = signal - repeat_over_positions(compute_logarithms(blank[:, None], protocol.stiffness))
    if not (np.all(np.isfinite(signal)) and np.all(blank[:, :2] > 0) and np.all(totals[..., 2:] * blank[0, 2:] > 0)):
        raise Refusal("evaluator", "closed-form", "equivalent-inclusion, as the formulas break down for this probe")
    derivatives, blank_derivatives = {}, {}
    for name in names:
        reading_derivatives = compute_logarithms(tumours.compute_totals(name), protocol.stiffness).imag / COMPLEX_STEP_RELATIVE
        if name in PLACE_AXES:  # the complex step is one of the lateral offset: chain rule, with 0 in place of 0 / 0 on the axis
            cosines = distances[..., PLACE_AXES.index(name)] / np.maximum(offset, 1e-300)
            reading_derivatives = reading_derivatives * np.tile(cosines, (1, protocol.channels))
        elif not is_of_tumour(name):
            blank_slopes = compute_logarithms(tissues.compute_totals(name)[:, None], protocol.stiffness).imag
            blank_derivatives[name] = blank_slopes / COMPLEX_STEP_RELATIVE
            reading_derivatives = reading_derivatives - repeat_over_positions(blank_derivatives[name])
        derivatives[name] = reading_derivatives
    mean_forces, no_error = np.exp(np.log(np.abs(totals)).mean(axis=0)), np.zeros((len(blank), protocol.channels))
    return ScanReadings(signal, {}, draw.tissue, np.abs(blank), mean_forces, no_error, derivatives, blank_derivatives)


def _build_tumour_columns(draw: TumourDraw, offset: Floats) -> Columns:
    """Return the columns of tumours at lateral offsets from the probe, shape (n, p); each distinct offset is one column."""
    grouped: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
    for number in range(len(draw)):
        # of the tumour's farthest position, where the closed form needs most nodes
        shape, values = build_parameters(_build_tumour_scene(draw, number, float(offset[number].max())), merged=False)
        # nodes are rounded up to a multiple of NODE_ROUNDING
        grouped[replace(shape, nodes=-(-shape.nodes // NODE_ROUNDING) * NODE_ROUNDING)].append((number, values))
    groups, index, count = [], np.empty(offset.shape, dtype=int), 0
    for shape, members in grouped.items():
        columns: list[Floats] = []
        for number, values in members:
            min_offset = 0.0 if shape.on_axis[0] else MIN_OFFSET_PER_DIAMETER * draw.diameter[number]
            distinct, positions = np.unique(np.maximum(offset[number], min_offset), return_inverse=True)
            index[number] = count + positions
            count += len(distinct)
            columns.append(np.tile(values[:, None], (1, len(distinct))))
            columns[-1][FIRST_SPHERE_ROW + SPHERE_PARAMETERS.index("offset")] = distinct
        groups.append((shape, np.concatenate(columns, axis=1)))
    return Columns(draw.scene, tuple(groups), index)


def _build_tumour_scene(draw: TumourDraw, number: int, offset: float) -> Scene:
    """Return a scene with one tumour at a distance from the probe; not validated, as the draw is."""
    body = Inclusion.model_construct(
        diameter=float(draw.diameter[number]), depth=float(draw.depth[number]), x=offset, y=0.0, target=True,
        youngs_modulus=float(draw.youngs_modulus[number]), poisson_ratio=draw.poisson_ratio,
    )  # fmt: skip
    scene: Scene = draw.tissues[draw.tissue[number]]
    return scene.model_copy(update={"inclusion": (body,), "placement": Placement()})


def _build_tissue_columns(tissues: tuple[Scene, ...]) -> Columns:
    """Return the columns of tissues without tumours, one for each tissue."""
    grouped: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
    for number, scene in enumerate(tissues):
        shape, values = build_parameters(scene.model_copy(update={"inclusion": ()}), merged=False)
        grouped[shape].append((number, values))
    groups = tuple((shape, np.stack([values for _, values in members], axis=1)) for shape, members in grouped.items())
    # argsort inverts the order in which grouping has put the tissues
    return Columns(tissues[0], groups, np.argsort([number for members in grouped.values() for number, _ in members]))


def _add_complex_step(shape: Shape, values: Floats, name: str) -> Any:
    """Return the columns with a complex step of the logarithm of a parameter; for x and y, of the lateral offset itself.

    Parameters
    ----------
    shape
        Structure of the columns.
    values
        Parameters of k columns, shape (parameters, k).
    name
        Name of the parameter in ``ScenePopulation.ranges``.
    """
    if name in SPHERE_PARAMETER_NAMES:
        row = FIRST_SPHERE_ROW + SPHERE_PARAMETERS.index(SPHERE_PARAMETER_NAMES[name])
    elif name == "tissue":
        row = len(PROBE_PARAMETERS) + TISSUE_PARAMETERS.index("tissue_modulus")
    else:
        _, number, key = name.split("_")
        first_layer_row = FIRST_SPHERE_ROW + len(shape.on_axis) * len(SPHERE_PARAMETERS)
        row = first_layer_row + int(number) * len(LAYER_PARAMETERS) + LAYER_PARAMETERS.index(f"layer_{key}")
    stepped = values.astype(complex)
    stepped[row] += 1j * COMPLEX_STEP_RELATIVE * (1.0 if name in PLACE_AXES else values[row])
    return stepped
