"""Lists as CSV: what is needed (bill of materials), and how tightly each dimension is held."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence

from geometry.cad.drawing import number
from geometry.cad.materials import PartMaterial
from geometry.cad.parts_check import expected_bodies
from geometry.cad.stamp import Stamp
from geometry.scenes.probe import Probe
from geometry.workshop.mould_sizes import TOOL, MouldSizes, cavity_volume, holes_volume, volumes
from geometry.workshop.parts import PartView
from geometry.workshop.tolerance import Budget, Tolerance, tolerance, written

BILL = ("part", "quantity", "material", "properties", "volume_mm3", "mass_g", "source_file")
TABLE = ("dimension", "kind", "drawing", "nominal_mm", "tolerance_mm", "from", "log_sensitivity", "ratio_change_percent")


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


def held(views: Iterable[PartView], budget: Budget) -> dict[str, tuple[str, float, Tolerance]]:
    """Return by the name of each dimension where it is drawn, its size as drawn (a diameter, of a radius) and how it is held.

    Those that others give are not held for themselves.
    """
    found: dict[str, tuple[str, float, Tolerance]] = {}
    for view in views:
        for measure in (one for one in view.measures if not one.auxiliary):
            bound = budget.bound(measure.name)
            factor = 2 if measure.prefix else 1
            one = tolerance(measure.size, None if bound is None else factor * bound)
            place, *_ = found.get(measure.name, ("",))
            found[measure.name] = (f"{place} {view.name}".strip(), measure.size, one)
    return found


def tolerances(views: Iterable[PartView], budget: Budget) -> str:
    """Return the table as CSV, a row for each dimension; what the ratio changes where its sensitivity is known."""
    rows = []
    for name, (place, size, one) in held(views, budget).items():
        slope = budget.sensitivities.get(name)
        change = "" if slope is None else f"{100 * abs(slope) * one.deviation / size:.3g}"
        deviation, kind = written(one.deviation), "diameter" if name.endswith("_radius") else "length"
        rows.append(
            (
                name.replace("_radius", "_diameter"),
                kind,
                place,
                number(size),
                deviation,
                one.source,
                "" if slope is None else f"{slope:.4g}",
                change,
            )
        )
    return _csv(TABLE, rows)


def together(views: Iterable[PartView], budget: Budget) -> float:
    """Return what all deviations together change of the ratio, in percent: the root of the sum of their squares.

    The gap is not counted beside the two radii that it lies between.
    """
    found = {name: one for name, one in held(views, budget).items() if name != "gap"}
    shares = (budget.sensitivities.get(name, 0.0) * one.deviation / size for name, (_, size, one) in found.items())
    return 100 * math.sqrt(sum(share**2 for share in shares))


def _csv(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    return text.getvalue()
