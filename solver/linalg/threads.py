"""Limit linear algebra to one thread: with more threads many small products wait for each other."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController

from solver.linalg.cholesky import has_pardiso


def limit_to_one_thread() -> AbstractContextManager[Any]:
    """Return a context manager in which BLAS uses one thread; the process's BLAS libraries are searched for once, in some ms."""
    limit: AbstractContextManager[Any] = _get_controller().limit(limits=1, user_api="blas")
    return limit


@cache
def _get_controller() -> ThreadpoolController:
    """Return the controller of all BLAS libraries that are loaded."""
    has_pardiso()  # PARDISO brings its own BLAS
    return ThreadpoolController()
