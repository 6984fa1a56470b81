"""Design files for tests of the search."""

from __future__ import annotations

from typing import Any

from probe_design.data.builtin import read_typical_scenes
from probe_design.populations.design_file import Design, design_from_dict


def design(units_required: bool = False, **tables: Any) -> Design:
    """Return a design file round a usual probe; numbers are in SI units unless texts are required."""
    return design_from_dict({"scene": read_typical_scenes()["on-axis"], **tables}, units_required=units_required)
