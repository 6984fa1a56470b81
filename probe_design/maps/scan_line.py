"""A line over the tissue along which the probe moves: allowed positions, tumours relative to the probe, effect of the sides.

The evaluator models the tissue as a cylinder of the same area about the probe's axis, at any position of the probe, and bounds
the error by the inscribed and the circumscribed cylinder. With the distance from the tissue's middle the first shrinks and the
second grows, so that the bound at the farthest of some positions holds at all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from geometry.common.limits import format_maximum_mm
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Placement
from geometry.scenes.units import SI_CONTEXT
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed, add_bounds
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import FilmForces

SQUARE_LAW_ERROR = 0.3  # of the effect of the sides between two positions: error of interpolating with the square of the distance
MAX_SPLITS = 3  # halvings of the positions for closer bounds: up to 8 solutions
CLOSE_BOUND_FRACTION = 0.5  # of the accuracy: error bounds that need no further halving


@dataclass(frozen=True)
class ScanLine:
    """The line of a scan.

    Attributes
    ----------
    scene
        The scene; its own placement along the line is not used.
    axis
        "x" or "y", along which the probe moves.
    offset
        Coordinate along the other axis, m.
    accuracy
        Relative, required of the evaluator.
    """

    scene: Scene
    axis: str
    offset: float
    accuracy: float

    @property
    def cross_axis(self) -> str:
        """The other axis."""
        return "y" if self.axis == "x" else "x"

    @property
    def max_position(self) -> float:
        """Largest distance of the probe's axis from the tissue's middle along the line, m; 0 or less where none is allowed."""
        tissue, reach = self.scene.tissue, self.scene.probe.tube_radius
        if tissue.shape == "half-space":
            return math.inf
        if tissue.shape == "cylinder":
            max_distance = tissue.radius - reach
            return math.sqrt(max_distance**2 - self.offset**2) if max_distance > abs(self.offset) else 0.0
        length, breadth = (tissue.length, tissue.breadth) if self.axis == "x" else (tissue.breadth, tissue.length)
        return length / 2 - reach if abs(self.offset) < breadth / 2 - reach else 0.0

    def check_positions(self, positions: Floats) -> None:
        """Raise ``InputError`` where the probe would leave the tissue."""
        if positions.ndim != 1 or not positions.size or not np.all(np.isfinite(positions)):
            raise InputError("position", "not all finite", "one or more finite positions, m")
        max_position = self.max_position * (1 - 1e-9)  # rounding must not move the probe off the tissue
        reason = f"the whole probe, of radius {format_mm(self.scene.probe.tube_radius)}, has to stand on the tissue"
        if max_position <= 0:
            max_offset = format_maximum_mm(replace(self, axis=self.cross_axis, offset=0.0).max_position)
            raise InputError("at", format_mm(self.offset), f"less than {max_offset} from the tissue's middle ({reason})")
        for key, end in (("from", positions.min()), ("to", positions.max())):
            if abs(end) >= max_position:
                limit = format_maximum_mm(max_position)
                offset_text = f" at {self.cross_axis} = {format_mm(self.offset)}" if self.offset else ""
                raise InputError(key, format_mm(end), f"positions between -{limit} and {limit}{offset_text} ({reason})")

    def build_tumours(self, positions: Floats) -> Tumours:
        """Return the inclusions relative to each position of the probe, shape (n, inclusions)."""
        keys = (self.axis, self.cross_axis, "depth", "diameter", "youngs_modulus", "poisson_ratio")
        table = {key: np.array([[getattr(body, key) for body in self.scene.inclusion]], dtype=float) for key in keys}
        table[self.axis] = table[self.axis] - positions[:, None]
        table[self.cross_axis] = table[self.cross_axis] - self.offset
        return Tumours(**table)

    def solve_alone(self, position: float) -> ProbeAlone:
        """Return the film forces without tumours at a position along the line, m.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene, or it is too extreme for double precision.
        """
        return EquivalentInclusion().solve_alone(self.place_probe(position), self.accuracy)

    def place_probe(self, position: float) -> Scene:
        """Return the scene with the probe at a position along the line, m.

        Both coordinates are taken positive: the tissue is symmetric, and tumours are placed separately.
        """
        coordinates = {self.axis: abs(position), self.cross_axis: abs(self.offset), "tilt": self.scene.placement.tilt}
        placement = Placement.model_validate({key: float(value) for key, value in coordinates.items()}, context=SI_CONTEXT)
        return self.scene.model_copy(update={"placement": placement})

    def add_bounds(self, base: Undisturbed, film_readings: Readings, positions: Floats) -> Readings:
        """Return readings that were computed with one ``base``, corrected for the tissue's sides at each position.

        Film forces and charges without tumours are interpolated with the square of the distance from the middle, between those of
        ``base`` and the farthest position of each part; the error bounds are those of the farthest position.

        Parameters
        ----------
        base
            The probe without tumours at the position nearest to the tissue's middle.
        film_readings
            At n positions, computed with ``base``.
        positions
            m, shape (n,).
        """
        order = np.argsort(np.abs(positions))
        min_square, squares = positions[order[0]] ** 2, positions**2
        parts = self._split_positions(positions, order, self.solve_alone(positions[order[-1]]), MAX_SPLITS)

        def correct(read: Readings, films: FilmForces, films_of_parts: Iterable[FilmForces | None]) -> Readings:
            """Return forces or charges, corrected by those without tumours, of ``base`` and at the farthest of each part."""
            tumour_bound, forces = read.bound - films.bound.totals, read.forces.copy()
            bound, log_ratio = np.empty_like(read.bound), np.empty_like(read.log_ratio_bound)
            for (part, _), part_films in zip(parts, films_of_parts, strict=True):
                assert part_films is not None  # all positions have charges, or none
                change, span = part_films.forces - films.forces, squares[part].max() - min_square
                fraction = (squares[part] - min_square) / span if span > 0 else np.zeros(len(part))
                forces[part] += fraction[:, None, None] * change
                law_error = SQUARE_LAW_ERROR * np.abs(change.sum(axis=1))
                bound[part], log_ratio[part] = add_bounds(part_films, tumour_bound[part] + law_error, forces[part])
            return replace(read, forces=forces, bound=bound, log_ratio_bound=log_ratio)

        charges = film_readings.charges
        if charges is not None and base.films.charges is not None:
            charges = correct(charges, base.films.charges, (alone.films.charges for _, alone in parts))
        return replace(correct(film_readings, base.films, (alone.films for _, alone in parts)), charges=charges)

    def _split_positions(
        self, positions: Floats, order: Ints, farthest: ProbeAlone, splits: int
    ) -> list[tuple[Ints, ProbeAlone]]:
        """Halve the positions until the error bounds at the farthest of each part are small enough.

        Parameters
        ----------
        positions
            m, shape (n,).
        order
            Indices of the positions of this part, by distance from the tissue's middle.
        farthest
            The film forces without tumours at the last of them.
        splits
            Halvings that remain.

        Returns
        -------
        list[tuple[Ints, ProbeAlone]]
            Indices of each part, and the film forces at its farthest position.
        """
        films, read = farthest.films, farthest.films.get_observable(self.scene)
        worst = max(films.ratio_error, films.relative_errors.max(), read.ratio_error)
        if worst <= CLOSE_BOUND_FRACTION * self.accuracy or splits == 0 or len(order) < 2:
            return [(order, farthest)]
        inner, outer = order[: len(order) // 2], order[len(order) // 2 :]
        return [
            *self._split_positions(positions, inner, self.solve_alone(positions[inner[-1]]), splits - 1),
            *self._split_positions(positions, outer, farthest, splits - 1),
        ]
