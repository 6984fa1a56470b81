"""Check readings that are made in Python as those of a file are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from geometry.scenes.scene import Scene
from probe_design.estimation.measurements import Reading, build_scan_reading, check_reading

SI_UNITS = dict.fromkeys(("x", "y", "x_sd", "y_sd"), "m") | {"force": "N"}  # of entries that are numbers in Python


def check_readings(readings: Sequence[Reading], scene: Scene, *, is_scan: bool = False) -> tuple[Reading, ...]:
    """Return readings that were made in Python, checked as those of a file are; ``is_scan`` as for ``read_readings``.

    Raises
    ------
    InputError
        A number is not allowed.
    """
    checked = []
    for index, reading in enumerate(readings):
        key_prefix, row = f"readings[{index}].", add_si_units(vars(reading))
        checked.append(
            build_scan_reading(key_prefix, row, scene) if is_scan else check_reading(key_prefix, row, scene, None, None)
        )
    return tuple(checked)


def add_si_units(entries: Mapping[str, object]) -> dict[str, object]:
    """Return the entries of a reading, numbers as texts with their SI unit where files require one; None is left out."""
    row = {key: value.item() if isinstance(value, np.generic) else value for key, value in entries.items() if value is not None}
    return {key: f"{value!r} {SI_UNITS[key]}" if key in SI_UNITS and isinstance(value, float | int) else value
            for key, value in row.items()}  # fmt: skip
