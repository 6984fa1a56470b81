"""Which cases of a test wait for ``pytest -m slow``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def slow_unless(quick: Callable[[Any], bool], cases: Iterable[Any]) -> list[Any]:
    """Return all cases for ``parametrize``, marked slow where they are not quick; a tuple is a case of several arguments."""
    every = [(one if isinstance(one, tuple) else (one,), () if quick(one) else (pytest.mark.slow,)) for one in cases]
    return [pytest.param(*arguments, marks=marks) for arguments, marks in every]
