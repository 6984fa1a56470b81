"""Compute film forces or charges under load from the linear ones and the changes that two meshes show, with error bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from solver.contact.corner_check import CornerCheck, is_near_wall
from solver.contact.path import Path
from solver.contact.states import Outputs, PathPoint
from solver.results.film_forces import Bound, FilmForces

MESH_SAFETY_FACTOR = 2.0  # times the maximum difference of two meshes on the load path
# What the load changes of ln of ratios, and of the log-sensitivity, counts by these shares. They were chosen on five scenes
# beside that of tests/solver/contact/test_corner_check.py, all of which they cover, and tried on no others. Before a coarse
# corner comes near a wall the log-sensitivity was wrong by up to 0.06 of its growth, where what was stated was a fifth of that
UNSEEN_SHARES = 0.03, 0.05
# where no fine corners converge. Beyond what is stated without them, ratios were wrong by up to 0.12 of their change, that
# against meshes with fine corners of order two, as finer ones did not go as far; the rest is margin
UNCHECKED_SHARES, UNCHECKED_PER_X = (0.2, 0.1), 0.02
SCALING_TOLERANCE = 0.2  # relative: meshes nearer to the linear log-sensitivity are corrected by a factor


@dataclass(frozen=True)
class MeshDifferences:
    """Differences of two meshes: in ln of both outputs, shape (2,), in ln of their ratio, and in log-sensitivity, relative."""

    outputs: Floats
    log_ratio: float
    sensitivity: float

    def __or__(self, other: MeshDifferences) -> MeshDifferences:
        """Return the larger of both values of each difference (``a | b``)."""
        outputs = np.maximum(self.outputs, other.outputs)
        return MeshDifferences(outputs, max(self.log_ratio, other.log_ratio), max(self.sensitivity, other.sensitivity))

    def add(self, other: MeshDifferences, factor: float) -> MeshDifferences:
        """Return the sum with another one times a factor."""
        log_ratio, sensitivity = self.log_ratio + factor * other.log_ratio, self.sensitivity + factor * other.sensitivity
        return MeshDifferences(self.outputs + factor * other.outputs, log_ratio, sensitivity)


NO_DIFFERENCES = MeshDifferences(np.zeros(2), 0.0, 0.0)


@dataclass(frozen=True)
class LoadedOutputs:
    """The film forces of a scene on the load paths of two meshes, or its films' charges, with what is known of their errors.

    Attributes
    ----------
    paths
        Load paths on two meshes, the finer last.
    linear
        The linear film forces, or charges.
    are_charges
        Whether the outputs are charges.
    corrected
        Whether the linear outputs are the limit of light loads, by which the meshes' errors at rest are corrected.
    min_errors
        Minimum error bounds of outputs and log-sensitivity, relative.
    known
        Mesh differences on a part of the load path that was not computed.
    corner_check
        The load path with fine corners; None where tissue does not fold onto a sharp corner or ``known`` includes it.
    """

    paths: tuple[Path, Path]
    linear: FilmForces
    are_charges: bool
    corrected: bool
    min_errors: tuple[float, float]
    known: MeshDifferences = NO_DIFFERENCES
    corner_check: CornerCheck | None = None

    def select(self, point: PathPoint) -> Outputs:
        """Return the film forces at a point of a path, or the charges."""
        if not self.are_charges:
            return point.forces
        assert point.charges is not None
        return point.charges

    def compute_ratio(self, point: PathPoint) -> float:
        """Return the ratio of both outputs, inner over outer; at rest, where both are zero, that of their derivatives."""
        outputs = self.select(point)
        inner, outer = outputs.values if point.indentation > 0 else outputs.tangent
        return float(inner / outer)

    def build_films(self, point: PathPoint) -> FilmForces:
        """Return the outputs per indentation at a point, with bounds from the linear errors and the differences of two meshes."""
        outputs, until = self.select(point), point.indentation
        value = self.compute_sensitivity(self.paths[1], point) if self.linear.modulus_derivative is not None else 0.0
        totals, differences = outputs.values / until, self.compute_differences(until)
        return self.assemble(totals, outputs.log_sensitivities, value, differences, self.find_max_sensitivity(until))

    def assemble(
        self, totals: Floats, log_sensitivities: Floats, value: float, differences: MeshDifferences, max_sensitivity: float
    ) -> FilmForces:
        """Return outputs per indentation with bounds.

        Parameters
        ----------
        totals
            Outputs per indentation, shape (2,).
        log_sensitivities
            D ln output / d ln E at constant force, of the finer mesh, shape (2,).
        value
            Log-sensitivity of the ratio, corrected for the mesh's error at rest.
        differences
            Of the two meshes.
        max_sensitivity
            Maximum magnitude of the log-sensitivity, which its differences are relative to.
        """
        linear = self.linear
        min_error, min_slope_error = self.min_errors
        if self.corrected and self.paths[1].model.may_open:  # faces slide
            min_error += self.paths[1].light_offsets[int(self.are_charges)]
        errors = linear.relative_errors + MESH_SAFETY_FACTOR * differences.outputs + min_error
        bound = Bound(errors * np.abs(totals), linear.bound.log_ratio + MESH_SAFETY_FACTOR * differences.log_ratio + min_error)
        if linear.modulus_derivative is None:
            return FilmForces(np.diag(totals), bound)
        # the linear error grows with the log-sensitivity under load
        grown = abs(value / linear.log_sensitivity) if linear.log_sensitivity else 1.0
        mesh_error = (MESH_SAFETY_FACTOR * differences.sensitivity + min_slope_error) * max_sensitivity
        error = linear.sensitivity_error * max(1.0, grown) + mesh_error
        if self.are_charges:
            # the correction of the difference is shared by both
            shortfall = value - (log_sensitivities[0] - log_sensitivities[1])
            log_derivatives = log_sensitivities + 0.5 * shortfall * np.array([1, -1])
        else:
            # at constant force the changes of the two film forces cancel
            log_derivatives = np.array([totals[1], -totals[0]]) / totals.sum() * value
        return FilmForces(np.diag(totals), bound, np.diag(totals * log_derivatives), error)

    def compute_sensitivity(self, path: Path, point: PathPoint) -> float:
        """Return the log-sensitivity at a point of a path, corrected for the mesh's error at rest if that is known.

        A small error is corrected by a factor, a large one by an addition.
        """
        return self.correct_sensitivity(path, self.select(point).log_sensitivity)

    def correct_sensitivity(self, path: Path, value: float) -> float:
        """Return a log-sensitivity of a path, corrected for the mesh's error at rest; see ``compute_sensitivity``."""
        if not self.corrected:
            return value
        exact, rest_sensitivity = self.linear.log_sensitivity or 0.0, self.select(path.points[0]).log_sensitivity
        if rest_sensitivity * exact > 0 and abs(rest_sensitivity / exact - 1) < SCALING_TOLERANCE:
            return value * exact / rest_sensitivity
        return value + exact - rest_sensitivity

    def compute_differences(self, until: float) -> MeshDifferences:
        """Return the maximum differences of both meshes up to the indentation ``until``, m.

        Where tissue comes near a wall, the difference to fine corners is added, so that it counts once in a bound; beyond what
        fine corners reach, and for what two layers of cells would show, shares of what the load changes are.
        """
        differences = self._compare(*self.paths, until, until) | self.known
        if self.corner_check is None:
            return differences
        corners = self._estimate_corners(until, UNSEEN_SHARES)
        if is_near_wall(self.paths[1], until):
            reached = self.corner_check.press(until)
            if reached > 0:  # what is not reached is extrapolated in proportion to the indentation
                seen = self._compare(self.corner_check.path, self.paths[1], reached, until)
                corners = corners.add(seen, until / reached)
            corners = corners.add(self._estimate_corners(until, UNCHECKED_SHARES, UNCHECKED_PER_X), 1 - reached / until)
        return differences.add(corners, 1 / MESH_SAFETY_FACTOR)

    def _estimate_corners(self, until: float, shares: tuple[float, float], per_x: float = 0.0) -> MeshDifferences:
        """Estimate what fine corners change up to the indentation ``until``, m, as shares of what the load changes.

        ``shares`` are those of ln of outputs and ratios, and of the log-sensitivity; ``per_x`` is added to the former per
        indentation in outer radii.
        """
        path = self.paths[1]
        points = [point for point in path.points if point.indentation <= until * (1 + 1e-9)]
        pairs = [[point.forces, *([] if point.charges is None else [point.charges])] for point in points]
        outputs = [[x.values if number else x.tangent for x in pair] for number, pair in enumerate(pairs)]  # at rest all are zero
        ratios = np.log(np.abs([[x[0] / x[1] for x in pair] for pair in outputs]))
        change = shares[0] * float(np.abs(ratios - ratios[0]).max()) + per_x * until / path.radius
        values, size = [self.compute_sensitivity(path, point) for point in points], self.find_max_sensitivity(until)
        growth = shares[1] * max(abs(value - values[0]) for value in values) / size if size else 0.0
        return MeshDifferences(np.full(2, change), change, growth)

    def _compare(self, coarse: Path, fine: Path, reached: float, until: float) -> MeshDifferences:
        """Return the maximum differences of two paths up to the indentation ``reached``, m, of ``until``."""
        places = np.unique([reached, *(point.indentation for path in (coarse, fine) for point in path.points)])
        places = places[(places > 0) & (places <= reached)]
        # outputs and log-sensitivities of the coarser and the finer mesh
        (outputs, first), (second_outputs, second) = (self._interpolate(path, places) for path in (coarse, fine))
        log_ratios, size = np.log(np.abs(outputs / second_outputs)), self.find_max_sensitivity(until)
        sensitivity = float(np.abs(first - second).max()) / size if size else 0.0
        return MeshDifferences(np.abs(log_ratios).max(axis=1), float(np.abs(log_ratios[0] - log_ratios[1]).max()), sensitivity)

    def find_max_sensitivity(self, until: float) -> float:
        """Return the maximum magnitude of the log-sensitivity up to the indentation ``until``, m."""
        path = self.paths[1]
        return max(abs(self.compute_sensitivity(path, point)) for point in path.points if point.indentation <= until)

    def _interpolate(self, path: Path, places: Floats) -> tuple[Floats, Floats]:
        """Interpolate outputs, shape (2, k), and log-sensitivities, (k,), of a path at k indentations ``places``, m.

        Beyond the path's end the tangent there is followed: points at a force may lie so close to each other that a cubic through
        them would only amplify what their contact differs by.
        """
        from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

        indentations = np.array([point.indentation for point in path.points])
        outputs = [self.select(point) for point in path.points]
        values = CubicHermiteSpline(indentations, [x.values for x in outputs], [x.tangent for x in outputs])
        sensitivity = PchipInterpolator(indentations, [self.compute_sensitivity(path, point) for point in path.points])
        inside = np.minimum(places, indentations[-1])
        return values(inside).T + (places - inside) * outputs[-1].tangent[:, None], sensitivity(inside)
