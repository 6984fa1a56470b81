"""Define the interface of evaluators, and the base class that computes results and curves from film forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Protocol

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_minimum_percent, format_percent
from geometry.common.resources import start_clock
from geometry.scenes.scene import Scene
from solver.linalg.workspace import Workspace, get_workspace, use_own_workspace
from solver.results.film_charges import (
    RATIO_FIELDS,
    compute_charge_fields,
    compute_charge_ratio_fields,
    explain_null_charges,
    warn_of_bonds,
    warn_of_read_bonds,
)
from solver.results.film_forces import FilmForces, check_moduli, compute_ratio_fields, compute_result_fields
from solver.results.result import Curve, Decision, ErrorKind, Result
from solver.results.warnings import Note, select_notes

ProgressCallback = Callable[[str], None]


def ignore_progress(text: str) -> None:
    """Ignore a line of progress: the callback of those who want none."""


class Evaluator(Protocol):
    """A model of one fidelity; the function ``create_evaluator(progress)`` in the module ``evaluator`` of its package makes it.

    Attributes
    ----------
    name
        The name on the command line.
    summary
        One line for ``--help``: what it models, its usual error and cost.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def summary(self) -> str: ...  # noqa: D102

    def refusal(self, scene: Scene) -> str | None:
        """Return the reason why this evaluator cannot take the scene, with the name of one that can; None if it can."""
        ...

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Evaluate to ``accuracy`` (relative, on ratio, stresses and stiffness), or as well as possible with a warning.

        Raises
        ------
        InputError
            A surface file that cannot be used.
        Refusal
            This evaluator cannot take this kind of scene, or its equations cannot be solved.
        """
        ...

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Evaluate as ``evaluate`` does, but refuse unless every error bound is at most ``allowed`` (by default ``accuracy``).

        Raises
        ------
        InputError, Refusal
            See ``evaluate``; also if the accuracy is out of reach.
        """
        ...

    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """Return ratio and log-sensitivity for every Young's modulus (Pa, shape (k,)) of the target inclusion.

        Raises
        ------
        InputError
            See ``evaluate``; there is no target, or a modulus is not positive and finite.
        Refusal
            See ``evaluate``.
        """
        ...


@dataclass(frozen=True)
class FilmSolution:
    """The film forces of a scene with their errors, at the target's modulus or at several.

    Attributes
    ----------
    films
        Film forces with their errors, one for each modulus.
    residual
        Largest relative residual of the linear systems solved; None where none is solved.
    plan
        Features that were modelled or left out.
    notes
        The evaluator's own warnings.
    stiffness
        Force on the base per indentation, N/m, where it is not the sum of the film forces; else None.
    error_kind
        Kind of the errors of ``films``: bounds or quantiles.
    """

    films: tuple[FilmForces, ...]
    residual: float | None = None
    plan: tuple[Decision, ...] = ()
    notes: tuple[Note, ...] = ()
    stiffness: float | None = None
    error_kind: ErrorKind = "bound"

    def build_result(self, name: str, scene: Scene, seconds: float) -> Result:
        """Return the result of evaluator ``name`` at the scene's own target modulus; ``seconds`` is the time that it took."""
        fields = compute_result_fields(scene, self.films[0]) | compute_charge_fields(scene, self.films[0])
        if self.stiffness is not None:
            fields["stiffness"] = self.stiffness
        films, warnings = self.films[0], fields.pop("warnings")  # those of the film forces first
        warnings = (*warnings, *warn_of_bonds(scene, films), *self.notes, *explain_null_charges(name, scene, films))
        fields |= {"observable": scene.observable, "error_kind": self.error_kind, "response": scene.load.response}
        return Result(name, seconds, **fields, residual=self.residual, plan=self.plan, warnings=warnings)

    def build_curve(self, name: str, scene: Scene, moduli: Floats, seconds: float) -> Curve:
        """Return the curve of evaluator ``name`` over moduli of the target, Pa, shape (k,); ``films`` has one entry for each."""
        rows = [compute_ratio_fields(scene, films) for films in self.films]
        values: JsonObject = {key: tuple(row[key] for row in rows) for key in ("ratio", "log_sensitivity", "error_estimate")}
        values["stiffness"] = tuple(float(films.totals.sum()) for films in self.films)
        if self.films[0].find_charges(scene) is not None:
            rows = [compute_charge_ratio_fields(scene, films) for films in self.films]
            values |= {key: tuple(row[key] for row in rows) for key in RATIO_FIELDS}
        values |= {"observable": scene.observable, "error_kind": self.error_kind, "response": scene.load.response}
        notes = [*warn_of_read_bonds(scene), *self.notes]
        notes += dict.fromkeys(note for films in self.films for note in explain_null_charges(name, scene, films))
        return Curve(name, seconds, tuple(moduli.tolist()), **values, plan=self.plan, warnings=tuple(notes))


@dataclass(frozen=True, kw_only=True)
class FilmEvaluator:
    """An evaluator that computes film forces: a subclass defines ``solve``, from which the methods of ``Evaluator`` follow.

    Attributes
    ----------
    workspace
        Where it keeps meshes and factors; by default the current one, usually the process's.
    """

    name: str
    workspace: Workspace = field(default_factory=get_workspace, compare=False, repr=False)

    def refusal(self, scene: Scene) -> str | None:
        """See ``Evaluator``."""
        raise NotImplementedError

    def check(self, scene: Scene) -> None:
        """Raise ``Refusal`` for a scene that this evaluator does not take."""
        reason = self.refusal(scene)
        if reason is not None:
            raise Refusal("evaluator", self.name, reason)

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Compute film forces at the target's modulus, or at all ``moduli`` (Pa); see ``Evaluator`` for what it raises."""
        raise NotImplementedError

    @use_own_workspace
    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """See ``Evaluator``."""
        start = perf_counter()
        with start_clock():
            solution = self.solve(scene, accuracy)
        return solution.build_result(self.name, scene, perf_counter() - start)

    def solve_many(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[FilmSolution | InputError]:
        """Solve each scene at its accuracy, or return its refusal; subclasses may solve scenes together to save time."""
        return [self._solve_or_refuse(scene, accuracy) for scene, accuracy in zip(scenes, accuracies, strict=True)]

    def _solve_or_refuse(self, scene: Scene, accuracy: float) -> FilmSolution | InputError:
        """Solve a scene, or return its refusal."""
        try:
            with start_clock():
                return self.solve(scene, accuracy)
        except InputError as fault:
            return fault

    @use_own_workspace
    def evaluate_many(self, scenes: Sequence[Scene], accuracy: float | Sequence[float] = 0.01) -> list[Result | InputError]:
        """Evaluate each scene as ``evaluate`` does; return its result or its refusal.

        All results have the same ``seconds``: the time of all, divided by their number.

        Parameters
        ----------
        scenes
            Scenes of any kind.
        accuracy
            One for all scenes, or one for each.
        """
        start = perf_counter()
        solutions = self.solve_many(scenes, accuracy if isinstance(accuracy, Sequence) else [accuracy] * len(scenes))
        seconds_each = (perf_counter() - start) / max(len(scenes), 1)
        return [self._build_result(solution, scene, seconds_each) for solution, scene in zip(solutions, scenes, strict=True)]

    def _build_result(self, solution: FilmSolution | InputError, scene: Scene, seconds: float) -> Result | InputError:
        """Build the result of a solution, or return the refusal that took its place or that building it raises."""
        try:
            return solution if isinstance(solution, InputError) else solution.build_result(self.name, scene, seconds)
        except InputError as fault:
            return fault

    @use_own_workspace
    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """See ``Evaluator``."""
        start = perf_counter()
        with start_clock():
            solution = self.solve(scene, accuracy)
        reached = solution.films[0].compute_max_error(scene)
        if reached > (accuracy if allowed is None else allowed):
            raise OutOfReach(self.name, scene, accuracy, reached, stopped=next(iter(select_notes(solution.notes, "limit")), ""))
        return solution.build_result(self.name, scene, perf_counter() - start)

    @use_own_workspace
    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """See ``Evaluator``."""
        start, moduli = perf_counter(), check_moduli(scene, moduli)
        with start_clock():
            solution = self.solve(scene, accuracy, moduli)
        return solution.build_curve(self.name, scene, moduli, perf_counter() - start)


class OutOfReach(Refusal):
    """Refusal of an accuracy that an evaluator does not reach.

    Attributes
    ----------
    name
        Name of the evaluator.
    scene, accuracy
        The arguments of its evaluation.
    reached
        The largest of its error bounds. At that accuracy the evaluator may refine less, and so miss it.
    stopped
        Text on the limit of memory or time that prevented a better result; empty where none did.
    allowed
        Text of the accuracy that would be accepted; by default made from ``reached``.
    reachable
        An accuracy that is reached; None where none is known.
    """

    def __init__(
        self, name: str, scene: Scene, accuracy: float, reached: float,
        *, stopped: str = "", allowed: str = "", reachable: float | None = None,
    ) -> None:  # fmt: skip
        self.name, self.scene, self.accuracy, self.reached, self.stopped = name, scene, accuracy, reached, stopped
        self.reachable = reachable
        reachable_text = format_minimum_percent(reached, 2)
        reason = f"{reachable_text} or more for this scene (--evaluator {name} returns its result with that error)"
        if reached >= 1:
            reason = f"none for this scene: errors are no smaller than the values (--evaluator {name} prints their bounds)"
        reason = allowed or reason
        super().__init__("accuracy", Words(format_percent(accuracy, 6)), f"{reason}; {stopped}" if stopped else reason)
