"""What the ratio leaves each dimension of a drawing, from the uncertainty budget of the probe as built.

The budget holds radii and gap; a workshop holds radii: the inner block's and the hole's, whose difference the gap is. With
S = d ln ratio / dx at a fixed gap or radius, what turns with each of them while the other stays is

    S_hole = S_gap,   S_inner = S_radius - S_gap.   (WO.1)

A deviation allowed either way, anything within it being as likely, is sqrt(3) standard deviations (JCGM 100:2008, 4.3.7).
"""

from __future__ import annotations

import math
from dataclasses import replace

from geometry.common.errors import InputError
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.workshop.tolerance import Budget
from probe_design.tolerances.budget import BudgetLine, tolerances

RECTANGULAR = math.sqrt(3)
MM = 1e3
SAMPLES = 64  # the least: of the budget only the first order is used here
SHARP = "What the ratio leaves the dimensions is of the probe with sharp lower edges: no level differentiates round ones."
SAME = {
    "probe.outer_radius": ("outer_radius",),
    "probe.inner_height": ("inner_height",),
    "probe.outer_height": ("outer_height",),
    "probe.groove.width": ("groove_width",),
    "probe.groove.depth": ("groove_depth",),
    "probe.gap": ("gap", "hole_radius"),
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
        lines = tolerances(_by_heights(sharp), tolerance, samples=SAMPLES).lines
    except InputError as fault:  # of a kind that no level differentiates, or read by one film alone
        return Budget(100 * tolerance, remark=f"No dimension is bound by the ratio: {fault}")
    found = of_lines(scene.probe, {line.name: line for line in lines}, tolerance)
    return replace(found, remark=SHARP) if edge else found


def check_tolerance(tolerance: float) -> None:
    """Raise ``InputError`` unless a tolerance of the ratio is above 0 and below 1."""
    if not 0 < tolerance < 1:
        raise InputError("tolerance", tolerance, "a number above 0 and below 1, such as 0.01")


def _by_heights(scene: Scene) -> Scene:
    """Return the scene with a height of each block, which are two dimensions; an elastic base lies on both and has one."""
    height = scene.probe.height
    if height is None or not scene.probe.base.rigid:
        return scene
    probe = scene.probe.model_dump(exclude_unset=True, exclude={"height"}) | {"inner_height": height, "outer_height": height}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe})


def of_lines(probe: Probe, lines: dict[str, BudgetLine], tolerance: float) -> Budget:
    """Return the budget of the drawings' dimensions from the lines of a budget, by their names; see eq. WO.1."""
    slopes = {name: line.outputs["ln_ratio"].derivative for name, line in lines.items()}
    sizes = {"inner_radius": probe.inner_radius, "hole_radius": probe.hole_radius, "outer_radius": probe.tube_radius}
    there = {name: key for key, names in SAME.items() if key in lines for name in names}
    found = {name: (lines[key].held, slopes[key]) for name, key in there.items()}
    radius = lines["probe.inner_radius"]
    alone = slopes["probe.inner_radius"] - slopes["probe.gap"]
    if radius.held is not None and alone:
        found["inner_radius"] = radius.held * abs(slopes["probe.inner_radius"] / alone), alone
    deviations = {name: RECTANGULAR * sd * MM for name, (sd, _) in found.items() if sd is not None}
    values = {name: sizes[name] if name in sizes else lines[there[name]].value for name in found}
    return Budget(100 * tolerance, deviations, {name: slope * values[name] for name, (_, slope) in found.items()})
