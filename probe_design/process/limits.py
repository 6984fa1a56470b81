"""Check the system's limits of memory (``ulimit``) before libraries are loaded that would wait endlessly for more.

OpenBLAS, of which numpy and scipy each have a copy, requests 32 MB for every thread while it is loaded. If it does not get them,
its ``blas_memory_alloc`` repeats the request endlessly, and no signal ends an import.
"""

from __future__ import annotations

import os
from importlib import import_module

LEAST = 500_000_000  # bytes: needed by every evaluator, with one thread of OpenBLAS
KINDS = {"RLIMIT_DATA": "data (ulimit -d)", "RLIMIT_AS": "address space (ulimit -v)"}


def refused() -> str:
    """Return a message about a limit that is too low, or "". If there are limits, restrict OpenBLAS to one thread."""
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return ""
    limits = {name: resource.getrlimit(getattr(resource, name))[0] for name in KINDS if hasattr(resource, name)}
    found = {name: value for name, value in limits.items() if value != resource.RLIM_INFINITY}
    if found:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name, value in found.items():
        if value < LEAST:
            return f"memory = {value / 1e9:.2g} GB of {KINDS[name]}: allowed: {LEAST / 1e9:g} GB or more for this program"
    return ""
