"""What a level of fidelity is, and the one place where film forces become what it returns."""

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
    """Tell nobody."""


class Evaluator(Protocol):
    """One level of fidelity; the module ``level`` of its room makes it by ``level(tell)``.

    Attributes:
        name: as on the command line.
        summary: one line for ``--help``: what it models, its usual error and cost.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def summary(self) -> str: ...  # noqa: D102

    def refusal(self, scene: Scene) -> str | None:
        """Say which evaluator can take what in the scene is of a *kind* that this level cannot, or None if it can."""
        ...

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Answer to within ``accuracy`` (relative, on ratio, stresses and stiffness), or as well as possible with a warning.

        Raises:
            InputError: a surface file that cannot be used.
            Refusal: the scene is of a kind that this level cannot take, or its equations cannot be solved.
        """
        ...

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Answer as ``evaluate`` does, but only if every bound is at most ``allowed``, or ``accuracy`` where that is left out.

        Raises:
            InputError, Refusal: see ``evaluate``; and where the accuracy is out of reach.
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
    """What a level finds of a scene, at the target's modulus or at several.

    Attributes:
        films: film forces with their errors, one for each modulus.
        residual: relative, the largest of the solutions behind them; None where none is solved for.
        plan: what was modelled and what was left out.
        notes: warnings of the level's own.
        stiffness: N/m, where it is not the sum of the film forces.
    """

    films: tuple[FilmForces, ...]
    residual: float | None = None
    plan: tuple[Decision, ...] = ()
    notes: tuple[Note, ...] = ()
    stiffness: float | None = None

    def result(self, name: str, scene: Scene, seconds: float) -> Result:
        """Return the level's result for the scene's own target."""
        fields = outputs(scene, self.films[0])
        if self.stiffness is not None:
            fields["stiffness"] = self.stiffness
        warnings = (*fields.pop("warnings"), *self.notes)
        return Result(name, seconds, **fields, residual=self.residual, plan=self.plan, warnings=warnings)

    def curve(self, name: str, scene: Scene, moduli: Floats, seconds: float) -> Curve:
        """Return the level's curve over moduli, Pa, shape (k,)."""
        rows = [ratio(scene, films) for films in self.films]
        values: dict[str, Any] = {key: tuple(row[key] for row in rows) for key in ("ratio", "log_sensitivity", "error_estimate")}
        values["stiffness"] = tuple(float(films.totals.sum()) for films in self.films)
        return Curve(name, seconds, tuple(moduli.tolist()), **values, plan=self.plan, warnings=self.notes)


@dataclass(frozen=True, kw_only=True)
class FilmLevel:
    """A level that finds film forces: a subclass says how, by ``answer``; see ``Evaluator`` for what it then has.

    Attributes:
        workspace: where it keeps what the next scene may need; left out: the one that is worked in, usually the process's.
    """

    name: str
    workspace: Workspace = field(default_factory=current, compare=False, repr=False)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Return what is found at the target's modulus, or at all ``moduli`` (Pa); see ``Evaluator`` for what it raises."""
        raise NotImplementedError

    @in_own_workspace
    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """See ``Evaluator``."""
        start = perf_counter()
        with timed():
            answer = self.answer(scene, accuracy)
        return answer.result(self.name, scene, perf_counter() - start)

    def answers(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[Answer | InputError]:
        """Return what ``answer`` finds of each scene at its accuracy, or its refusal; levels that gain by it answer together."""
        return [self._alone(scene, accuracy) for scene, accuracy in zip(scenes, accuracies, strict=True)]

    def _alone(self, scene: Scene, accuracy: float) -> Answer | InputError:
        try:
            with timed():
                return self.answer(scene, accuracy)
        except InputError as fault:
            return fault

    @in_own_workspace
    def evaluate_many(self, scenes: Sequence[Scene], accuracy: float | Sequence[float] = 0.01) -> list[Result | InputError]:
        """Return for each scene what ``evaluate`` returns, or the refusal it raises; ``seconds`` are shared out evenly.

        Args:
            scenes: any.
            accuracy: of all, or of each.
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
    """An accuracy that a level does not reach.

    Attributes:
        name: of the level.
        scene, accuracy: what it was asked.
        reached: the largest bound on its errors; asked for that, it may refine less and reach less.
        stopped: which limit of memory or time forbade more; empty where none did.
        allowed: what would be, where more than the level's own bound is known of that.
    """

    def __init__(self, name: str, scene: Scene, accuracy: float, reached: float, *, stopped: str = "", allowed: str = "") -> None:
        self.name, self.scene, self.accuracy, self.reached, self.stopped = name, scene, accuracy, reached, stopped
        why = f"{least(reached, 2)} or more for this scene (--evaluator {name} answers with that error)"
        if reached >= 1:
            why = f"none for this scene: errors are no smaller than the values (--evaluator {name} tells which)"
        why = allowed or why
        super().__init__("accuracy", accuracy, f"{why}; {stopped}" if stopped else why)
