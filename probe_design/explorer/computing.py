"""Compute the formulas of all pages in one thread, as each thread has work arrays of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import ParamSpec, TypeVar

COMPUTING_THREAD = ThreadPoolExecutor(1, "formulas")
P = ParamSpec("P")
T = TypeVar("T")


async def compute(function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
    """Call a function in the thread of the formulas."""
    return await asyncio.get_running_loop().run_in_executor(COMPUTING_THREAD, partial(function, *arguments, **options))
