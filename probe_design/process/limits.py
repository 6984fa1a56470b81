"""What the system allows this process (``ulimit``), looked at before libraries are loaded that wait without an end for more.

OpenBLAS, which numpy and scipy bring each their own of, asks for 32 MB for every thread while it is loaded, and for as long again
as it does not get them: its ``blas_memory_alloc`` goes round and round, and no signal ends an import.
"""

from __future__ import annotations

import os
from importlib import import_module

LEAST = 500_000_000  # bytes: what answers by any level begin with, one thread of OpenBLAS counted
KINDS = {"RLIMIT_DATA": "data (ulimit -d)", "RLIMIT_AS": "address space (ulimit -v)"}


def refused() -> str:
    """Say which limit is too low to load anything, "" if none is; where there are limits OpenBLAS has one thread from now on."""
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
