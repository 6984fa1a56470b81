"""Convert the uncertainty budget of the ratio to tolerances of the dimensions in the workshop's drawings."""

from __future__ import annotations

import math

from geometry.cad.materials import modulus
from geometry.common.errors import InputError
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.workshop.tolerance import RECTANGULAR, Budget, Scatter
from probe_design.tolerances.budget import BudgetLine, tolerances

MM = 1e3
SAMPLES = 64  # the minimum: only the first-order part of the budget is used here
SHARP = "The tolerances from the ratio are those of a probe with sharp lower edges: no evaluator has derivatives for round ones."
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
    """Compute the deviations of a probe's dimensions that a standard deviation of the ratio allows.

    Args:
        scene: of the probe.
        tolerance: allowed standard deviation of ln ratio from dimensions, moduli and gains together: 0.01 for 1 %.

    Returns:
        The budget; without numbers, but with a remark, if no evaluator has derivatives for the scene.

    Raises:
        InputError: the tolerance is not above 0 and below 1.
    """
    check_tolerance(tolerance)
    edge = scene.contact.edge_radius
    sharp = scene.model_copy(update={"contact": scene.contact.model_copy(update={"edge_radius": 0.0})}) if edge else scene
    try:
        lines = tolerances(sharp, tolerance, samples=SAMPLES).lines
    except InputError as fault:  # no evaluator has its derivatives, or only one film is under pressure
        return Budget(100 * tolerance, remark=f"No dimension is bound by the ratio: {fault}")
    return from_lines(scene.probe, lines, tolerance, SHARP if edge else "")


def check_tolerance(tolerance: float) -> None:
    """Raise ``InputError`` unless a tolerance of the ratio is above 0 and below 1."""
    if not 0 < tolerance < 1:
        raise InputError("tolerance", tolerance, "a number above 0 and below 1, such as 0.01")


def from_lines(probe: Probe, lines: tuple[BudgetLine, ...], tolerance: float, remark: str = "") -> Budget:
    """Build the budget of the drawings from the lines of an uncertainty budget.

    A deviation is the half-width of a uniform distribution: sqrt(3) standard deviations (JCGM 100:2008, 4.3.7).
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
    """Describe a number in words: ``probe.outer.youngs_modulus`` becomes "outer block's modulus"."""
    _, part, number = name.split(".")
    what = {"youngs_modulus": "modulus", "poisson_ratio": "Poisson's ratio"}.get(number, number)
    return f"{part} {'film' if name.startswith('film') else 'block'}'s {what}"


def _scatter(line: BudgetLine) -> Scatter:
    """Build the line of a number that is no dimension of the drawings."""
    nominal = modulus(line.value) if line.kind == "modulus" else f"{line.value:.4g}"
    return Scatter(
        line.name,
        _words(line.name),
        nominal,
        line.sd / line.value if line.value else 0.0,
        line.outputs["ln_ratio"].contribution,
        line.source,
    )
