"""List the numbers of a scene that the page varies: keys, labels, units and the ranges of their sliders."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from geometry.scenes.scene import Scene
from geometry.scenes.units import convert_to_unit
from probe_design.explorer.formats import convert_decimal_comma

LENGTH_FACTOR, MODULUS_FACTOR, FORCE_FACTOR = 5.0, 20.0, 10.0  # relative: a slider reaches this factor to both sides of the start
MAX_TEXT_LENGTH = 80  # characters of a typed value, as units allow
_KINDS = {"mm": ("m", LENGTH_FACTOR), "kPa": ("Pa", MODULUS_FACTOR), "mN": ("N", FORCE_FACTOR), "": ("", LENGTH_FACTOR)}
_PATH_PART = re.compile(r"(\w+)(?:\[(\d+)\])?")


@dataclass(frozen=True)
class Variable:
    """A number that a slider varies.

    Attributes
    ----------
    key
        Path in the scene file.
    label
        Name on the page.
    unit
        Unit on the page; empty for a number without one.
    low, high
        Range of the slider, SI.
    """

    key: str
    label: str
    unit: str
    low: float
    high: float

    @property
    def is_linear(self) -> bool:
        """Whether the slider's scale is linear, as for a position, which may be 0; otherwise it is logarithmic."""
        return self.low <= 0

    def find_value(self, fraction: float) -> float:
        """Return the value, SI, at a fraction of the slider, with the digits that a slider can mean."""
        fraction = min(max(fraction, 0.0), 1.0)
        if self.is_linear:
            value = self.low + fraction * (self.high - self.low)
            return round(value, 5)
        value = self.low * (self.high / self.low) ** fraction
        return float(f"{value:.3g}")

    def find_fraction(self, value: float) -> float:
        """Return where a value, SI, stands on the slider, from 0 to 1."""
        if self.is_linear:
            fraction = (value - self.low) / (self.high - self.low)
        else:
            fraction = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        return min(max(fraction, 0.0), 1.0)

    def format_value(self, value: float) -> str:
        """Write an SI value with its unit."""
        return f"{convert_to_unit(value, _KINDS[self.unit][0], self.unit):.6g} {self.unit}" if self.unit else f"{value:.6g}"

    def read_text(self, text: str) -> str:
        """Return typed text as a scene file has it: with a decimal point, and with this variable's unit where it has none."""
        text = convert_decimal_comma(text.strip()[: MAX_TEXT_LENGTH + 1])
        is_bare = re.fullmatch(r"[+-]?[\d.]+(e[+-]?\d+)?", text, re.IGNORECASE) is not None
        return f"{text} {self.unit}" if is_bare and self.unit else text


def get_value(scene: Scene, key: str) -> float | None:
    """Return the number that a scene has at a key, SI; None where it has none."""
    item: object = scene
    for name, index in _PATH_PART.findall(key):
        item = getattr(item, name, None)
        if index and isinstance(item, tuple):
            item = item[int(index)] if int(index) < len(item) else None
    return item if isinstance(item, float | int) else None


def list_variables(scene: Scene) -> tuple[Variable, ...]:
    """Return the design numbers of a scene in the order of the page, with sliders around its present values."""
    entries = [
        ("probe.inner_radius", "inner radius", "mm"),
        ("probe.area_ratio", "area ratio A2/A1", ""),
        ("probe.outer_radius", "outer radius", "mm"),
        ("probe.gap", "gap", "mm"),
        ("probe.height", "height", "mm"),
        ("probe.inner_height", "inner height", "mm"),
        ("probe.outer_height", "outer height", "mm"),
        ("probe.inner.youngs_modulus", "inner modulus", "kPa"),
        ("probe.outer.youngs_modulus", "outer modulus", "kPa"),
    ]
    for k in range(len(scene.tissue.layer)):
        entries += [
            (f"tissue.layer[{k}].thickness", f"layer {k + 1} thickness", "mm"),
            (f"tissue.layer[{k}].youngs_modulus", f"layer {k + 1} modulus", "kPa"),
        ]
    entries.append(("tissue.youngs_modulus", "tissue modulus", "kPa"))
    for k in range(len(scene.inclusion)):
        name = "tumour" if len(scene.inclusion) == 1 else f"tumour {k + 1}"
        entries += [
            (f"inclusion[{k}].depth", f"{name} depth", "mm"),
            (f"inclusion[{k}].diameter", f"{name} diameter", "mm"),
            (f"inclusion[{k}].youngs_modulus", f"{name} modulus", "kPa"),
            (f"inclusion[{k}].x", f"{name} offset x", "mm"),
        ]
    entries += [("load.force", "force", "mN"), ("load.indentation", "indentation", "mm")]
    return tuple(variable for entry in entries if (variable := _build_variable(scene, *entry)) is not None)


def _build_variable(scene: Scene, key: str, label: str, unit: str) -> Variable | None:
    """Return a variable with its slider's range; None where the scene has no such number, or 0 where none can be varied."""
    value = get_value(scene, key)
    if value is None:
        return None
    if key.endswith(".x"):
        reach = max(3 * scene.probe.tube_radius, abs(value))
        return Variable(key, label, unit, -reach, reach)
    factor = _KINDS[unit][1]
    return Variable(key, label, unit, value / factor, value * factor) if value > 0 else None
