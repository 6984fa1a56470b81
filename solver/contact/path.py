"""Press a probe step by step: extrapolate states, adapt the steps to Newton's method, store all that converged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached
from solver.contact.model import ContactModel
from solver.contact.newton import solve
from solver.contact.states import (
    Equilibrium,
    Linearised,
    Outputs,
    PathPoint,
    State,
    StoppedError,
    add_weighted,
    compute_hermite_weights,
    compute_lagrange_weights,
)
from solver.results.film_forces import FilmForces

FIRST_STEP_RELATIVE, MIN_STEP_RELATIVE, MAX_STEP_RELATIVE = (
    0.02,
    1e-3,
    0.08,
)  # steps: first and minimum in units of the path, maximum in outer radii
LINEAR_INDENTATION_RELATIVE = 1e-6  # in units: an indentation at which all is linear
OPENING_INDENTATION_RELATIVE = 1e-4  # likewise where faces may open: gaps must exceed rounding errors
STEP_GROWTH_FACTOR, EASY_NEWTON_STEPS = 1.8, 12  # steps grow by this factor after one that took this many Newton steps or fewer
# likewise, and minimum step in units and maximum in outer radii, where faces may open: shorter steps went 0.4 % further
EASY_OPENING_STEPS, MIN_OPENING_STEP_RELATIVE, MAX_OPENING_STEP_RELATIVE = 30, 3e-3, 0.02
MAX_DEPTH_RELATIVE = 1.0  # outer radii: the accuracy of deeper states was never checked
FORCE_TOLERANCE_RELATIVE = 1e-4  # of a requested force: the rest is extrapolated linearly
MAX_FORCE_STEPS = 12
MIN_DISTANCE_RELATIVE = 0.1  # of the distance to extrapolate over: nearer points add little


@dataclass
class Path:
    """A load path: the states of a section under rising indentation.

    Attributes
    ----------
    model
        Model of the section.
    sensitive
        Whether derivatives with respect to the target's modulus are computed.
    linear
        More accurate film forces, and charges where they are modelled, per indentation at rest; or None. Their ratio to this
        mesh's corrects all forces and charges on the path, by one factor for each.
    points
        The point at rest, then all points at which Newton's method converged, by rising indentation.
    length
        Length of the next step, m.
    """

    model: ContactModel
    sensitive: bool
    linear: FilmForces | None = None
    points: list[PathPoint] = field(default_factory=list)
    length: float = 0.0
    _light_state: State = field(init=False)
    _scale: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Compute the first points: at rest, and under a very light load."""
        self.length, self._scale = FIRST_STEP_RELATIVE * self.unit, np.ones(self.model.outputs.shape[1])
        rest_state = self.model.build_rest_state()
        rest_equilibrium = Equilibrium(rest_state, self.model.linearise(rest_state), ())
        light = self._solve_light_load(rest_equilibrium)
        # factorised once for both uses below, the scale and the point
        light = replace(light, equations=self.model.factorise_tangent(light.equations))
        if self.linear is not None:
            _, derivatives = self.model.compute_responses(light.state, light.equations)
            films = (self.linear, *([] if self.linear.charges is None else [self.linear.charges]))
            self._scale = np.concatenate([outputs.totals for outputs in films]) / derivatives[:, 0]
        self._light_state, linear = light.state, self._build_point(light)
        # under the light load all is linear: its derivatives are those at rest
        gap = float(self.model.section.hole_radius - self.model.section.inner_radius)
        self.points.append(replace(linear.release(), walls=gap, strain=0.0, residual=0.0, equilibrium=rest_equilibrium))

    def seed(self, state: State) -> PathPoint:
        """Solve from a loaded state of the same mesh with other moduli and continue the path there; see ``iterate_steps``."""
        try:
            point = self._build_point(solve(self.model, state))
        except SolveError as fault:
            raise StoppedError(self.last, f"no further step converges: {fault}") from fault
        self.points.append(point)
        return point

    @property
    def light(self) -> Equilibrium:
        """The state under a load so light that all is linear, and the equations about it."""
        return Equilibrium(self._light_state, self.model.linearise(self._light_state), ())

    @cached_property
    def light_offsets(self) -> tuple[float, ...]:
        """By how much ln of forces per indentation and of their ratio differ under the light load from those at rest.

        After that of forces comes that of charges, if there are any. Where faces slide they are not 0: points pass a sharp edge
        on a small radius, the same on all meshes.
        """
        equilibrium, unloaded = self.light, self.points[0]
        values = self._scale * self.model.compute_outputs(equilibrium.equations) / equilibrium.state.indentation
        tangents = [outputs.tangent for outputs in (unloaded.forces, unloaded.charges) if outputs is not None]
        changes = np.log(values.reshape(-1, 2) / tangents)
        return tuple(float(np.ptp([*change, 0.0])) for change in changes)

    @property
    def radius(self) -> float:
        """Outer radius of the probe, m."""
        return float(self.model.section.tube_radius)

    @property
    def unit(self) -> float:
        """Unit of the steps, m: the probe's radius, or less if blocks or tissue are flat."""
        section = self.model.section
        return float(min(section.tube_radius, section.tissue_depth, section.inner_height, section.outer_height))

    @property
    def last(self) -> PathPoint:
        """The deepest point computed."""
        return self.points[-1]

    def reaches(self, force: float) -> bool:
        """Return whether the path goes as far as a force, N."""
        return self.last.force >= force * (1 - FORCE_TOLERANCE_RELATIVE)

    def iterate_steps(self, until: float, force: float = inf) -> Iterator[PathPoint]:
        """Press to the indentation ``until``, m, or to a force, N, if that is reached before; yield each point on the way.

        Raises
        ------
        StoppedError
            No further step converges.
        LimitReached
            The time limit is reached.
        """
        while self.last.indentation < until * (1 - 1e-12) and not self.reaches(force):
            advance = self.length if force == inf else min(self.length, self._estimate_advance(force))
            next_indentation = self.last.indentation + advance
            # no very short last step: one that would leave less than 0.3 of a step goes all the way
            yield self._take_step(until if next_indentation > until - 0.3 * advance else next_indentation)

    def press_to_indentation(self, indentation: float) -> PathPoint:
        """Press to an indentation, m, or between points that were computed before, and return the point there.

        For errors see ``iterate_steps`` and ``insert``.
        """
        for _ in self.iterate_steps(indentation):
            pass
        nearest = min(self.points, key=lambda point: abs(point.indentation - indentation))
        return nearest if abs(nearest.indentation - indentation) <= 1e-12 * indentation else self.insert(indentation)

    def press_to_force(self, force: float) -> PathPoint:
        """Press to a force, N, and return the point there; for errors see ``iterate_steps`` and ``insert``.

        The path is pressed to the force or beyond it; points are then inserted until one is so near that the rest is linear.
        """
        for _ in self.iterate_steps(inf, force):
            pass
        for _ in range(MAX_FORCE_STEPS):
            nearest = min(self.points, key=lambda point: abs(point.force - force))
            remainder = self._estimate_advance(force)
            if abs(nearest.force - force) <= FORCE_TOLERANCE_RELATIVE * force:
                return nearest.advance(remainder)
            self.insert(nearest.indentation + remainder)
        raise StoppedError(self.last, "no indentation gives the force")

    def _estimate_advance(self, force: float) -> float:
        """Estimate how much deeper than the nearest point a force, N, is reached, m; negative if it is less deep.

        The stiffness is taken to change linearly between the two points nearest to the force.
        """
        nearest, *neighbours = sorted(self.points, key=lambda point: abs(point.force - force))[:2]
        missing, stiffness = force - nearest.force, float(nearest.tangent.sum())
        if not neighbours:
            return missing / stiffness
        neighbour = neighbours[0]
        stiffening = (float(neighbour.tangent.sum()) - stiffness) / (neighbour.indentation - nearest.indentation)
        # missing = stiffness x + stiffening x^2 / 2, solved for x in a form that does not cancel
        discriminant = stiffness**2 + 2 * stiffening * missing
        return 2 * missing / (stiffness + discriminant**0.5) if discriminant > 0 else missing / stiffness

    def _take_step(self, indentation: float) -> PathPoint:
        """Take one step towards an indentation, m, halved until it converges, and adapt the next step's length."""
        start, max_depth = self.last.indentation, MAX_DEPTH_RELATIVE * self.radius
        if start >= max_depth * (1 - 1e-9):
            raise StoppedError(self.last, "the indentation is the probe's outer radius, and deeper solutions were never verified")
        step = min(indentation, max_depth) - start
        min_step = MIN_OPENING_STEP_RELATIVE if self.model.may_open else MIN_STEP_RELATIVE
        while True:
            try:
                point = self._solve_point(start + step)
                break
            except LimitReached as fault:
                raise LimitReached(fault.key, fault.value, f"{fault.allowed}; {self.last.force:.3g} N is reached") from fault
            except SolveError as fault:
                step /= 2
                self.length = step
                if step <= 0.5 * min_step * self.unit:
                    raise StoppedError(self.last, f"no further step converges: {fault}") from fault
        easy_steps, max_step = (
            (EASY_OPENING_STEPS, MAX_OPENING_STEP_RELATIVE) if self.model.may_open else (EASY_NEWTON_STEPS, MAX_STEP_RELATIVE)
        )
        if len(point.equilibrium.residuals) <= easy_steps:
            self.length = min(STEP_GROWTH_FACTOR * self.length, max_step * self.radius)
        self.points.append(point)
        return point

    def insert(self, indentation: float) -> PathPoint:
        """Compute a point between others and add it to the path.

        Raises
        ------
        SolveError
            See ``solver.contact.newton.solve``.
        LimitReached
            The time limit is reached.
        """
        point = self._solve_point(indentation)
        self.points.append(point)
        self.points.sort(key=lambda entry: entry.indentation)
        return point

    def _solve_point(self, indentation: float) -> PathPoint:
        """Solve at an indentation from the extrapolated state; if faces may open, or between points, also from one before it."""
        try:
            return self._build_point(solve(self.model, self._extrapolate(indentation)))
        except SolveError:
            if not self.model.may_open and indentation > self.last.indentation:
                raise  # a shorter step is tried
        # neighbours may differ in what touches and slides: one alone is sometimes the better start
        return self._build_point(solve(self.model, self._follow_tangent(self._find_state_before(indentation), indentation)))

    @property
    def _target(self) -> Floats | None:
        """Mask of the target's elements, shape (n, 1); None where no sensitivity is wanted."""
        return self.model.target if self.sensitive else None

    def _find_nearest(self, indentation: float) -> list[PathPoint]:
        """Find the three nearest points that are not too close to each other, so that extrapolation amplifies no rounding."""
        nearest: list[PathPoint] = []
        for point in sorted(self.points, key=lambda point: abs(point.indentation - indentation)):
            min_distance = MIN_DISTANCE_RELATIVE * abs(point.indentation - indentation)
            if len(nearest) < 3 and all(abs(point.indentation - neighbour.indentation) > min_distance for neighbour in nearest):
                nearest.append(point)
        return nearest

    def _extrapolate(self, indentation: float) -> State:
        """Extrapolate or interpolate the state at an indentation from the nearest points."""
        nearest = self._find_nearest(indentation)
        states = [point.equilibrium.store_pressures() for point in nearest]
        if len(states) < 2:
            return self._scale_light_state(indentation) if len(self.points) == 1 else self._follow_tangent(states[0], indentation)
        places = [state.indentation for state in states]
        if self.model.may_open or any(point.equilibrium.equations.has_contact for point in nearest):
            # where lines touch, starts with rates lead to another equilibrium of a folding corner: use values alone
            guess = add_weighted(compute_lagrange_weights(places, indentation), states)
            guess = replace(guess, multipliers=tuple(np.maximum(multiplier, 0.0) for multiplier in guess.multipliers))
        else:
            guess = add_weighted(
                compute_hermite_weights(places[:2], indentation), [*states[:2], *(point.rates for point in nearest[:2])]
            )
        # where the polynomial turns an element inside out, the tangent is safer
        if self.model.elements.compute_min_volume_ratio(guess.elements.u) <= 0:
            return self._follow_tangent(states[0], indentation)
        return replace(guess, indentation=indentation, grips=self._find_state_before(indentation).grips)

    def _find_state_before(self, indentation: float) -> State:
        """Return the last state below an indentation; friction depends on it."""
        earlier_states = [point.equilibrium.state for point in self.points if point.indentation <= indentation]
        return earlier_states[-1]

    def _solve_light_load(self, rest_equilibrium: Equilibrium) -> Equilibrium:
        """Solve for a very light load, under which faces that may open are open."""
        indentation = (OPENING_INDENTATION_RELATIVE if self.model.may_open else LINEAR_INDENTATION_RELATIVE) * self.unit
        state = self._follow_tangent(rest_equilibrium.state, indentation, rest_equilibrium.equations)
        if not self.model.may_open:
            return Equilibrium(state, self.model.linearise(state), ())
        pressures = tuple(touch.pressure for touch in self.model.compute_touches(state))
        return solve(self.model, replace(state, multipliers=pressures))

    def _scale_light_state(self, indentation: float) -> State:
        """Scale the light-load state to a small indentation, where all is proportional and the contact does not change."""
        factor = indentation / self._light_state.indentation
        grips = (None if grip is None else replace(grip, shear=factor * grip.shear) for grip in self._light_state.grips)
        return replace(add_weighted([factor], [self._light_state]), indentation=indentation, grips=tuple(grips))

    def _follow_tangent(self, state: State, indentation: float, equations: Linearised | None = None) -> State:
        """Return the state at an indentation on the tangent of another state; ``equations`` are those about it, if known."""
        equations = equations or self.model.linearise(state)
        changes, _ = self.model.compute_responses(state, equations)
        return self.model.shift(state, equations, (indentation - state.indentation) * changes[:, 0], indentation)

    def _build_point(self, equilibrium: Equilibrium) -> PathPoint:
        """Compute the results at an equilibrium.

        At constant force F the base follows a stiffer target, of Young's modulus E, by -(dF/d ln E) / (dF/d indentation) (CT.5).
        """
        model, equations, state = self.model, equilibrium.equations, equilibrium.state
        model.check_base(state)
        model.check_laws(state)
        changes, derivatives = model.compute_responses(state, equations, self._target)
        values, derivatives = self._scale * model.compute_outputs(equations), self._scale[:, None] * derivatives
        tangent, sensitivities = derivatives[:, 0], np.zeros(len(values))
        if self.sensitive:
            modulus_derivatives = derivatives[:, 1] - tangent * (derivatives[:2, 1].sum() / tangent[:2].sum())
            sensitivities = modulus_derivatives * (1 / values)
        return PathPoint(
            state.indentation,
            Outputs(values[:2], tangent[:2], sensitivities[:2]),
            Outputs(values[2:], tangent[2:], sensitivities[2:]) if len(values) > 2 else None,
            walls=max(0.0, equations.touches[0].min_gap),
            contact_radius=model.compute_contact_radius(equations, state),
            strain=model.elements.compute_max_stretch(state.elements.u),
            residual=equations.relative_residual,
            equilibrium=replace(equilibrium, equations=replace(equations, factor=None)),  # factors are large
            rates=model.compute_rates(state, equations, changes[:, 0]),
        )
