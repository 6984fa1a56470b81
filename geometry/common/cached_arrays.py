"""Cache arrays in files: a file appears whole or not at all and carries its checksum; one that does not match is removed.

The folder is the user's cache, or the one that the environment variable ``PROBE_DESIGN_CACHE`` names.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.files import write_whole

CACHE_VARIABLE = "PROBE_DESIGN_CACHE"  # the environment variable
_CHECKSUM_BYTES = hashlib.sha256().digest_size


def find_cache_folder(kind: str) -> Path:
    """Return the folder of the cache for a kind of files, such as "meshes"; the environment variable names it for all kinds."""
    import platformdirs

    override = os.environ.get(CACHE_VARIABLE)
    return Path(override) if override else Path(platformdirs.user_cache_dir("probe-design", appauthor=False)) / kind


def read_arrays(path: Path) -> dict[str, Any] | None:
    """Read the arrays in a file; None if there is none, or its checksum does not match: then the file is removed."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(content[_CHECKSUM_BYTES:]).digest() != content[:_CHECKSUM_BYTES]:
        with suppress(OSError):
            path.unlink()
        return None
    with np.load(io.BytesIO(content[_CHECKSUM_BYTES:]), allow_pickle=False) as arrays:
        return dict(arrays)


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays to a file, its checksum first, unless the file is there or cannot be written."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    content = buffer.getvalue()
    try:
        with write_whole(path, once=True) as draft:
            draft.write_bytes(hashlib.sha256(content).digest() + content)
    except OSError:  # a full disk or a folder that is not ours: what was computed is there all the same
        return
