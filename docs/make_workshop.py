"""Make the pictures of ``workshop.md`` from a folder that ``probe-design export`` has written: drawing, pattern, mould."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent


def flat(path: Path, picture: Path, size: tuple[float, float]) -> None:
    """Draw a DXF file as any viewer would."""
    import ezdxf.filemanagement
    from ezdxf.addons.drawing.config import BackgroundPolicy, ColorPolicy, Configuration
    from ezdxf.addons.drawing.frontend import Frontend
    from ezdxf.addons.drawing.matplotlib import MatplotlibBackend
    from ezdxf.addons.drawing.properties import RenderContext

    document = ezdxf.filemanagement.readfile(path)
    figure, axes = canvas(size)
    colours = ColorPolicy.BLACK if "pattern" not in path.name else ColorPolicy.COLOR
    looks = Configuration(background_policy=BackgroundPolicy.WHITE, color_policy=colours, lineweight_scaling=2)
    Frontend(RenderContext(document), MatplotlibBackend(axes), config=looks).draw_layout(document.modelspace())
    figure.savefig(picture, dpi=100)


def halves(folder: Path, block: str, picture: Path) -> None:
    """Draw both halves of a mould, opened, without the quarter in front."""
    import pyvista

    from geometry.cad.solids import load_cadquery

    cq = load_cadquery()
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 700))
    for half, lift, colour in (("lower", 0.0, "#b8bcc4"), ("upper", 8.0, "#8fa8c8")):
        shape = cq.importers.importStep(str(folder / f"mould-{block}-{half}.step")).val()
        shape = shape.cut(cq.Solid.makeBox(50, 50, 100, cq.Vector(0, -50, -50))).translate(cq.Vector(0, 0, lift))
        points, triangles = shape.tessellate(0.005, 0.1)
        mesh = pyvista.PolyData.from_regular_faces([point.toTuple() for point in points], triangles)
        plotter.add_mesh(mesh, color=colour, smooth_shading=False)
        plotter.add_mesh(mesh.extract_feature_edges(30), color="black", line_width=2)
    plotter.camera_position = [(45, -60, 42), (0, 0, 5), (0, 0, 1)]
    plotter.screenshot(picture)


def canvas(size: tuple[float, float]) -> tuple[Figure, Any]:
    """Return a white figure of that size in inches, and its axes."""
    figure = Figure(figsize=size, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    return figure, axes


if __name__ == "__main__":
    made = Path(sys.argv[1])
    flat(made / "outer.dxf", HERE / "pictures" / "workshop-drawing.png", (6.0, 8.5))
    flat(made / "film-inner-pattern.dxf", HERE / "pictures" / "workshop-film.png", (8.0, 5.5))
    halves(made, "outer", HERE / "pictures" / "workshop-mould.png")
