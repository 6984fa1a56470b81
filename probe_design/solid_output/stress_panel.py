"""Draw one stress on the deformed section of a solid, with a colour scale that its singular corners do not dominate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.scenes.units import MM_PER_M
from probe_design.solid_output.faces import Faces

if TYPE_CHECKING:
    from matplotlib.axes import Axes


TAIL_QUANTILES = (0.01, 0.99)  # fractions of the shown area at which the colour scale ends: singular corners are beyond
MAX_DECADES = 2.0  # of von Mises stress in the colour scale, at most
STRESS_LABELS = {"pressure": "vertical pressure", "von_mises": "von Mises stress"}
Window = tuple[float, float, float, float]  # left, right, bottom, top


@dataclass(frozen=True)
class DeformedSection:
    """A section with exaggerated displacements.

    Attributes
    ----------
    cut
        The section as meshed.
    points
        Displaced points, mm, shape (n, 2).
    factor
        Factor of exaggeration.
    window
        Shown part, mm.
    """

    cut: Faces
    points: Floats
    factor: float
    window: Window

    @property
    def scale_text(self) -> str:
        """The factor by which displacements are exaggerated, as text: "× 20", or "true to scale" for 1."""
        factor_text = f"{self.factor:,.0f}".replace(",", " ") if self.factor >= 1 else f"{self.factor:g}"
        return "true to scale" if self.factor == 1 else f"× {factor_text}"

    def find_colour_limits(self, values: Floats) -> tuple[float, float]:
        """Return the limits between which a stress lies in the shown area, but for its ``TAIL_QUANTILES``.

        ``values`` is the stress at the points, shape (n,). Corners with a singular stress are in the tails.
        """
        corners = self.points[self.cut.triangles]
        edges, middle = corners[:, 1:] - corners[:, :1], corners.mean(axis=1)
        # twice the area of each triangle: only its fractions are used
        area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
        left, right, bottom, top = self.window
        is_shown = (left < middle[:, 0]) & (middle[:, 0] < right) & (bottom < middle[:, 1]) & (middle[:, 1] < top)
        triangle_values = values[self.cut.triangles].mean(axis=1)
        order = np.argsort(triangle_values[is_shown])
        shown_area_up_to = np.cumsum(area[is_shown][order])
        low, high = np.interp(np.array(TAIL_QUANTILES) * shown_area_up_to[-1], shown_area_up_to, triangle_values[is_shown][order])
        return float(low), float(high)


def deform_section(cut: Faces, largest: float, window: Window) -> DeformedSection:
    """Exaggerate displacements by 1, 2 or 5 times a power of ten, so that the largest is drawn about ``largest`` m."""
    displacement = cut.values["displacement"]
    length = float(np.linalg.norm(displacement, axis=1).max())
    factor = _round_down(largest / length) if length > 0 else 1.0
    if 0.1 <= factor < 1:  # visible without exaggeration
        factor = 1.0
    left, right, bottom, top = (side * MM_PER_M for side in window)
    return DeformedSection(cut, (cut.points + factor * displacement)[:, [0, 2]] * MM_PER_M, factor, (left, right, bottom, top))


def draw_stress(axes: Any, bar_axes: Any, shape: DeformedSection, name: str) -> None:
    """Draw one stress, and its colour bar in ``bar_axes``.

    ``name`` is ``pressure``, in linear colours that are white at zero, or ``von_mises``, in logarithmic ones.
    """
    low, high = shape.find_colour_limits(shape.cut.values[name])
    unit, label = _choose_unit(max(abs(low), abs(high)))
    colours, norm = (
        _build_linear_colours(low / unit, high / unit) if name == "pressure" else _build_log_colours(low / unit, high / unit)
    )
    values = np.maximum(shape.cut.values[name] / unit, norm.vmin)  # zero has no logarithm
    image = axes.tripcolor(*shape.points.T, shape.cut.triangles, values, shading="gouraud", cmap=colours, norm=norm)
    draw_mesh_lines(axes, shape.points, shape.cut.lines, 0.25)
    draw_mesh_lines(axes, shape.points, _find_outline(shape.cut.triangles), 1.1)
    axes.set(xlim=shape.window[:2], ylim=shape.window[2:], aspect="equal")
    axes.set_title(f"{STRESS_LABELS[name]}, displacements {shape.scale_text}", fontsize=10)
    bar = axes.figure.colorbar(image, cax=bar_axes, extend="both")
    if name == "von_mises":
        _label_decades(bar.ax.yaxis)
    bar.set_label(f"{label}, compression positive" if name == "pressure" else label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    label_axes(axes)


def draw_mesh_lines(axes: Axes, points: Floats, lines: NDArray[np.int64], width: float) -> None:
    """Draw pairs (m, 2) of points (n, 2) as dark lines, ``width`` in printer's points."""
    axes.add_collection(LineCollection(list(points[lines]), colors="0.15", linewidths=width, capstyle="round"))


def label_axes(axes: Axes) -> None:
    """Label the axes of a section, mm."""
    axes.set_xlabel("x, mm", fontsize=9)
    axes.set_ylabel("z, mm", fontsize=9)
    axes.tick_params(labelsize=8)


def _find_outline(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sides that belong to one triangle only: outlines of all bodies, as bodies shown_area_up_to no points."""
    sides = np.sort(triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    sides, count = np.unique(sides, axis=0, return_counts=True)
    return np.asarray(sides[count == 1])


def _build_linear_colours(low: float, high: float) -> tuple[Any, Any]:
    """Return colours from blue over white at zero to red, with the same scale on both sides, and their norm."""
    low, high = min(low, 0.0), max(high, 0.0)
    max_stress = max(-low, high) or 1.0
    shades = colormaps["RdBu_r"](np.linspace(0.5 + low / max_stress / 2, 0.5 + high / max_stress / 2, 256))
    return ListedColormap(shades), Normalize(low, high if high > low else low + 1.0)


def _build_log_colours(low: float, high: float) -> tuple[Any, Any]:
    """Return a logarithmic colour scale of at most ``MAX_DECADES`` decades, and its norm."""
    high = high if high > 0 else 1.0
    return "viridis", LogNorm(min(max(low, high / 10**MAX_DECADES), 0.5 * high), high)


def _label_decades(axis: Any) -> None:
    """Label a logarithmic axis of few decades with plain numbers in place of powers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _choose_unit(largest: float) -> tuple[float, str]:
    """Return the unit, in Pa, for a stress scale up to ``largest`` Pa, and the unit's name."""
    for unit, label in ((1e6, "MPa"), (1e3, "kPa")):
        if largest >= unit:
            return unit, label
    return 1.0, "Pa"


def _round_down(value: float) -> float:
    """Return a positive value rounded down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    # 1e-9: a value that is such a number but for rounding stays
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
