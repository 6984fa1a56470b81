"""Convert the uncertainty budget of the ratio to tolerances of the dimensions in the workshop's drawings."""

from __future__ import annotations

import math

from geometry.common.errors import InputError
from geometry.scenes.bonds import BOND_SIDES
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M, format_modulus
from geometry.scenes.variables import BLOCK_NAMES
from geometry.workshop.tolerance import DEVIATION_PER_SD, Budget, Scatter
from probe_design.tolerancing.budget import BudgetLine, compute_budget
from probe_design.tolerancing.film_numbers import FILM_PREFIX

BUDGET_SAMPLES = 64  # the minimum: only the first-order part of the budget is used here
SHARP_EDGES_REMARK = (
    "The tolerances from the ratio are those of a probe with sharp lower edges: no evaluator has derivatives for round ones."
)
DRAWING_DIMENSIONS = {
    "probe.inner_radius": ("inner_radius",),
    "probe.gap": ("gap", "hole_radius"),
    "probe.outer_radius": ("outer_radius",),
    "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",),
    "probe.height": ("inner_height", "outer_height"),
}
"""Dimensions of the drawings, by the scene's key whose tolerance and derivative are theirs."""


def compute_ratio_budget(scene: Scene, tolerance: float) -> Budget:
    """Compute the deviations of a probe's dimensions that a standard deviation of the ratio allows.

    Parameters
    ----------
    scene
        Scene of the probe.
    tolerance
        Allowed standard deviation of ln ratio from dimensions, moduli and gains together: 0.01 for 1 %.

    Returns
    -------
    Budget
        The budget; without numbers, but with a remark, if no evaluator has derivatives for the scene.

    Raises
    ------
    InputError
        The tolerance is not above 0 and below 1.
    """
    check_tolerance(tolerance)
    edge = scene.contact.edge_radius
    sharp_scene = scene.model_copy(update={"contact": scene.contact.model_copy(update={"edge_radius": 0.0})}) if edge else scene
    try:
        lines = compute_budget(sharp_scene, tolerance, samples=BUDGET_SAMPLES).lines
    except InputError as fault:  # no evaluator has its derivatives, or only one film is under pressure
        return Budget(100 * tolerance, remark=f"No dimension is bound by the ratio: {fault}")
    return build_budget(scene.probe, lines, tolerance, SHARP_EDGES_REMARK if edge else "")


def check_tolerance(tolerance: float) -> None:
    """Raise ``InputError`` unless a tolerance of the ratio is above 0 and below 1."""
    if not 0 < tolerance < 1:
        raise InputError("tolerance", tolerance, "a number above 0 and below 1, such as 0.01")


def build_budget(probe: Probe, lines: tuple[BudgetLine, ...], tolerance: float, remark: str = "") -> Budget:
    """Return the budget for the drawings, from the lines of an uncertainty budget.

    ``tolerance`` is the allowed standard deviation of ln ratio; ``remark`` is printed with the budget.

    A deviation is the half-width of a uniform distribution: sqrt(3) standard deviations (JCGM 100:2008, 4.3.7).
    """
    drawing_lines = {name: line for line in lines for name in DRAWING_DIMENSIONS.get(line.name, ())}
    sizes = {"hole_radius": probe.hole_radius, "gap": probe.gap}
    deviations = {name: DEVIATION_PER_SD * line.held * MM_PER_M for name, line in drawing_lines.items() if line.held is not None}
    # change of ln ratio per relative change of the size; one height for both blocks stands for two independent ones: sqrt(2)
    derivatives = {
        name: line.outputs["ln_ratio"].derivative
        * sizes.get(name, line.value)
        / (math.sqrt(2) if line.name == "probe.height" else 1)
        for name, line in drawing_lines.items()
    }
    scatters = tuple(_build_scatter(line) for line in lines if line.name not in DRAWING_DIMENSIONS)
    return Budget(100 * tolerance, deviations, derivatives, scatters, remark)


def _describe_number(name: str) -> str:
    """Describe a number in words: ``probe.outer.youngs_modulus`` becomes "outer block's modulus"."""
    *parts, number = name.removeprefix("probe.").split(".")
    description = {"youngs_modulus": "modulus", "poisson_ratio": "Poisson's ratio"}.get(number, number.replace("_", " "))
    if name.startswith(FILM_PREFIX):
        outer, bond = "outer film's " if "outer" in parts else "films' ", parts[-1].replace("_", " ")
        return f"{outer}{bond}, {description}" if parts[-1] in BOND_SIDES else f"{outer}{description}"
    if parts == ["film"]:
        return f"films' {description}"
    if parts[0] == "film" and parts[1] not in BLOCK_NAMES:  # a product that several bonds are of
        return f"{parts[1]}'s {description}"
    return f"{parts[-1]} {'film' if name.startswith('film') else 'block'}'s {description}"


def _build_scatter(line: BudgetLine) -> Scatter:
    """Return the scatter of a number that is no dimension of the drawings, such as a modulus or a gain."""
    nominal = format_modulus(line.value) if line.kind == "modulus" else f"{line.value:.4g}"
    if line.kind == "temperature":
        nominal = f"0 \N{PLUS-MINUS SIGN} {line.sd:g} K"
    elif line.kind == "length":
        nominal = f"{MM_PER_M * line.value:.4g} mm"
    elif line.kind == "charge":
        nominal = f"{1e12 * line.value:.4g} pC/N"
    return Scatter(
        line.name,
        _describe_number(line.name),
        nominal,
        line.sd / abs(line.value) if line.value else 0.0,
        line.outputs["ln_ratio"].contribution,
        line.source,
    )
