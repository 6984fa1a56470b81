"""List the workshop's files besides the solids, each by name with the function that writes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from geometry.cad.export import Writer
from geometry.cad.stamp import Stamp, build_stamp
from geometry.scenes.probe import Probe
from geometry.workshop import assembly_order, csv_lists, drawings, film_pattern, mould_sizes, moulds, pdf
from geometry.workshop.assembly_order import describe_gap, list_casting_notes
from geometry.workshop.parts import DRAWING_TITLES, PartView, build_assembly_view, build_part_views, list_parts
from geometry.workshop.sheet import DrawingSheet, add_properties
from geometry.workshop.tolerance import CASTING_PROCESS, NO_BUDGET, Budget


@dataclass(frozen=True)
class Casting:
    """Settings for casting the blocks.

    Attributes
    ----------
    shrinkage
        Linear shrinkage of the elastomer while it cures.
    draft
        Largest draft angle of the moulds' walls, rad; see ``geometry.workshop.mould_sizes.choose_draft``.
    """

    shrinkage: float = mould_sizes.DEFAULT_SHRINKAGE
    draft: float = mould_sizes.DEFAULT_DRAFT_RAD


DEFAULT_CASTING = Casting()


def build_writers(
    probe: Probe, edge_radius: float = 0.0, budget: Budget = NO_BUDGET, casting: Casting = DEFAULT_CASTING
) -> dict[str, Writer]:
    """Return functions that write drawings, film patterns, moulds, bill of materials, tolerances and assembly order.

    They are the argument ``other_files`` of ``geometry.cad.export.export_parts``.

    Parameters
    ----------
    probe
        The probe to be built.
    edge_radius
        Radius of the blocks' lower edges, m.
    budget
        The deviations that the ratio allows the dimensions.
    casting
        Settings for casting the blocks.

    Raises
    ------
    InputError
        A setting for casting is outside its range; see also ``geometry.scenes.base_sizes.find_base_sizes``.
    """
    stamp = build_stamp(probe, edge_radius)
    views = {**build_part_views(probe, edge_radius), "assembly": build_assembly_view(probe, edge_radius)}
    all_moulds = mould_sizes.compute_mould_sizes(probe, edge_radius, casting.shrinkage, casting.draft)
    sizes = tuple(candidate for candidate in all_moulds if stamp.materials[candidate.name].process == CASTING_PROCESS)
    patterns = film_pattern.build_film_patterns(probe)
    files = _build_drawing_writers(probe, views, stamp, budget, cast={mould.name: mould for mould in sizes})
    for pattern in patterns:
        files[f"{pattern.name}-pattern.dxf"] = partial(film_pattern.write_pattern, pattern, stamp)
    for mould in sizes:
        for half in moulds.MOULD_HALVES:
            files[moulds.format_file_name(mould, half)] = partial(moulds.write_half, mould, half, stamp)
    dimensions = csv_lists.list_held_dimensions(views.values(), stamp.materials, budget)
    scatter = csv_lists.compute_scatter_of_ratio(dimensions, budget)
    texts = {
        "bill-of-materials.csv": csv_lists.write_bill_of_materials(probe, stamp, sizes, edge_radius),
        "tolerances.csv": csv_lists.write_tolerances(dimensions, budget),
        "assembly.md": assembly_order.write_assembly_order(probe, stamp, patterns, sizes, budget=budget, scatter=scatter),
    }
    return files | {name: partial(_write_text, text) for name, text in texts.items()}


def _build_drawing_writers(
    probe: Probe, views: dict[str, PartView], stamp: Stamp, budget: Budget, *, cast: Mapping[str, mould_sizes.MouldSizes]
) -> dict[str, Writer]:
    """Return functions that write each drawing as DXF and PDF; its sheet is drawn once, when the first is written."""
    drawing_writers: dict[str, Writer] = {}
    for name, view in views.items():
        extra = list_parts(probe, stamp.materials) if name == "assembly" else ()
        extra += list_casting_notes(cast[name], budget) if name in cast else ()
        extra += (describe_gap(probe, tuple(cast.values())),) if name == "assembly" and cast else ()
        sheet = cache(partial(drawings.draw_part, view, stamp, budget, extra))
        drawing_writers[f"{name}.dxf"] = partial(_write_dxf, sheet, stamp)
        drawing_writers[f"{name}.pdf"] = partial(_write_pdf, sheet, name, stamp)
    return drawing_writers


def _write_dxf(sheet: Callable[[], DrawingSheet], stamp: Stamp, path: Path) -> None:
    """Write a sheet as DXF; ``sheet`` is a function that returns it, drawn once."""
    add_properties(sheet().document, stamp).saveas(path)


def _write_pdf(sheet: Callable[[], DrawingSheet], name: str, stamp: Stamp, path: Path) -> None:
    """Write a sheet as PDF; ``sheet`` as in ``_write_dxf``, ``name`` that of the part."""
    pdf.write_pdf(sheet(), path, DRAWING_TITLES[name], stamp.provenance)


def _write_text(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")
