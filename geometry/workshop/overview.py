"""Draw an overview page: the assembly's section and plan with the dimensions of all parts, and a cutaway view."""

from __future__ import annotations

from pathlib import Path

from geometry.cad import solids
from geometry.cad.stamp import build_stamp
from geometry.common.files import write_whole
from geometry.provenance.texts import build_picture_metadata
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M
from geometry.workshop import cutaway, drawings, pdf
from geometry.workshop.parts import build_overview, list_parts
from geometry.workshop.sheet import format_number
from geometry.workshop.tolerance import NO_BUDGET

PIXELS_PER_INCH = 150


def draw_probe(probe: Probe, path: Path, edge_radius: float = 0.0) -> Path:
    """Write the overview of a probe as a PNG, dimensions in mm; return ``path``.

    Parameters
    ----------
    probe
        The probe to be drawn.
    path
        Path of the PNG.
    edge_radius
        Radius of the blocks' lower edges, m; 0: sharp.

    Raises
    ------
    ExportError, InputError, MissingLibrary
        See ``solids.build_parts``.
    OSError
        The file cannot be written.
    """
    shapes, stamp = solids.build_parts(probe, edge_radius), build_stamp(probe, edge_radius)
    notes = (*list_parts(probe, stamp.materials), *_list_notes(probe, edge_radius))
    figure = pdf.draw_figure(drawings.draw_part(build_overview(probe, edge_radius), stamp, NO_BUDGET, notes))
    width, height = figure.get_size_inches()
    figure.set_size_inches(2 * width, height)  # the sheet on the left, the cutaway on the right
    figure.axes[0].set_position((0.0, 0.0, 0.5, 1.0))
    cutaway.draw_cutaway(figure.add_axes((0.5, 0.1, 0.5, 0.8), projection="3d"), shapes, probe.hole_radius * MM_PER_M)
    with write_whole(Path(path)) as draft:
        figure.savefig(draft, format="png", dpi=PIXELS_PER_INCH, metadata=build_picture_metadata("png"))
    return Path(path)


def _list_notes(probe: Probe, edge_radius: float) -> list[str]:
    """Return what the views do not show: areas of the blocks' ends, the groove's width, round edges, missing films."""
    cut = probe.groove_footprint
    areas = {"inner end A2": probe.inner_area, "outer end A1": probe.outer_area}
    areas |= {"groove's footprint": cut} if cut else {}
    texts = [f"{name} = {area * MM_PER_M**2:.6g} mm\u00b2" for name, area in areas.items()]
    notes = [", ".join([*texts, f"A2/A1 = {probe.inner_area / probe.outer_area:.6g}"])]
    if probe.groove is not None:
        notes.append(f"groove {format_number(probe.groove.width * MM_PER_M)} wide, on the side of +x only")
    if edge_radius:
        notes.append(f"lower edges R {format_number(edge_radius * MM_PER_M)}; A1, A2 as if sharp")
    return notes if probe.film is not None else [*notes, "no films: the scene has none"]
