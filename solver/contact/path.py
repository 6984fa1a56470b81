"""Press a probe step by step: extrapolate states, adapt the steps to Newton's method, store all that converged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.contact.model import ContactModel
from solver.contact.newton import Equilibrium, solve
from solver.contact.pressed import Pressed, StoppedError
from solver.contact.states import State, hermite, lagrange, weighted

FIRST, LEAST, LONGEST = 0.02, 1e-3, 0.08  # steps: first and minimum in units of the path, maximum in outer radii
TINY = 1e-6  # in units: an indentation at which all is linear
LIGHT = 1e-4  # likewise where faces may open: gaps must exceed rounding errors
GROWTH, EASY = 1.8, 12  # steps grow by this factor after one that took this many Newton steps or fewer
EASY_FACES, LONGEST_FACES = 30, 0.02  # likewise, and maximum step in outer radii, where faces may open
DEEPEST = 1.0  # outer radii: the accuracy of deeper states was never checked
NEARLY = 1e-4  # of a requested force: the rest is extrapolated linearly
TRIES = 12
CLOSE = 0.1  # of the distance to extrapolate over: nearer points add little


@dataclass
class Path:
    """A load path: the states of a section under rising indentation.

    Attributes:
        model: model of the section.
        sensitive: whether derivatives with respect to the target's modulus are computed.
        linear: more accurate film forces per indentation at rest, N/m, shape (2,), or None. Their ratio to this mesh's corrects
            all forces on the path, by one factor for each film.
        points: the point at rest, then all that converged, by rising indentation.
        length: length of the next step, m.
    """

    model: ContactModel
    sensitive: bool
    linear: Floats | None = None
    points: list[Pressed] = field(default_factory=list)
    length: float = 0.0
    _begun: Equilibrium = field(init=False)
    _scale: Floats = field(default_factory=lambda: np.ones(2))

    def __post_init__(self) -> None:
        """Compute the first points: at rest, and under a very light load."""
        self.length = FIRST * self.unit
        rest = self.model.at_rest()
        small = self._light(rest)
        if self.linear is not None:
            self._scale = self.linear / self._pressed(small).tangent
        self._begun, linear = small, self._pressed(small)
        still = Equilibrium(rest, self.model.linearised(rest), ())
        gap, none = float(self.model.section.hole_radius - self.model.section.inner_radius), np.zeros(2)
        self.points.append(replace(linear, indentation=0.0, films=none, walls=gap, strain=0.0, residual=0.0, equilibrium=still))

    def seed(self, state: State) -> Pressed:
        """Start the path at a state of the same mesh with other moduli; see ``iterate_steps``."""
        try:
            point = self._pressed(solve(self.model, state))
        except SolveError as fault:
            raise StoppedError(self.last, f"no further step converges: {fault}") from fault
        self.points.append(point)
        return point

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
    def last(self) -> Pressed:
        """The deepest point computed."""
        return self.points[-1]

    def steps(self, until: float) -> Iterator[Pressed]:
        """Press to the indentation ``until``, m, and yield each point on the way.

        Raises:
            StoppedError: no further step converges.
            LimitReached: the time limit is reached.
        """
        while self.last.indentation < until * (1 - 1e-12):
            beyond = self.last.indentation + self.length
            yield self._step(until if beyond > until - 0.3 * self.length else beyond)

    def at_indentation(self, indentation: float) -> Pressed:
        """Return the point at an indentation, m; see ``iterate_steps``."""
        for _ in self.steps(indentation):
            pass
        near = min(self.points, key=lambda point: abs(point.indentation - indentation))
        return near if abs(near.indentation - indentation) <= 1e-12 * indentation else self.insert(indentation)

    def at_force(self, force: float) -> Pressed:
        """Return the point at a force, N; see ``iterate_steps``."""
        while self.last.force < force * (1 - NEARLY):
            self._step(self.last.indentation + min(self.length, self._further(force)))
        for _ in range(TRIES):
            near = min(self.points, key=lambda point: abs(point.force - force))
            rest = self._further(force)
            if abs(near.force - force) <= NEARLY * force:
                return replace(near, indentation=near.indentation + rest, films=near.films + rest * near.tangent)
            self.insert(near.indentation + rest)
        raise StoppedError(self.last, "no indentation gives the force")

    def _further(self, force: float) -> float:
        """Estimate the indentation of a force beyond the nearest point, m, from the stiffness at the two nearest points."""
        near, *others = sorted(self.points, key=lambda point: abs(point.force - force))[:2]
        missing, stiffness = force - near.force, float(near.tangent.sum())
        if not others:
            return missing / stiffness
        other = others[0]
        stiffening = (float(other.tangent.sum()) - stiffness) / (other.indentation - near.indentation)
        within = stiffness**2 + 2 * stiffening * missing
        return 2 * missing / (stiffness + within**0.5) if within > 0 else missing / stiffness

    def _step(self, indentation: float) -> Pressed:
        """Take one step towards an indentation, halved until it converges."""
        start, most = self.last.indentation, DEEPEST * self.radius
        if start >= most * (1 - 1e-9):
            raise StoppedError(self.last, "it is as deep as the probe is wide, and deeper solutions were never verified")
        step = min(indentation, most) - start
        while True:
            try:
                point = self._solved(start + step)
                break
            except SolveError as fault:
                step /= 2
                self.length = step
                if step <= 0.5 * LEAST * self.unit:
                    raise StoppedError(self.last, f"no further step converges: {fault}") from fault
        easy, longest = (EASY_FACES, LONGEST_FACES) if self.model.loose else (EASY, LONGEST)
        if len(point.equilibrium.residuals) <= easy:
            self.length = min(GROWTH * self.length, longest * self.radius)
        self.points.append(point)
        return point

    def insert(self, indentation: float) -> Pressed:
        """Compute a point between others and add it to the path.

        Raises:
            SolveError: see ``solver.contact.newton.solve``.
            LimitReached: the time limit is reached.
        """
        point = self._solved(indentation)
        self.points.append(point)
        self.points.sort(key=lambda one: one.indentation)
        return point

    def _solved(self, indentation: float) -> Pressed:
        try:
            return self._pressed(solve(self.model, self._ahead(indentation), known=self._known(indentation)))
        except SolveError:
            if not self.model.loose:
                raise
        # neighbours may differ in what touches and slides: one alone is sometimes the better start
        return self._pressed(solve(self.model, self._following(self._before(indentation), indentation)))

    @property
    def _target(self) -> Floats | None:
        return self.model.target if self.sensitive else None

    def _near(self, indentation: float) -> list[Pressed]:
        """Find the three nearest points that are not too close to each other, so that extrapolation amplifies no rounding."""
        near: list[Pressed] = []
        for point in sorted(self.points, key=lambda point: abs(point.indentation - indentation)):
            apart = CLOSE * abs(point.indentation - indentation)
            if len(near) < 3 and all(abs(point.indentation - other.indentation) > apart for other in near):
                near.append(point)
        return near

    def _ahead(self, indentation: float) -> State:
        """Extrapolate or interpolate the state at an indentation from the nearest points."""
        near = self._near(indentation)
        states = [point.equilibrium.state for point in near]
        if len(states) < 2:
            return self._proportional(indentation) if self.model.loose else self._following(states[0], indentation)
        places = [state.indentation for state in states]
        guess = weighted(lagrange(places, indentation), states)
        if not self.model.loose and not any(state.touching.any() for state in states):
            # use rates only without contact: with contact they lead to another equilibrium of a folding corner
            guess = weighted(hermite(places[:2], indentation), [*states[:2], *(point.rates for point in near[:2])])
        if self.model.elements.least_volume(guess.elements.u) <= 0:
            return self._following(states[0], indentation)
        return replace(guess, indentation=indentation, grips=self._before(indentation).grips)

    def _known(self, indentation: float) -> bool:
        """Return whether the same points touch in all nearest states, so that multipliers can be extrapolated."""
        touching = [point.equilibrium.state.touching for point in self._near(indentation)]
        alike = all(np.array_equal(touching[0], other) for other in touching[1:])
        return not self.model.loose and len(touching) > 2 and bool(touching[0].any()) and alike

    def _before(self, indentation: float) -> State:
        """Return the last state below an indentation; friction depends on it."""
        on_the_way = [point.equilibrium.state for point in self.points if point.indentation <= indentation]
        return on_the_way[-1]

    def _light(self, rest: State) -> Equilibrium:
        """Solve for a very light load, under which faces that may open are open."""
        state = self._following(rest, (LIGHT if self.model.loose else TINY) * self.unit)
        if not self.model.loose:
            return Equilibrium(state, self.model.linearised(state), ())
        closed = tuple(one.pressure for one in self.model.touches(state))
        return solve(self.model, replace(state, multipliers=closed))

    def _proportional(self, indentation: float) -> State:
        """Scale the light-load state to a small indentation, where all is proportional and the contact does not change."""
        state = self._begun.state
        factor = indentation / state.indentation
        grips = tuple(None if grip is None else replace(grip, shear=factor * grip.shear) for grip in state.grips)
        grown = replace(state, multipliers=tuple(factor * m for m in state.multipliers), grips=grips)
        return self._following(grown, indentation)

    def _following(self, state: State, indentation: float) -> State:
        """Return the state at an indentation on the tangent of another state."""
        at = self.model.linearised(state)
        changes, _ = self.model.responses(state, at)
        return self.model.shifted(state, at, (indentation - state.indentation) * changes[:, 0], indentation)

    def _pressed(self, found: Equilibrium) -> Pressed:
        """Compute the results at a state.

        At constant force F the base follows a stiffer target, of Young's modulus E, by -(dF/d ln E) / (dF/d indentation) (CT.7).
        """
        model, at, state = self.model, found.at, found.state
        model.check_base(state)
        changes, slopes = model.responses(state, at, self._target)
        films, slopes = self._scale * model.film_forces(at), self._scale[:, None] * slopes
        sensitivity = 0.0
        if self.sensitive:
            by_modulus = slopes[:, 1] - slopes[:, 0] * (slopes[:, 1].sum() / slopes[:, 0].sum())
            sensitivity = float(by_modulus @ ([1, -1] / films))
        return Pressed(
            state.indentation,
            films,
            slopes[:, 0],
            sensitivity,
            walls=max(0.0, at.touches[0].closest),
            contact_radius=model.contact_radius(at, state),
            strain=model.elements.largest_stretch(state.elements.u),
            residual=at.unbalanced,
            equilibrium=replace(found, at=replace(at, factor=None)),  # factors are large
            rates=model.rates(state, at, changes[:, 0]),
        )
