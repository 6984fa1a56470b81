"""Define a finding of the doctor: one line of its report."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

from geometry.common.json_types import JsonObject

State = Literal["good", "missing", "doubtful", "fault"]


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    name
        Subject of the check.
    state
        Good; missing, needed by some devices; doubtful; a fault, with which readings are wrong or impossible.
    text
        result.
    remedy
        What to do, or "".
    """

    name: str
    state: State
    text: str
    remedy: str = ""

    def as_dict(self) -> JsonObject:
        """Return the finding as a JSON object."""
        return asdict(self)
