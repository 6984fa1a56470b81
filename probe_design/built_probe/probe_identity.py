"""Identify a probe by its drawing's numbers, on which calibrations and ratios depend, and by the serial number of its board.

Two probes of one drawing differ in their gains by 5 % or more, so that one's calibration is wrong for the other. A board has a
serial number. An oscilloscope's serial number does not identify the probe, and files of other programs have none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from probe_design.built_probe.block_predictions import express_by_outer_radius
from solver.results.film_charges import reads_film_states

CHARGE_KEY = "probe.film charge per force"
RELATIVE_TOLERANCE = 1e-9  # relative difference within which two numbers are equal
BOARDLESS_TRANSPORTS = ("visa",)  # transports whose serial number is not a probe's
MAX_SERIAL_LENGTH = 100  # characters
MAX_SHOWN_NAMES = 3  # names in a message


def list_probe_numbers(scene: Scene) -> dict[str, float]:
    """List a probe's dimensions and moduli by their keys, SI, and its film's charge per force, C/N, if it has a film."""
    numbers = {key: value for key, value in list_values(express_by_outer_radius(scene)).items() if key.startswith("probe.")}
    film = scene.probe.film
    return numbers if film is None else numbers | {CHARGE_KEY: film.charge_per_force}


def describe_probe_difference(numbers: Mapping[str, float], scene: Scene) -> str | None:
    """Describe the first number in which a probe differs from the scene's, or return None.

    Parameters
    ----------
    numbers
        Of the probe, as ``list_probe_numbers`` returns them.
    scene
        With the other probe.
    """
    wanted = list_probe_numbers(scene)
    for key, value in wanted.items():
        if key not in numbers:
            return f"{key} is missing there"
        if not math.isclose(numbers[key], value, rel_tol=RELATIVE_TOLERANCE):
            return f"{key} is {numbers[key]:.6g} there and {value:.6g} in the scene, SI units"
    return None if numbers.keys() == wanted.keys() else "it has parts there that the scene's has not"


def describe_contrast(recorded: Scene, scene: Scene) -> str | None:
    """Describe what a calibration for ``recorded`` should be for a scene that reads the other of charges and forces, or None."""
    if reads_film_states(recorded) == reads_film_states(scene):
        return None
    kinds = ("gains of forces", "scales of the films' charges")
    made, wanted = (kinds[reads_film_states(item)] for item in (recorded, scene))
    return f"one of {wanted}, as the scene's films and [reading] observable want; it holds {made}"


def read_board_serial(source: Mapping[str, object]) -> str | None:
    """Return the serial number of the board from the description of a source of samples; None if unknown."""
    transport, serial = source.get("transport"), source.get("serial")
    if transport in BOARDLESS_TRANSPORTS or (
        transport == "serial" and "port" not in source
    ):  # older recordings, in which it is the port's
        return None
    return clean_serial(serial)


def clean_serial(serial: Any) -> str | None:
    """Return a serial number without surrounding blanks, for comparison; None if it is empty or not printable."""
    text = serial.strip() if isinstance(serial, str) else ""
    return text if text.isprintable() and 0 < len(text) <= MAX_SERIAL_LENGTH else None


def check_serials(boards: Mapping[str, str | None], any_probe: bool) -> list[str]:
    """Check that serial numbers are of one probe; return a warning if one is unknown, or a difference is allowed.

    Parameters
    ----------
    boards
        Serial numbers by their origin, such as "calibration probe.toml"; None if unknown.
    any_probe
        Whether different serial numbers are allowed.

    Raises
    ------
    InputError
        The serial numbers differ.
    """
    by_serial: dict[str, list[str]] = {}
    for name, serial in boards.items():
        if serial is not None:
            by_serial.setdefault(serial, []).append(name)
    if len(by_serial) > 1:
        different = "; ".join(f"{serial} of {_format_names(names)}" for serial, names in by_serial.items())
        if not any_probe:
            allowed = "one probe's: give each probe its own calibration, or take them as one with --any-probe (any_probe=True)"
            raise InputError("serial number", Words(different), allowed)
        return [f"serial numbers differ, as --any-probe allows: {different}"]
    unknown = [name for name, serial in boards.items() if serial is None]
    if not unknown or len(boards) < 2:
        return []
    return [f"no serial number of {_format_names(unknown)}: nothing shows that it is the same probe's as the rest"]


def find_common_serial(boards: Mapping[str, str | None]) -> str | None:
    """Find the serial number common to all readings; None if one is unknown, or they differ."""
    numbers = set(boards.values())
    return numbers.pop() if len(numbers) == 1 else None


def _format_names(names: list[str]) -> str:
    """Format names for a message, at most ``MAX_SHOWN_NAMES`` of them."""
    suffix = f" and {len(names) - MAX_SHOWN_NAMES} more" if len(names) > MAX_SHOWN_NAMES else ""
    return ", ".join(names[:MAX_SHOWN_NAMES]) + suffix
