"""One thread for linear algebra: many small products wait for each other on more."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController

from solver.linalg.cholesky import loaded


def one_thread() -> AbstractContextManager[Any]:
    """Return the context in which BLAS uses one thread. Its libraries are looked for once, which takes milliseconds."""
    limit: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return limit


@cache
def _controller() -> ThreadpoolController:
    loaded()  # PARDISO brings its own BLAS
    return ThreadpoolController()
