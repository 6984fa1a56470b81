"""The interface of evaluators, and the base class that turns film forces into results and curves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Protocol

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.common.limits import least
from geometry.common.resources import timed
from geometry.scenes.scene import Scene
from solver.linalg.workspace import Workspace, current, in_own_workspace
from solver.results.film_forces import FilmForces, checked_moduli, outputs, ratio
from solver.results.result import Curve, Decision, Result
from solver.results.warnings import Note, of_kind

Tell = Callable[[str], None]


def silent(text: str) -> None:
    """Ignore a line of progress."""


class Evaluator(Protocol):
    """A model of one fidelity; the module ``level`` of its package makes it by ``level(tell)``.

    Attributes:
        name: as on the command line.
        summary: one line for ``--help``: what it models, its usual error and cost.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def summary(self) -> str: ...  # noqa: D102

    def refusal(self, scene: Scene) -> str | None:
        """Return why this evaluator cannot take the scene, with the name of one that can; None where it can."""
        ...

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Evaluate to ``accuracy`` (relative, on ratio, stresses and stiffness), or as well as possible with a warning.

        Raises:
            InputError: a surface file that cannot be used.
            Refusal: this evaluator cannot take this kind of scene, or its equations cannot be solved.
        """
        ...

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Evaluate as ``evaluate`` does, but refuse unless every error bound is at most ``allowed`` (by default ``accuracy``).

        Raises:
            InputError, Refusal: see ``evaluate``; also if the accuracy is out of reach.
        """
        ...

    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """Return ratio and log-sensitivity for every Young's modulus (Pa, shape (k,)) of the target inclusion.

        Raises:
            InputError: see ``evaluate``; there is no target, or a modulus is not positive and finite.
            Refusal: see ``evaluate``.
        """
        ...


@dataclass(frozen=True)
class Answer:
    """The film forces of a scene with their errors, at the target's modulus or at several.

    Attributes:
        films: film forces with their errors, one for each modulus.
        residual: relative, the largest of the linear systems solved; None where none is solved.
        plan: what was modelled and what was left out.
        notes: the evaluator's own warnings.
        stiffness: N/m, where it is not the sum of the film forces.
    """

    films: tuple[FilmForces, ...]
    residual: float | None = None
    plan: tuple[Decision, ...] = ()
    notes: tuple[Note, ...] = ()
    stiffness: float | None = None

    def result(self, name: str, scene: Scene, seconds: float) -> Result:
        """Return the result at the scene's own target modulus."""
        fields = outputs(scene, self.films[0])
        if self.stiffness is not None:
            fields["stiffness"] = self.stiffness
        warnings = (*fields.pop("warnings"), *self.notes)
        return Result(name, seconds, **fields, residual=self.residual, plan=self.plan, warnings=warnings)

    def curve(self, name: str, scene: Scene, moduli: Floats, seconds: float) -> Curve:
        """Return the curve over moduli of the target, Pa, shape (k,)."""
        rows = [ratio(scene, films) for films in self.films]
        values: dict[str, Any] = {key: tuple(row[key] for row in rows) for key in ("ratio", "log_sensitivity", "error_estimate")}
        values["stiffness"] = tuple(float(films.totals.sum()) for films in self.films)
        return Curve(name, seconds, tuple(moduli.tolist()), **values, plan=self.plan, warnings=self.notes)


@dataclass(frozen=True, kw_only=True)
class FilmLevel:
    """An evaluator that computes film forces: a subclass defines ``solve``, from which the methods of ``Evaluator`` follow.

    Attributes:
        workspace: where it keeps meshes and factors; by default the current one, usually the process's.
    """

    name: str
    workspace: Workspace = field(default_factory=current, compare=False, repr=False)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Compute film forces at the target's modulus, or at all ``moduli`` (Pa); see ``Evaluator`` for what it raises."""
        raise NotImplementedError

    @in_own_workspace
    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """See ``Evaluator``."""
        start = perf_counter()
        with timed():
            answer = self.answer(scene, accuracy)
        return answer.result(self.name, scene, perf_counter() - start)

    def answers(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[Answer | InputError]:
        """Solve each scene at its accuracy, or return its refusal; subclasses may solve scenes together to save time."""
        return [self._alone(scene, accuracy) for scene, accuracy in zip(scenes, accuracies, strict=True)]

    def _alone(self, scene: Scene, accuracy: float) -> Answer | InputError:
        try:
            with timed():
                return self.answer(scene, accuracy)
        except InputError as fault:
            return fault

    @in_own_workspace
    def evaluate_many(self, scenes: Sequence[Scene], accuracy: float | Sequence[float] = 0.01) -> list[Result | InputError]:
        """Return for each scene what ``evaluate`` returns, or the refusal it raises; ``seconds`` are divided evenly.

        Args:
            scenes: scenes of any kind.
            accuracy: one for all scenes, or one for each.
        """
        start = perf_counter()
        every = self.answers(scenes, accuracy if isinstance(accuracy, Sequence) else [accuracy] * len(scenes))
        share = (perf_counter() - start) / max(len(scenes), 1)
        return [self._result(answer, scene, share) for answer, scene in zip(every, scenes, strict=True)]

    def _result(self, answer: Answer | InputError, scene: Scene, seconds: float) -> Result | InputError:
        try:
            return answer if isinstance(answer, InputError) else answer.result(self.name, scene, seconds)
        except InputError as fault:
            return fault

    @in_own_workspace
    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """See ``Evaluator``."""
        start = perf_counter()
        with timed():
            answer = self.answer(scene, accuracy)
        reached = answer.films[0].error_under(scene)
        if reached > (accuracy if allowed is None else allowed):
            raise OutOfReach(self.name, scene, accuracy, reached, stopped=next(iter(of_kind(answer.notes, "limit")), ""))
        return answer.result(self.name, scene, perf_counter() - start)

    @in_own_workspace
    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """See ``Evaluator``."""
        start, moduli = perf_counter(), checked_moduli(scene, moduli)
        with timed():
            answer = self.answer(scene, accuracy, moduli)
        return answer.curve(self.name, scene, moduli, perf_counter() - start)


class OutOfReach(Refusal):
    """Refusal of an accuracy that an evaluator does not reach.

    Attributes:
        name: name of the evaluator.
        scene, accuracy: its arguments.
        reached: the largest of its error bounds. At that accuracy the evaluator may refine less, and so miss it.
        stopped: which limit of memory or time prevented a better result; empty where none did.
        allowed: text of the accuracy that would be accepted; by default made from ``reached``.
    """

    def __init__(self, name: str, scene: Scene, accuracy: float, reached: float, *, stopped: str = "", allowed: str = "") -> None:
        self.name, self.scene, self.accuracy, self.reached, self.stopped = name, scene, accuracy, reached, stopped
        why = f"{least(reached, 2)} or more for this scene (--evaluator {name} answers with that error)"
        if reached >= 1:
            why = f"none for this scene: errors are no smaller than the values (--evaluator {name} prints their bounds)"
        why = allowed or why
        super().__init__("accuracy", accuracy, f"{why}; {stopped}" if stopped else why)
