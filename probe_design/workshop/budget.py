"""What the ratio leaves each dimension of a drawing, and what else scatters it: the uncertainty budget in a workshop's words."""

from __future__ import annotations

import math

from geometry.cad.materials import modulus
from geometry.common.errors import InputError
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.workshop.tolerance import RECTANGULAR, Budget, Scatter
from probe_design.tolerances.budget import BudgetLine, tolerances

MM = 1e3
SAMPLES = 64  # the least: of the budget only the first order is used here
SHARP = "What the ratio leaves the dimensions is of the probe with sharp lower edges: no level differentiates round ones."
DIMENSIONS = {
    "probe.inner_radius": ("inner_radius",),
    "probe.gap": ("gap", "hole_radius"),
    "probe.outer_radius": ("outer_radius",),
    "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",),
    "probe.height": ("inner_height", "outer_height"),
}
"""Dimensions of the drawings, by the scene's key whose tolerance and derivative are theirs."""


def ratio_budget(scene: Scene, tolerance: float) -> Budget:
    """Return what the ratio leaves the dimensions of a scene's probe.

    Args:
        scene: whose probe.
        tolerance: standard deviation of ln ratio that dimensions, moduli and gains together may make: 0.01 for 1 %.

    Returns:
        A budget without numbers, and its remark, where no level has derivatives of the scene.

    Raises:
        InputError: no such tolerance.
    """
    check_tolerance(tolerance)
    edge = scene.contact.edge_radius
    sharp = scene.model_copy(update={"contact": scene.contact.model_copy(update={"edge_radius": 0.0})}) if edge else scene
    try:
        lines = tolerances(sharp, tolerance, samples=SAMPLES).lines
    except InputError as fault:  # of a kind that no level differentiates, or read by one film alone
        return Budget(100 * tolerance, remark=f"No dimension is bound by the ratio: {fault}")
    return from_lines(scene.probe, lines, tolerance, SHARP if edge else "")


def check_tolerance(tolerance: float) -> None:
    """Raise ``InputError`` unless a tolerance of the ratio is above 0 and below 1."""
    if not 0 < tolerance < 1:
        raise InputError("tolerance", tolerance, "a number above 0 and below 1, such as 0.01")


def from_lines(probe: Probe, lines: tuple[BudgetLine, ...], tolerance: float, remark: str = "") -> Budget:
    """Return the budget of the drawings from the lines of an uncertainty budget.

    A deviation allowed either way, anything within it being as likely, is sqrt(3) standard deviations (JCGM 100:2008, 4.3.7).
    """
    drawn = {name: line for line in lines for name in DIMENSIONS.get(line.name, ())}
    sizes = {"hole_radius": probe.hole_radius, "gap": probe.gap}
    deviations = {name: RECTANGULAR * line.held * MM for name, line in drawn.items() if line.held is not None}
    slopes = {
        name: line.outputs["ln_ratio"].derivative
        * sizes.get(name, line.value)
        / (math.sqrt(2) if line.name == "probe.height" else 1)
        for name, line in drawn.items()
    }
    others = tuple(_scatter(line) for line in lines if line.name not in DIMENSIONS)
    return Budget(100 * tolerance, deviations, slopes, others, remark)


def _words(name: str) -> str:
    """Write ``probe.outer.youngs_modulus`` as "outer block's modulus"."""
    _, part, number = name.split(".")
    what = {"youngs_modulus": "modulus", "poisson_ratio": "Poisson's ratio"}.get(number, number)
    return f"{part} {'film' if name.startswith('film') else 'block'}'s {what}"


def _scatter(line: BudgetLine) -> Scatter:
    nominal = modulus(line.value) if line.kind == "modulus" else f"{line.value:.4g}"
    return Scatter(
        line.name,
        _words(line.name),
        nominal,
        line.sd / line.value if line.value else 0.0,
        line.outputs["ln_ratio"].contribution,
        line.source,
    )
