"""A sequence whose items are built when they are read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import copy_context
from functools import partial
from typing import Generic, SupportsIndex, TypeVar, overload

T = TypeVar("T")


class LazySequence(Sequence[T], Generic[T]):
    """A frozen sequence that builds each item when it is first read, and then keeps it.

    Items are built in the context in which the sequence was made: with its limits, and with its command line in provenance.
    A pickled one has all its items.

    Parameters
    ----------
    builders
        A function for each item, which builds it.
    """

    def __init__(self, builders: Sequence[Callable[[], T]]) -> None:
        self._builders, self._context = builders, copy_context()
        self._items: dict[int, T] = {}

    def __len__(self) -> int:
        """Return the number of items."""
        return len(self._builders)

    @overload
    def __getitem__(self, index: SupportsIndex) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> list[T]: ...

    def __getitem__(self, index: SupportsIndex | slice) -> T | list[T]:
        """Return an item, or a list of those of a slice."""
        if isinstance(index, slice):
            return [self[place] for place in range(len(self))[index]]
        place = range(len(self))[index]
        if place not in self._items:
            self._items[place] = self._context.copy().run(self._builders[place])  # a copy, as a context runs once at a time
        return self._items[place]

    def __eq__(self, other: object) -> bool:
        """Return whether the items are those of another sequence or list."""
        return list(self) == list(other) if isinstance(other, list | LazySequence) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # as a list has none

    def __repr__(self) -> str:
        """Return the items as a list's."""
        return repr(list(self))

    def __reduce__(self) -> tuple[Callable[..., object], tuple[type, list[T]]]:
        """Return the class and all items for pickles, as what builds the items cannot be pickled."""
        return _restore_sequence, (type(self), list(self))


def _restore_sequence(kind: type[LazySequence[T]], items: list[T]) -> LazySequence[T]:
    """Return a sequence of items that are built."""
    return kind([partial(_get, item) for item in items])


def _get(item: T) -> T:
    """Return an item as it is."""
    return item
