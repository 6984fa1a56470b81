"""What evaluators keep from one scene to the next: meshes, patterns, factors, solved probes; within a limit of bytes.

An evaluator owns a workspace and works in it, ``with using(workspace):``, and everything below it keeps there what it may be
asked for again, by ``kept``. Outside any, the process's own is used, and an evaluator that is given none takes the one it is made
in. What was used longest ago goes first, and what an evaluation itself uses stays while it runs: it is alive anyway, and another
tumour under the same probe then costs little. So a workspace holds its limit or what the last evaluation needed, whichever is
more.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, wraps
from threading import RLock
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from geometry.common.errors import InputError
from geometry.common.resources import limits
from solver.linalg.memory import give_back

LIMIT = "PROBE_DESIGN_MEMORY"  # the environment variable: GB that the process's workspace may hold
USUAL = 1.0  # GB
GROWN = 4.0  # times: what values may have grown since they were measured, at most: patterns to which factors were added
WORTH_GIVING_BACK = 1e8  # bytes: until then the C library keeps what is freed, as new pages cost time
P = ParamSpec("P")
T = TypeVar("T")


@dataclass
class _Entry:
    """A value, its bytes when it was last measured, whether it is once and for all, and the evaluation that used it last."""

    value: Any
    bytes: int
    fixed: bool
    used: int


class Workspace:
    """Values by key, those used last at the end."""

    def __init__(self, limit: float = USUAL * 1e9) -> None:
        """Hold ``limit`` bytes."""
        self.limit = limit
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._evaluation, self._lock = 0, RLock()

    @property
    def bytes_held(self) -> int:
        """All that is held, arrays that several values share counted once."""
        with self._lock:
            return self._measure()

    def clear(self) -> None:
        """Hold nothing."""
        with self._lock:
            self._entries.clear()
        give_back()

    def begin(self) -> None:
        """Begin an evaluation: what is held from before it may go from now on."""
        self._evaluation += 1
        give_back(WORTH_GIVING_BACK)

    def keep(self, key: Hashable, make: Callable[[], T], fixed: bool = False) -> T:
        """Return what is held under a key, made now if there is none; ``fixed`` is what neither grows nor shares arrays."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is not None:
                self._entries.move_to_end(key)
                entry.used = self._evaluation
                return entry.value  # type: ignore[no-any-return]
        value = make()
        with self._lock:
            self._entries[key] = _Entry(value, size(value), fixed, self._evaluation)
            if sum(one.bytes for one in self._entries.values()) > self.limit:
                self.make_room()
        return value

    def make_room(self, wanted: float = 0.0) -> None:
        """Let go, oldest first, of what this evaluation has not used, until ``wanted`` bytes more are within the limit."""
        with self._lock:
            if GROWN * sum(one.bytes for one in self._entries.values()) + wanted <= self.limit:
                return  # measuring takes as long as adding up a small mesh
            held = self._measure()
            for key in [key for key, one in self._entries.items() if one.used != self._evaluation]:
                if held + wanted <= self.limit:
                    break
                held -= self._entries.pop(key).bytes
        give_back(WORTH_GIVING_BACK)

    def _measure(self) -> int:
        """Measure values anew, as some grow: what several share is counted with the one that was used last."""
        seen: set[int] = set()
        for entry in reversed(self._entries.values()):
            if not entry.fixed:
                entry.bytes = size(entry.value, seen)
        return sum(entry.bytes for entry in self._entries.values())


def size(value: Any, seen: set[int] | None = None) -> int:
    """Return the bytes of all arrays that a value leads to, and what libraries hold for it, its ``foreign_bytes``.

    Args:
        value: any: objects, containers, arrays.
        seen: what is counted already, by identity; it is added to.
    """
    seen, total, left = set() if seen is None else seen, 0, [value]
    while left:
        one = left.pop()
        while isinstance(one, np.ndarray) and isinstance(one.base, np.ndarray):
            one = one.base  # a view holds the whole
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, np.ndarray):
            total += one.nbytes
        elif isinstance(one, dict):
            left.extend(one.values())
        elif isinstance(one, list | tuple | set):
            left.extend(one)
        elif not isinstance(one, type) and hasattr(one, "__dict__"):
            total += getattr(one, "foreign_bytes", 0)
            left.extend(vars(one).values())
    return total


_CURRENT: ContextVar[Workspace | None] = ContextVar("workspace", default=None)


@contextmanager
def using(workspace: Workspace) -> Iterator[Workspace]:
    """Work in a workspace."""
    token = _CURRENT.set(workspace)
    try:
        yield workspace
    finally:
        _CURRENT.reset(token)


def current() -> Workspace:
    """Return the workspace that is worked in: the process's own outside ``using``."""
    return _CURRENT.get() or of_process()


class Owner(Protocol):
    """What has a workspace of its own."""

    @property
    def workspace(self) -> Workspace: ...  # noqa: D102


Owning = TypeVar("Owning", bound=Owner)


def in_own_workspace(method: Callable[Concatenate[Owning, P], T]) -> Callable[Concatenate[Owning, P], T]:
    """Let a method work in the workspace of its object."""

    @wraps(method)
    def worked(self: Owning, /, *args: P.args, **named: P.kwargs) -> T:
        with using(self.workspace):
            return method(self, *args, **named)

    return worked


@cache
def of_process() -> Workspace:
    """Return the workspace of all evaluators that are given none.

    Raises:
        InputError: ``PROBE_DESIGN_MEMORY`` is no number of GB.
    """
    given = os.environ.get(LIMIT, f"{USUAL:g}")
    try:
        limit = float(given)
    except ValueError:
        limit = -1.0
    if not 0 <= limit < float("inf"):
        raise InputError(LIMIT, given, "a number of GB, such as 0.5")
    return Workspace(1e9 * limit)


def kept(function: Callable[P, T]) -> Callable[P, T]:
    """Keep what a function returns in the current workspace, by its arguments, which are hashable."""
    return _kept(function, fixed=False)


def kept_within_limits(function: Callable[P, T]) -> Callable[P, T]:
    """Do so for the limits of memory and time that hold: what one of them stopped may be better within others."""

    @wraps(function)
    def looked_up(*args: P.args, **named: P.kwargs) -> T:
        key = (function, limits(), args, tuple(named.items()))
        return current().keep(key, lambda: function(*args, **named))

    return looked_up


def kept_table(function: Callable[P, T]) -> Callable[P, T]:
    """Do so with tables: of those there are many, and as they do not grow they are measured once."""
    return _kept(function, fixed=True)


def _kept(function: Callable[P, T], fixed: bool) -> Callable[P, T]:
    @wraps(function)
    def looked_up(*args: P.args, **named: P.kwargs) -> T:
        key = (function, args, tuple(named.items()))
        return current().keep(key, lambda: function(*args, **named), fixed)

    return looked_up
