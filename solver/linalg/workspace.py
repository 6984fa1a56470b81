"""Cache meshes, patterns, factors and solved probes from one scene to the next, within a limit of bytes.

An evaluator owns a workspace and works in it, ``with use_workspace(workspace):``. Functions below it that are decorated with
``keep_result`` keep their results there. Outside any workspace, the process's own is used; an evaluator that is given none takes
the one in which it is made. Values used longest ago are dropped first. Values of the current evaluation stay while it runs, so
that another tumour under the same probe costs little. So a workspace holds its limit, or the values of the last evaluation if
these are more.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, wraps
from threading import RLock
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from geometry.common.errors import InputError
from geometry.common.resources import get_limits
from solver.linalg.memory import give_back

LIMIT_VARIABLE = "PROBE_DESIGN_MEMORY"  # the environment variable: GB that the process's workspace may hold
DEFAULT_LIMIT_GB = 1.0  # GB
MAX_GROWTH_FACTOR = 4.0  # most that values may have grown since they were measured, as patterns do with their factors
FREE_SHARE = 0.25  # of the limit, made free where values are dropped: measuring hundreds of them takes longer than an evaluation
P = ParamSpec("P")
T = TypeVar("T")


@dataclass
class _Entry:
    """A value, its bytes when last measured, whether that size is fixed, and the evaluations that last used and measured it."""

    value: Any
    bytes: int
    fixed: bool
    used: int
    measured: int

    @property
    def max_bytes(self) -> float:
        """Most bytes that the value may have by now: it grows only where it is used."""
        return self.bytes if self.fixed or self.used < self.measured else MAX_GROWTH_FACTOR * self.bytes


class Workspace:
    """Values by key, those used last at the end, within a limit of bytes."""

    def __init__(self, limit: float = DEFAULT_LIMIT_GB * 1e9) -> None:
        """Make an empty workspace for ``limit`` bytes."""
        self.limit = limit
        self._entries: dict[Hashable, _Entry] = {}  # no OrderedDict, which hashes all keys where its values are listed
        self._evaluation, self._lock = 0, RLock()

    @property
    def bytes_held(self) -> int:
        """Bytes of all values; arrays that several values share are counted once."""
        with self._lock:
            return self._measure()

    def measure_with(self, value: Any) -> int:
        """Return the bytes of all values and of another, which may be one of them; arrays of several are counted once."""
        with self._lock:
            counted: set[int] = set()
            return self._measure(counted) + measure_bytes(value, counted)

    def clear(self) -> None:
        """Drop all values."""
        with self._lock:
            self._entries.clear()
        give_back()

    def begin(self) -> None:
        """Begin an evaluation: values from earlier ones may be dropped from now on."""
        self._evaluation += 1
        give_back(self.limit)  # less freed memory stays with the C library: new pages took a quarter of an evaluation

    def keep(self, key: Hashable, make: Callable[[], T], fixed: bool = False) -> T:
        """Return the value under a key; compute it if there is none.

        Parameters
        ----------
        key
            Name of the value.
        make
            Function that computes it.
        fixed
            Whether the value never grows and shares no arrays with others, so that its bytes are measured only once.
        """
        with self._lock:
            entry = self._entries.get(key)
            if entry is not None:
                self._entries[key] = self._entries.pop(key)  # to the end
                entry.used = self._evaluation
                return entry.value  # type: ignore[no-any-return]
        value = make()
        with self._lock:
            self._entries[key] = _Entry(value, measure_bytes(value), fixed, self._evaluation, self._evaluation)
            if sum(item.bytes for item in self._entries.values()) > self.limit:
                self.make_room()
        return value

    def make_room(self, wanted: float = 0.0) -> None:
        """Drop values that this evaluation has not used, oldest first, where ``wanted`` bytes more are not within the limit.

        As many go as free a quarter of the limit, ``FREE_SHARE``, so that this is seldom necessary.
        """
        with self._lock:
            if sum(entry.max_bytes for entry in self._entries.values()) + wanted <= self.limit:
                return  # even grown values fit: measuring them again takes as long as assembling a small mesh
            self._measure_used()
            if sum(entry.bytes for entry in self._entries.values()) + wanted <= self.limit:
                return
            held = self._measure()
            for key in [key for key, entry in self._entries.items() if entry.used != self._evaluation]:
                if held + wanted <= (1 - FREE_SHARE) * self.limit:
                    break
                held -= self._entries.pop(key).bytes
        give_back(self.limit)

    def _measure_used(self) -> None:
        """Measure again the values that may have grown; arrays that they share with others are counted twice."""
        counted: set[int] = set()
        for entry in self._entries.values():
            if not entry.fixed and entry.used >= entry.measured:
                entry.bytes, entry.measured = measure_bytes(entry.value, counted), self._evaluation

    def _measure(self, counted: set[int] | None = None) -> int:
        """Measure all values again, as some grow, and return their bytes in all; ``counted`` as of ``measure_bytes``.

        An array that several share is counted with the value used last.
        """
        counted = set() if counted is None else counted
        for entry in reversed(self._entries.values()):
            if not entry.fixed:
                entry.bytes, entry.measured = measure_bytes(entry.value, counted), self._evaluation
        return sum(entry.bytes for entry in self._entries.values())


def measure_bytes(value: Any, counted: set[int] | None = None) -> int:
    """Return the bytes of all arrays that a value refers to, plus the ``foreign_bytes`` that libraries hold for it.

    Parameters
    ----------
    value
        Any object, container or array.
    counted
        Identities of objects that are already counted; new ones are added.
    """
    counted, total, queue = set() if counted is None else counted, 0, [value]
    while queue:
        item = queue.pop()
        while isinstance(item, np.ndarray) and isinstance(item.base, np.ndarray):
            item = item.base  # a view holds the whole
        if id(item) in counted:
            continue
        counted.add(id(item))
        if isinstance(item, np.ndarray):
            total += item.nbytes
        elif isinstance(item, dict):
            queue.extend(item.values())
        elif isinstance(item, list | tuple | set):
            queue.extend(item)
        elif not isinstance(item, type) and hasattr(item, "__dict__"):
            total += getattr(item, "foreign_bytes", 0)
            queue.extend(vars(item).values())
    return total


_CURRENT_WORKSPACE: ContextVar[Workspace | None] = ContextVar("workspace", default=None)


@contextmanager
def use_workspace(workspace: Workspace) -> Iterator[Workspace]:
    """Use a workspace within the context."""
    token = _CURRENT_WORKSPACE.set(workspace)
    try:
        yield workspace
    finally:
        _CURRENT_WORKSPACE.reset(token)


def get_workspace() -> Workspace:
    """Return the current workspace: the process's own outside ``use_workspace``."""
    return _CURRENT_WORKSPACE.get() or get_process_workspace()


class Owner(Protocol):
    """An object with its own workspace."""

    @property
    def workspace(self) -> Workspace: ...  # noqa: D102


Owning = TypeVar("Owning", bound=Owner)


def use_own_workspace(method: Callable[Concatenate[Owning, P], T]) -> Callable[Concatenate[Owning, P], T]:
    """Decorate a method so that it uses the workspace of its object."""

    @wraps(method)
    def run(self: Owning, /, *args: P.args, **named: P.kwargs) -> T:
        """Call the method within the workspace of its object."""
        with use_workspace(self.workspace):
            return method(self, *args, **named)

    return run


@cache
def get_process_workspace() -> Workspace:
    """Return the process's workspace, which evaluators without one of their own use.

    Raises
    ------
    InputError
        ``PROBE_DESIGN_MEMORY`` is not a number of GB.
    """
    given = os.environ.get(LIMIT_VARIABLE, f"{DEFAULT_LIMIT_GB:g}")
    try:
        limit = float(given)
    except ValueError:
        limit = -1.0
    if not 0 <= limit < float("inf"):
        raise InputError(LIMIT_VARIABLE, given, "a number of GB, such as 0.5")
    return Workspace(1e9 * limit)


def keep_result(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that its results are kept in the current workspace, by its hashable arguments."""
    return _keep(function)


def keep_within_limits(function: Callable[P, T]) -> Callable[P, T]:
    """Keep results as ``keep_result`` does, but separately for each limit of memory and time, on which they may depend."""
    return _keep(function, get_circumstances=get_limits)


def keep_table(function: Callable[P, T]) -> Callable[P, T]:
    """Keep results as ``keep_result`` does, but measure their size once: for the many tables, which do not grow."""
    return _keep(function, fixed=True)


def _keep(
    function: Callable[P, T], get_circumstances: Callable[[], Hashable] = lambda: None, fixed: bool = False
) -> Callable[P, T]:
    """Decorate a function so that its results are kept in the current workspace.

    Parameters
    ----------
    function
        A function of hashable arguments.
    get_circumstances
        Function that returns what results depend on besides their arguments.
    fixed
        See ``Workspace.keep``.
    """

    @wraps(function)
    def look_up(*args: P.args, **named: P.kwargs) -> T:
        """Return the kept result for these arguments; call the function if there is none."""
        key = (function, get_circumstances(), args, tuple(named.items()))
        return get_workspace().keep(key, lambda: function(*args, **named), fixed)

    return look_up
