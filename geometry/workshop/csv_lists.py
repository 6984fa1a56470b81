"""Write lists as CSV: the bill of materials, and the tolerance of each dimension."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from geometry.cad.materials import PartMaterial
from geometry.cad.parts_check import compute_expected_bodies
from geometry.cad.stamp import Stamp
from geometry.common.percent import format_percent
from geometry.scenes.film import Film
from geometry.scenes.probe import Probe
from geometry.scenes.units import format_modulus
from geometry.workshop.mould_sizes import (
    MOULD_MATERIAL,
    MouldSizes,
    compute_cavity_volume,
    compute_half_volumes,
    compute_holes_volume,
)
from geometry.workshop.parts import DRAWING_TITLES, RATIO_DRAWINGS, Measure, PartView
from geometry.workshop.sheet import format_number
from geometry.workshop.tolerance import DEVIATION_PER_SD, MACHINING_PROCESS, Budget, Tolerance, format_deviation

BILL_COLUMNS = ("part", "quantity", "material", "properties", "volume_mm3", "mass_g", "source_file")
TOLERANCE_COLUMNS = ("quantity", "kind", "drawing", "nominal", "deviation", "from", "wanted", "log_sensitivity", "ratio_percent")


def write_bill_of_materials(probe: Probe, stamp: Stamp, moulds: Sequence[MouldSizes], edge_radius: float = 0.0) -> str:
    """Return the bill of materials as CSV; masses stay empty where the scene does not determine the density."""
    rows: list[tuple[object, ...]] = []
    for name, body in compute_expected_bodies(probe, edge_radius).items():
        rows.append((name, 1, *_describe_material(stamp.materials[name], body.volume), f"{name}.step"))
    if probe.film is not None:
        rows += _list_bond_rows(probe, probe.film)
    rows.append(
        ("shim", 3, "foil or feeler gauge", f"{format_number(1e3 * probe.gap)} mm thick, for the gap", "", "", "assembly.md")
    )
    for mould in moulds:
        rows.append((f"casting-{mould.name}", 1, *_describe_casting(stamp.materials[mould.name], mould), "assembly.md"))
        names = {f"mould-{mould.name}-{half}": volume for half, volume in compute_half_volumes(mould).items()}
        rows += [(name, 1, *_describe_material(MOULD_MATERIAL, volume), f"{name}.step") for name, volume in names.items()]
    return _write_csv(BILL_COLUMNS, rows)


def _describe_material(material: PartMaterial, volume: float) -> tuple[str, str, str, str]:
    """Return a row's material, properties, volume in mm^3 and mass in g, empty where the density is unknown."""
    mass = "" if material.density is None else f"{material.density * volume * 1e-6:.6g}"
    return material.name, material.properties, f"{volume:.6g}", mass


def _describe_casting(material: PartMaterial, mould: MouldSizes) -> tuple[str, str, str, str]:
    """Return the line for the elastomer of a block: it fills cavity and holes, and shrinks to the block and its sprues."""
    said = f"fills cavity ({compute_cavity_volume(mould):.6g} mm3), pour hole and vents; what stays in the cup comes on top"
    mixed = PartMaterial(f"mixed {material.name}", said, material.density)
    return _describe_material(mixed, compute_cavity_volume(mould) + compute_holes_volume(mould))


def _list_bond_rows(probe: Probe, film: Film) -> list[tuple[object, ...]]:
    """Return the rows of the bonds of both films that have a thickness; their masses stay empty."""
    rows: list[tuple[object, ...]] = []
    areas = probe.inner_area, probe.outer_area - probe.groove_footprint
    for name, block_film, area in zip(("inner", "outer"), film.by_block, areas, strict=True):
        for side, bond in (("base", block_film.bond_to_base), ("block", block_film.bond_to_block)):
            if bond is None or bond.youngs_modulus is None or bond.is_rigid:
                continue
            sizes = f"{format_number(1e3 * bond.thickness)} mm thick, E = {format_modulus(bond.youngs_modulus)}"
            volume = f"{1e9 * area * bond.thickness:.6g}"
            rows.append((f"bond-{name}-to-{side}", 1, bond.name or "bond", sizes, volume, "", "assembly.md"))
    return rows


@dataclass(frozen=True)
class HeldDimension:
    """A dimension with the tolerance that its drawing states.

    Attributes
    ----------
    measure
        The dimension as drawn.
    part
        The part on whose drawing it stands.
    held
        Its tolerance.
    log_sensitivity
        d ln ratio / d ln size; None where the ratio does not depend on the size, or this is unknown.
    wanted
        Deviation in mm that the ratio's budget allows; None in the same cases.
    """

    measure: Measure
    part: str
    held: Tolerance
    log_sensitivity: float | None
    wanted: float | None

    @property
    def ratio_sd(self) -> float | None:
        """Standard deviation that it gives the ratio, relative."""
        return (
            None
            if self.log_sensitivity is None
            else abs(self.log_sensitivity) * self.held.deviation / DEVIATION_PER_SD / self.held.size
        )


def list_held_dimensions(views: Iterable[PartView], materials: Mapping[str, PartMaterial], budget: Budget) -> list[HeldDimension]:
    """Return the dimensions of all drawings, without auxiliary dimensions, which follow from others."""
    dimensions = []
    for view in views:
        process = materials[view.name].process if view.name in materials else MACHINING_PROCESS
        for measure in (candidate for candidate in view.measures if not candidate.auxiliary):
            known = view.name in RATIO_DRAWINGS  # the ratio limits only the dimensions on these drawings
            bound = budget.find_bound(measure.name) if known else None
            # the bound of a radius is doubled for its diameter
            wanted = None if bound is None else (2 if measure.prefix else 1) * bound
            derivative = budget.sensitivities.get(measure.name) if known else None
            dimensions.append(
                HeldDimension(measure, view.name, measure.find_tolerance(view.name, process, budget), derivative, wanted)
            )
    return dimensions


def write_tolerances(dimensions: Iterable[HeldDimension], budget: Budget) -> str:
    """Return the table of tolerances as CSV: dimensions in mm with ± deviations, other numbers with standard deviations.

    ``ratio_percent`` is the standard deviation of the ratio that each of them causes.
    """
    rows = [_build_row(dimension) for dimension in dimensions]
    rows += [
        (
            dimension.name,
            "standard deviation",
            "",
            dimension.nominal,
            format_percent(dimension.sd, 3),
            dimension.source,
            "",
            "",
            f"{100 * dimension.ratio:.3g}",
        )
        for dimension in budget.scatter
    ]
    return _write_csv(TOLERANCE_COLUMNS, rows)


def _build_row(dimension: HeldDimension) -> tuple[str, ...]:
    """Return the row of a dimension in the table of tolerances, its values as ``TOLERANCE_COLUMNS`` name them."""
    name, kind = dimension.measure.name.replace("_radius", "_diameter"), "diameter" if dimension.measure.prefix else "length"
    derivative, ratio = (
        ("" if dimension.log_sensitivity is None else f"{dimension.log_sensitivity:.4g}"),
        ("" if dimension.ratio_sd is None else f"{100 * dimension.ratio_sd:.3g}"),
    )
    wanted = "" if dimension.wanted is None else format_deviation(dimension.wanted)
    return (
        name,
        kind,
        dimension.part,
        format_number(dimension.measure.size),
        format_deviation(dimension.held.deviation),
        dimension.held.source,
        wanted,
        derivative,
        ratio,
    )


def compute_scatter_of_ratio(dimensions: Iterable[HeldDimension], budget: Budget) -> dict[str, float]:
    """Return the relative standard deviation of the ratio due to each dimension, modulus and gain, the largest first.

    All are independent, so that their squares add up. The gap is not counted, since both of its radii are.
    """
    parts = {
        _describe_dimension(part): part.ratio_sd
        for part in dimensions
        if part.ratio_sd is not None and part.measure.name != "gap"
    }
    parts |= {part.words: part.ratio for part in budget.scatter}
    return dict(sorted(parts.items(), key=lambda entry: -entry[1]))


def _describe_dimension(dimension: HeldDimension) -> str:
    """Return a dimension in words, such as "inner block's diameter"."""
    name = dimension.measure.name.removeprefix(f"{dimension.part}_").replace("radius", "diameter").replace("_", " ")
    return f"{DRAWING_TITLES[dimension.part].lower()}'s {name}"


def combine_scatter(scatter: Mapping[str, float]) -> float:
    """Return the combined scatter of the ratio, in percent: the root of the sum of squares."""
    return 100 * math.hypot(*scatter.values())


def _write_csv(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return rows below a heading as CSV text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(rows)
    return text.getvalue()
