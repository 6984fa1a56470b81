"""Lists as CSV: what is needed (bill of materials), and how tightly each dimension is held."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from geometry.cad.drawing import number
from geometry.cad.materials import PartMaterial
from geometry.cad.parts_check import expected_bodies
from geometry.cad.stamp import Stamp
from geometry.scenes.probe import Probe
from geometry.workshop.mould_sizes import TOOL, MouldSizes, cavity_volume, holes_volume, volumes
from geometry.workshop.parts import BOUND, TITLES, Measure, PartView
from geometry.workshop.tolerance import MACHINING, RECTANGULAR, Budget, Tolerance, written

BILL = ("part", "quantity", "material", "properties", "volume_mm3", "mass_g", "source_file")
TABLE = ("quantity", "kind", "drawing", "nominal", "deviation", "from", "wanted", "log_sensitivity", "ratio_percent")


def bill_of_materials(probe: Probe, stamp: Stamp, moulds: Sequence[MouldSizes], edge_radius: float = 0.0) -> str:
    """Return the bill as CSV; there is a mass where a density is known: a scene names no products."""
    rows: list[tuple[object, ...]] = []
    for name, body in expected_bodies(probe, edge_radius).items():
        rows.append((name, 1, *_material(stamp.materials[name], body.volume), f"{name}.step"))
    if probe.film is not None and probe.film.adhesive_thickness > 0:
        rows.append(("adhesive", 4, *_adhesive(probe), "assembly.md"))
    rows.append(("shim", 3, "foil or feeler gauge", f"{number(1e3 * probe.gap)} mm thick, for the gap", "", "", "assembly.md"))
    for mould in moulds:
        rows.append((f"casting-{mould.name}", 1, *_casting(stamp.materials[mould.name], mould), "assembly.md"))
        names = {f"mould-{mould.name}-{half}": volume for half, volume in volumes(mould).items()}
        rows += [(name, 1, *_material(TOOL, volume), f"{name}.step") for name, volume in names.items()]
    return _csv(BILL, rows)


def _material(material: PartMaterial, volume: float) -> tuple[str, str, str, str]:
    mass = "" if material.density is None else f"{material.density * volume * 1e-6:.6g}"
    return material.name, material.properties, f"{volume:.6g}", mass


def _casting(material: PartMaterial, mould: MouldSizes) -> tuple[str, str, str, str]:
    """What is mixed for a block: it fills cavity and holes, and shrinks to the block and its sprues."""
    said = f"fills cavity ({cavity_volume(mould):.6g} mm3), pour hole and vents; what stays in the cup comes on top"
    mixed = PartMaterial(f"mixed {material.name}", said, material.density)
    return _material(mixed, cavity_volume(mould) + holes_volume(mould))


def _adhesive(probe: Probe) -> tuple[str, str, str, str]:
    film = probe.film
    assert film is not None  # the caller asks
    areas = probe.inner_area + probe.outer_area - probe.groove_footprint
    modulus = "" if film.adhesive_modulus is None else f", E = {film.adhesive_modulus:.4g} Pa"
    return (
        "adhesive",
        f"layers of {number(1e3 * film.adhesive_thickness)} mm{modulus}",
        f"{2e9 * areas * film.adhesive_thickness:.6g}",
        "",
    )


@dataclass(frozen=True)
class HeldDimension:
    """A dimension as a drawing holds it.

    Attributes:
        measure: what is drawn.
        part: on whose drawing.
        held: its deviation.
        log_sensitivity: d ln ratio / d ln size; None where the ratio does not depend on it, or that is not known.
        wanted: deviation in mm that the ratio wants; None likewise.
    """

    measure: Measure
    part: str
    held: Tolerance
    slope: float | None
    wanted: float | None

    @property
    def ratio(self) -> float | None:
        """Standard deviation that it gives the ratio, relative."""
        return None if self.slope is None else abs(self.slope) * self.held.deviation / RECTANGULAR / self.held.size


def held_dimensions(views: Iterable[PartView], materials: Mapping[str, PartMaterial], budget: Budget) -> list[HeldDimension]:
    """Return the dimensions of all drawings; those that others give are not held for themselves."""
    found = []
    for view in views:
        process = materials[view.name].process if view.name in materials else MACHINING
        for measure in (one for one in view.measures if not one.auxiliary):
            known = view.name in BOUND
            bound = budget.bound(measure.name) if known else None
            wanted = None if bound is None else (2 if measure.prefix else 1) * bound
            slope = budget.sensitivities.get(measure.name) if known else None
            found.append(HeldDimension(measure, view.name, measure.held(view.name, process, budget), slope, wanted))
    return found


def tolerances(dimensions: Iterable[HeldDimension], budget: Budget) -> str:
    """Return the table as CSV: dimensions in mm, with deviations either way; what no drawing holds, with standard deviations.

    ``ratio_percent`` is the standard deviation that each gives the ratio.
    """
    rows = [_row(one) for one in dimensions]
    rows += [
        (one.name, "standard deviation", "", one.nominal, f"{100 * one.sd:.3g} %", one.source, "", "", f"{100 * one.ratio:.3g}")
        for one in budget.scatter
    ]
    return _csv(TABLE, rows)


def _row(one: HeldDimension) -> tuple[str, ...]:
    name, kind = one.measure.name.replace("_radius", "_diameter"), "diameter" if one.measure.prefix else "length"
    slope, ratio = ("" if one.slope is None else f"{one.slope:.4g}"), ("" if one.ratio is None else f"{100 * one.ratio:.3g}")
    wanted = "" if one.wanted is None else written(one.wanted)
    return name, kind, one.part, number(one.measure.size), written(one.held.deviation), one.held.source, wanted, slope, ratio


def scatter_of_ratio(dimensions: Iterable[HeldDimension], budget: Budget) -> dict[str, float]:
    """Return the standard deviation that each dimension, modulus and gain gives the ratio, relative, the largest first.

    Independent of each other: together they make the root of the sum of squares. The gap is not counted beside both radii.
    """
    parts = {_words(one): one.ratio for one in dimensions if one.ratio is not None and one.measure.name != "gap"}
    parts |= {one.words: one.ratio for one in budget.scatter}
    return dict(sorted(parts.items(), key=lambda entry: -entry[1]))


def _words(one: HeldDimension) -> str:
    name = one.measure.name.removeprefix(f"{one.part}_").replace("radius", "diameter").replace("_", " ")
    return f"{TITLES[one.part].lower()}'s {name}"


def together(scatter: Mapping[str, float]) -> float:
    """Return what all parts of a scatter make together, in percent of the ratio."""
    return 100 * math.hypot(*scatter.values())


def _csv(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    return text.getvalue()
