"""What holds a device, a file or a process, and releases it at the end of a ``with`` block."""

from __future__ import annotations

from typing import Self


class Closing:
    """A context manager that is itself what the block uses, and whose end calls ``close``."""

    def close(self) -> None:
        """Release what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Return the object itself."""
        return self

    def __exit__(self, *fault: object) -> None:
        """Release what is held, after a fault too."""
        self.close()
