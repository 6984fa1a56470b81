"""What the doctor found, one line each."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

State = Literal["good", "missing", "doubtful", "fault"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        name: what.
        state: good; missing, which some devices need; doubtful; a fault, by which readings are wrong or cannot be had.
        text: what was found.
        remedy: what to do, or nothing.
    """

    name: str
    state: State
    text: str
    remedy: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)
