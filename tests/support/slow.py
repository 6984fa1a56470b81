"""Which cases of a test wait for ``pytest -m slow``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def slow_unless(quick: Callable[[Any], bool], cases: Iterable[Any]) -> list[Any]:
    """Return all cases for ``parametrize``, marked slow where they are not quick; a tuple is a case of several arguments."""
    cases_with_marks = [
        (case if isinstance(case, tuple) else (case,), () if quick(case) else (pytest.mark.slow,)) for case in cases
    ]
    return [pytest.param(*arguments, marks=marks) for arguments, marks in cases_with_marks]
