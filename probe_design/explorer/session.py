"""The state of one page: the design, undo and redo, the designs that are kept, and the address that holds all changes."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic
from urllib.parse import parse_qsl, urlencode

from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from probe_design.explorer.variables import Variable, get_value, list_variables

KEPT_NAMES = ("A", "B", "C")
MAX_HISTORY = 200  # steps of undo
SAME_DRAG_S = 1.0  # s: changes of the same number within this time are one step of undo
MAX_ADDRESS_LENGTH = 4000  # characters
SAME_NUMBER_RELATIVE = 1e-5  # of numbers that are written with six digits


@dataclass
class Session:
    """The design of a page.

    Attributes
    ----------
    start
        The scene named at the start.
    variables
        What the page varies.
    changes
        Changes of the start by key, as a scene file writes them.
    scene
        The present design: the last one that was allowed.
    """

    start: Scene
    variables: dict[str, Variable] = field(init=False)
    changes: dict[str, str] = field(default_factory=dict)
    scene: Scene = field(init=False)
    _past: list[dict[str, str]] = field(default_factory=list)
    _future: list[dict[str, str]] = field(default_factory=list)
    _last: tuple[tuple[str, ...], float] = ((), 0.0)
    _waiting: dict[tuple[str, ...], dict[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.variables = {variable.key: variable for variable in list_variables(self.start)}
        self.scene = self.start

    def propose(self, entries: dict[str, str]) -> None:
        """Remember changes for ``settle``; of a flood of changes of the same numbers the last ones."""
        self._waiting[tuple(entries)] = entries

    def settle(self) -> str:
        """Carry out the changes that were proposed; return why one is refused, or an empty text."""
        waiting, self._waiting, reason = self._waiting, {}, ""
        for entries in waiting.values():
            try:
                self.change(entries)
            except InputError as refusal:
                reason = str(refusal)
        return reason

    def change(self, entries: dict[str, str]) -> None:
        """Change numbers of the design, given as typed.

        Raises
        ------
        InputError
            There is no such number, or the design is not allowed; the present one then stays.
        """
        for key in entries:
            if key not in self.variables:
                raise InputError("variable", key[:80], "a number that the page shows")
        texts = {key: self.variables[key].read_text(text) for key, text in entries.items()}
        changes = self.changes | texts
        self.scene = self._apply(changes)
        names, now = tuple(sorted(texts)), monotonic()
        if names != self._last[0] or now - self._last[1] > SAME_DRAG_S:
            self._past = [*self._past, self.changes][-MAX_HISTORY:]
        self._last, self._future, self.changes = (names, now), [], changes

    def adopt(self, scene: Scene) -> list[str]:
        """Make the numbers of a scene the present ones; return the keys of the probe's numbers that the page cannot take over.

        Raises
        ------
        InputError
            The design is not allowed; the present one then stays.
        """
        values = {key: value for key in self.variables if (value := get_value(scene, key)) is not None}
        probe = scene.probe  # another scene may state the same sizes by other keys
        values |= {key: value for key, value in {
            "probe.area_ratio": probe.inner_area / probe.outer_area, "probe.outer_radius": probe.tube_radius,
            "probe.inner_height": probe.core_height, "probe.outer_height": probe.tube_height,
        }.items() if key in self.variables and key not in values}  # fmt: skip
        self._last = ((), 0.0)  # a step of its own
        self.change({key: self.variables[key].format_value(value) for key, value in values.items()})
        present, wanted = list_values(self.scene), list_values(scene)
        return [
            key for key in present.keys() & wanted.keys()
            if key.startswith("probe.") and abs(present[key] - wanted[key]) > SAME_NUMBER_RELATIVE * abs(wanted[key])
        ]  # fmt: skip

    def _apply(self, changes: dict[str, str]) -> Scene:
        """Return the start with changes. Raises ``InputError``."""
        values: dict[str, str | float] = dict(changes)
        for key, text in changes.items():
            if not self.variables[key].unit:
                with suppress(ValueError):  # refused by the scene, as any text is
                    values[key] = float(text)
        return self.start.replace(values)

    def undo(self) -> bool:
        """Return to the design before the last change; False where there is none."""
        return self._step(self._past, self._future)

    def redo(self) -> bool:
        """Repeat the change that was undone last; False where there is none."""
        return self._step(self._future, self._past)

    def _step(self, source: list[dict[str, str]], target: list[dict[str, str]]) -> bool:
        """Take the last changes of one list, and put the present ones on the other."""
        if not source:
            return False
        target.append(self.changes)
        self.changes = source.pop()
        self.scene, self._last = self._apply(self.changes), ((), 0.0)
        return True

    @property
    def fragment(self) -> str:
        """The changes as the fragment of the page's address, without #."""
        return urlencode(self.changes)

    def read_fragment(self, fragment: str) -> None:
        """Make the design that an address holds the present one. Raises ``InputError`` where it is not allowed."""
        if len(fragment) > MAX_ADDRESS_LENGTH:
            raise InputError("address", Words(f"{len(fragment)} characters"), f"at most {MAX_ADDRESS_LENGTH} characters")
        entries = dict(parse_qsl(fragment))
        if entries:
            self.change(entries)
