"""Check the system's limits of memory (``ulimit``) before libraries are loaded that would wait endlessly for more.

OpenBLAS, of which numpy and scipy each have a copy, requests 32 MB for every thread while it is loaded. If it does not get them,
its ``blas_memory_alloc`` repeats the request endlessly, and no signal ends an import.
"""

from __future__ import annotations

import os
from importlib import import_module

MIN_MEMORY_BYTES = 500_000_000  # bytes: needed by every evaluator, with one thread of OpenBLAS
LIMIT_NAMES = {"RLIMIT_DATA": "data (ulimit -d)", "RLIMIT_AS": "address space (ulimit -v)"}


def explain_refusal() -> str:
    """Return a message about a limit that is too low, or "". If there are limits, restrict OpenBLAS to one thread."""
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return ""
    limits = {name: resource.getrlimit(getattr(resource, name))[0] for name in LIMIT_NAMES if hasattr(resource, name)}
    finite_limits = {name: value for name, value in limits.items() if value != resource.RLIM_INFINITY}
    if finite_limits:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name, value in finite_limits.items():
        if value < MIN_MEMORY_BYTES:
            return (
                f"memory = {value / 1e9:.2g} GB of {LIMIT_NAMES[name]}: allowed: {MIN_MEMORY_BYTES / 1e9:g} GB or "
                "more for this program"
            )
    return ""
