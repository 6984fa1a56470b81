"""Laws at finite strain of catalogue materials, fitted to measured curves: constants and the strain up to which they hold."""

from __future__ import annotations

from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.sourced_numbers import Number

LAW_KEYS = ("c2_over_c1", "c3_over_c1", "law_strain")


def build_law_numbers(entry: JsonObject | None, source: str) -> dict[str, Number]:
    """Return the keys of a law for a scene's table, with their sources; none without an entry.

    Parameters
    ----------
    entry
        ``c2_over_c1`` with its standard deviation ``sd``, ``law_strain`` and ``misfit``, as a file of the catalogue has them.
    source
        Of the curve.
    """
    if entry is None:
        return {}
    fitted = f"Yeoh's law in tension, misfit {format_percent(entry['misfit'], 6)} of the largest stress; {source}"
    scatter = f"standard deviation {entry['sd']:g} of one curve; ratios to C1, so that they stay beside a measured modulus"
    return {
        "law": Number("yeoh", fitted),
        "c2_over_c1": Number(entry["c2_over_c1"], scatter),
        "law_strain": Number(entry["law_strain"], "largest strain of the curve, in tension"),
    }


def describe_law(numbers: dict[str, Number]) -> str:
    """Return the law of a material's numbers in a few words, "yeoh to 100 %"; "neo-hookean" where none was measured."""
    if "law" not in numbers:
        return "neo-hookean"
    return f"{numbers['law'].value} to {float(numbers['law_strain'].value):.0%}"


def fill_in_law(table: JsonObject, numbers: dict[str, Number]) -> JsonObject:
    """Return a table with ``law = "yeoh"`` alone, completed by the constants of the material that it names, if it has some."""
    if table.get("law") != "yeoh" or "law" not in numbers or any(key in table for key in LAW_KEYS):
        return table
    return {**table, **{key: numbers[key].value for key in LAW_KEYS if key in numbers}}
