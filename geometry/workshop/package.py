"""All that a workshop gets beside the solids: by file name, what writes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from geometry.cad import solids
from geometry.cad.export import Writer
from geometry.cad.stamp import Stamp, stamp_of
from geometry.scenes.probe import Probe
from geometry.workshop import assembly_order, drawings, film_pattern, lists, mould_sizes, moulds, pdf
from geometry.workshop.casting_notes import casting_notes, gap_note
from geometry.workshop.dxf_properties import signed
from geometry.workshop.parts import TITLES, PartView, assembly_view, part_views, parts_list
from geometry.workshop.sheet import DrawingSheet
from geometry.workshop.tolerance import CASTING, UNBOUND, Budget


@dataclass(frozen=True)
class Casting:
    """How the blocks are cast.

    Attributes:
        shrinkage: linear, of the elastomer while it cures.
        draft: of the moulds' walls in rad, at most; see ``geometry.workshop.mould_sizes.choose_draft``.
    """

    shrinkage: float = mould_sizes.SHRINKAGE
    draft: float = mould_sizes.DRAFT


USUAL = Casting()


def writers(probe: Probe, edge_radius: float = 0.0, budget: Budget = UNBOUND, casting: Casting = USUAL) -> dict[str, Writer]:
    """Return drawings (DXF and PDF), film patterns, moulds, bill of materials, tolerances and the order of assembly.

    They are what ``geometry.cad.export.export_parts`` takes as ``other_files``.

    Args:
        probe: what is built.
        edge_radius: of the blocks' lower edges, m.
        budget: what the ratio leaves the dimensions.
        casting: how the blocks are cast.

    Raises:
        InputError: no such casting; see also ``geometry.scenes.base_sizes.base_sizes``.
    """
    stamp = stamp_of(probe, edge_radius)
    views = {**part_views(probe, edge_radius), "assembly": assembly_view(probe, edge_radius)}
    every = mould_sizes.mould_sizes(probe, edge_radius, casting.shrinkage, casting.draft)
    sizes = tuple(one for one in every if stamp.materials[one.name].process == CASTING)
    patterns = film_pattern.film_patterns(probe)
    found = _drawings(probe, views, stamp, budget, cast={mould.name: mould for mould in sizes})
    for pattern in patterns:
        thickness = solids.film_thickness(probe) * solids.MM
        found[f"{pattern.name}-pattern.dxf"] = partial(film_pattern.write, pattern, stamp, thickness)
    for mould in sizes:
        for half in moulds.HALVES:
            found[moulds.file_name(mould, half)] = partial(moulds.write, mould, half, stamp)
    dimensions = lists.held_dimensions(views.values(), stamp.materials, budget)
    scatter = lists.scatter_of_ratio(dimensions, budget)
    texts = {
        "bill-of-materials.csv": lists.bill_of_materials(probe, stamp, sizes, edge_radius),
        "tolerances.csv": lists.tolerances(dimensions, budget),
        "assembly.md": assembly_order.assembly_order(probe, stamp, patterns, sizes, budget=budget, scatter=scatter),
    }
    return found | {name: partial(_write, text) for name, text in texts.items()}


def _drawings(
    probe: Probe, views: dict[str, PartView], stamp: Stamp, budget: Budget, *, cast: Mapping[str, mould_sizes.MouldSizes]
) -> dict[str, Writer]:
    """Return what writes both forms of each drawing; the sheet is made once, when the first of them is written."""
    found: dict[str, Writer] = {}
    for name, view in views.items():
        extra = parts_list(probe, stamp.materials) if name == "assembly" else ()
        extra += casting_notes(cast[name], budget) if name in cast else ()
        extra += (gap_note(probe, tuple(cast.values())),) if name == "assembly" and cast else ()
        sheet = cache(partial(drawings.draw, view, stamp, budget, extra))
        found[f"{name}.dxf"] = partial(_write_dxf, sheet, stamp)
        found[f"{name}.pdf"] = partial(_write_pdf, sheet, name, stamp)
    return found


def _write_dxf(sheet: Callable[[], DrawingSheet], stamp: Stamp, path: Path) -> None:
    signed(sheet().document, stamp).saveas(path)


def _write_pdf(sheet: Callable[[], DrawingSheet], name: str, stamp: Stamp, path: Path) -> None:
    pdf.write(sheet(), path, TITLES[name], stamp.provenance)


def _write(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")
