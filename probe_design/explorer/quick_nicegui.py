"""Import NiceGUI in half the time: without the libraries with which its websockets could also be a client.

They are imported wherever they are installed, and used by clients and by another server alone. They are hidden meanwhile, and can
be imported as before.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

UNUSED_LIBRARIES = ("aiohttp", "requests", "tornado")


@contextmanager
def hide_libraries() -> Iterator[None]:
    """Let imports of unused libraries fail inside the block, as where they are not installed."""
    hidden = [name for name in UNUSED_LIBRARIES if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)
