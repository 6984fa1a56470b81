"""List the scans that a search tries one by one: numbers of presses and distances between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.errors import InputError, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.tissue_sides import compute_side_distance
from probe_design.design_search.variables import M_PER_MM, VALUES_BETWEEN_BOUNDS, list_lengths
from probe_design.populations.design_file import Design
from probe_design.populations.entries import DesignVariable
from probe_design.populations.tables import MAX_POSITIONS, MAX_RASTER_LINES, Protocol

PITCH_DIGITS_M = 5  # decimals of a pitch in m: a hundredth of a millimetre


@dataclass(frozen=True)
class ScanChoice:
    """The places that are read.

    Attributes
    ----------
    protocol
        The protocol with these positions.
    """

    protocol: Protocol

    @property
    def presses(self) -> int:
        """Number of places."""
        return self.protocol.count

    @property
    def pitch(self) -> float:
        """Distance between neighbouring places, m; 0 for a single one."""
        return compute_pitch(self.protocol)

    @property
    def description(self) -> str:
        """The choice in words."""
        return f"{self.presses} presses, pitch {format_mm(self.pitch)}"

    @property
    def texts(self) -> dict[str, str]:
        """The choice by the names of its columns in a table."""
        return {"presses": str(self.presses), "pitch, mm": f"{self.pitch / M_PER_MM:.4g}"}

    def is_of(self, _scene: Scene, protocol: Protocol) -> bool:
        """Return whether a protocol reads these places."""
        return protocol == self.protocol


def compute_pitch(protocol: Protocol) -> float:
    """Return the mean distance between neighbouring positions, m; 0 for a single one."""
    return float(np.ptp(protocol.places)) / max(len(protocol.positions) - 1, 1)


def count_presses(protocol: Protocol) -> int:
    """Return the presses of a scan: every place and the baseline reading, under every load."""
    return (protocol.count + protocol.blank) * max(1, len(protocol.loads))


def list_scan_choices(design: Design, outer_radius: float) -> tuple[ScanChoice, ...]:
    """Return the scans that a design file allows; none where it varies neither presses nor pitch.

    Parameters
    ----------
    design
        The design file.
    outer_radius
        Of the widest probe, m, which has to stand on the tissue at every place.

    Raises
    ------
    InputError
        The file's own scan has more presses than its limit, or no scan is within the limits.
    """
    limit, variables, protocol = design.limits.presses, design.variables, design.protocol
    if limit is not None and count_presses(protocol) > limit:
        allowed = f"{count_presses(protocol)} or more, as many as the file's own [protocol] has, or fewer positions in it"
        raise InputError("limits.presses", limit, allowed)
    if all(variable == DesignVariable() or variable.fixed for variable in (variables.presses, variables.pitch)):
        return ()
    choices, reasons = dict[ScanChoice, None](), dict[str, None]()
    for lines in _list_lines(variables.presses, protocol):
        for pitch in _list_pitches(variables.pitch, protocol, lines):
            middle = (protocol.places.min() + protocol.places.max()) / 2
            positions = middle + pitch * (np.arange(lines) - (lines - 1) / 2)
            changed = protocol.model_copy(update={"positions": tuple(np.round(positions, 9).tolist())})
            if limit is not None and count_presses(changed) > limit:
                reasons["limits.presses"] = None
            elif not _is_on_tissue(changed, design.scene, outer_radius):
                reasons["the tissue"] = None
            else:
                choices[ScanChoice(changed)] = None
    if not choices:
        allowed = (
            f"some scan within {' and '.join(reasons)}, the baseline reading counted and the widest probe standing on the tissue"
        )
        raise InputError("variables.presses", Words("no scan left"), allowed)
    return tuple(choices)


def _list_lines(variable: DesignVariable, protocol: Protocol) -> list[int]:
    """Return the numbers of positions along a line, or along each side of a raster."""
    if variable == DesignVariable() or variable.fixed:
        return [len(protocol.positions)]
    power, max_lines = (2, MAX_RASTER_LINES) if protocol.raster else (1, MAX_POSITIONS)
    lines = {count**power: count for count in range(2, max_lines + 1)}  # by the number of presses
    given = variable.choices or (variable.low, variable.high)
    for number in given:
        if number is None or number != int(number) or not 2 <= number <= max_lines**power:
            raise InputError("variables.presses", number, f"whole numbers from 2 to {max_lines**power}, as bounds or choices")
    if variable.choices:
        for number in variable.choices:
            if number not in lines:
                raise InputError("variables.presses", int(number), "squares, such as 9, 16 and 25, in a raster")
        return [lines[int(number)] for number in variable.choices]
    low, high = (int(number or 0) for number in given)
    allowed = [count for number, count in lines.items() if low <= number <= high and not number % (variable.step or 1)]
    if not allowed:
        raise InputError(
            "variables.presses", [low, high], "bounds with a number, in a raster a square, and a multiple of step between"
        )
    if variable.step is None and len(allowed) > VALUES_BETWEEN_BOUNDS:
        allowed = [allowed[k] for k in np.linspace(0, len(allowed) - 1, VALUES_BETWEEN_BOUNDS).round().astype(int).tolist()]
    return allowed


def _list_pitches(variable: DesignVariable, protocol: Protocol, lines: int) -> tuple[float, ...]:
    """Return the distances between neighbouring positions, m."""
    if variable.fixed:
        return (compute_pitch(protocol),)
    pitches = list_lengths("pitch", variable)
    if not pitches:
        return (round(float(np.ptp(protocol.places)) / (lines - 1), PITCH_DIGITS_M),)
    is_exact = variable.choices or variable.step is not None
    return pitches if is_exact else tuple(np.round(pitches, PITCH_DIGITS_M).tolist())


def _is_on_tissue(protocol: Protocol, scene: Scene, outer_radius: float) -> bool:
    """Return whether the whole probe stands on the tissue at every place."""
    places = protocol.list_places(scene.placement.y)
    return bool(np.all(outer_radius < compute_side_distance(scene.tissue, *places.T)))
