"""Print sheets as PDF at their true scale, with searchable text."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.provenance.block import Provenance
from geometry.provenance.texts import build_picture_metadata
from geometry.workshop.sheet import PAPER_SIZES_MM, DrawingSheet

if TYPE_CHECKING:
    from ezdxf.entities.mtext import MText
    from ezdxf.entities.text import Text
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MM_PER_INCH = 25.4
CAPITAL_HEIGHT_FRACTION = 0.72  # of the font size: height of capitals and figures in Helvetica and DejaVu Sans


def write_pdf(sheet: DrawingSheet, path: Path, title: str, origin: Provenance | None = None) -> None:
    """Print a sheet as PDF at its true scale, with the provenance ``origin``. Raises ``OSError``."""
    import matplotlib  # standard PDF fonts: embedding subsets of others takes longer than the drawing

    with matplotlib.rc_context({"pdf.use14corefonts": True}):
        figure = draw_figure(sheet)
        for text in figure.axes[0].texts:
            text.set(fontfamily="Helvetica", fontweight="medium")
        figure.savefig(
            path, format="pdf", metadata={"Title": title, "CreationDate": None, **build_picture_metadata("pdf", origin)}
        )


def draw_figure(sheet: DrawingSheet) -> Figure:
    """Return the sheet as a matplotlib figure of the paper's size."""
    from ezdxf.addons.drawing.config import BackgroundPolicy, ColorPolicy, Configuration, TextPolicy
    from ezdxf.addons.drawing.frontend import Frontend
    from ezdxf.addons.drawing.matplotlib import MatplotlibBackend
    from ezdxf.addons.drawing.properties import RenderContext
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = PAPER_SIZES_MM[sheet.size]
    figure = Figure(figsize=(width / MM_PER_INCH, height / MM_PER_INCH), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    looks = Configuration(
        color_policy=ColorPolicy.BLACK,
        background_policy=BackgroundPolicy.WHITE,
        text_policy=TextPolicy.IGNORE,
        lineweight_scaling=72 / MM_PER_INCH,  # to points
        min_lineweight=0.2,
    )
    Frontend(RenderContext(sheet.document), MatplotlibBackend(axes, adjust_figure=False), config=looks).draw_layout(
        sheet.model, finalize=False
    )
    for text in list_texts(sheet):
        _draw_text(axes, sheet, text)
    axes.set(xlim=(0, width * sheet.mm_per_paper_mm), ylim=(0, height * sheet.mm_per_paper_mm))
    axes.set_axis_off()
    return figure


def list_texts(sheet: DrawingSheet) -> list[MText | Text]:
    """Return all lines of text on the sheet, including those of dimensions."""
    from ezdxf.entities.dimension import Dimension
    from ezdxf.entities.mtext import MText
    from ezdxf.entities.text import Text

    texts: list[MText | Text] = [entity for entity in sheet.model if isinstance(entity, Text)]
    for dimension in sheet.model:
        if isinstance(dimension, Dimension):
            texts += [part for part in dimension.virtual_entities() if isinstance(part, MText)]
    return texts


def _draw_text(axes: Axes, sheet: DrawingSheet, text: MText | Text) -> None:
    """Draw a line of text of the sheet by matplotlib, at the same place, height and angle."""
    from ezdxf.entities.mtext import MText

    if isinstance(text, MText):
        content, place, height = str(text.plain_text()), text.dxf.insert, text.dxf.char_height
        turn, horizontal, vertical = text.get_rotation(), "center", "center"
    else:
        alignment, first, second = text.get_placement()
        content, height, turn = text.dxf.text, text.dxf.height, text.dxf.rotation
        place, horizontal, vertical = second or first, alignment.name.lower(), "baseline"
    points, turn = height / sheet.mm_per_paper_mm / CAPITAL_HEIGHT_FRACTION * 72 / MM_PER_INCH, round(math.remainder(turn, 360))
    axes.text(place[0], place[1], content, fontsize=points, rotation=turn, ha=horizontal, va=vertical, parse_math=False)
