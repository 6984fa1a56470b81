"""Define warnings: texts for people that carry a kind for programs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

Kind = Literal["null", "accuracy", "sensitivity", "left_out", "linear", "limit", "published", "skin", "doubt", "bond", "law"]


class Note(str):
    """One line of warning: a string with a kind, so that no program has to parse the text.

    Attributes
    ----------
    kind
        "null", a value is None; "accuracy", an error bound is above the accuracy; "sensitivity", the log-sensitivity is None or
        less accurate than intended; "left_out", a detail counted in the error; "linear", the load is beyond linear elasticity;
        "limit", what the limits of memory and time prevented; "published", what is wrong in the paper; "skin", what a skin would
        change of tissue without layers; "doubt", a number of the scene that is probably a slip; "bond", a film whose bonds the
        scene does not give; "law", a material strained beyond the curve that its law was fitted to.
    """

    __slots__ = ("kind",)
    kind: Kind

    def __new__(cls, kind: Kind, text: str) -> Note:
        """Return the text with its kind."""
        note = super().__new__(cls, text)
        note.kind = kind
        return note

    def __getnewargs__(self) -> tuple[Kind, str]:  # type: ignore[override]  # copies and pickles keep the kind
        """Return the arguments from which a copy or pickle is made."""
        return self.kind, str(self)


def select_notes(notes: Iterable[Note], kind: Kind) -> tuple[Note, ...]:
    """Return the notes of one kind, in order."""
    return tuple(note for note in notes if note.kind == kind)


def explain_null_sensitivity(inclusions: int) -> Note:
    """Return the warning that a scene without a target has no log-sensitivity; ``inclusions`` is the number it has."""
    reason = "several inclusions and none marked target = true" if inclusions else "the scene has no inclusion"
    return Note("sensitivity", f"log_sensitivity is null: {reason}")
