"""Level 1: the closed form of PHYSICS section 3 as one casadi function, with exact derivatives.

The function serves the search (IPOPT differentiates it) and ``probe-design evaluate`` alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from geometry.errors import Refusal
from geometry.grading import Floats
from geometry.scene import Inclusion, Scene
from solver.compatibility import Ball, Block, Layer, film_forces
from solver.details import details
from solver.film_forces import Bound, FilmForces, outputs
from solver.result import Result, lopsided

PROBE = (
    "inner_radius", "gap", "outer_radius", "inner_height", "outer_height",
    "inner_modulus", "inner_poisson", "outer_modulus", "outer_poisson",
)  # fmt: skip
TISSUE = ("tissue_depth", "tissue_modulus", "tissue_poisson")
BALL = ("radius", "depth", "offset", "modulus", "poisson")
RINGS = 3  # per block
LEAST_COVER = 0.1  # of an inclusion, in its diameters
LARGEST_ERROR = 2.3  # of ln(ratio): beyond it the formulas say nothing
LEAST_DEPTH = 0.1  # of the tissue, in outer radii


@dataclass(frozen=True)
class Shape:
    """What the structure of the formula depends on.

    Attributes:
        on_axis: for each inclusion, whether its centre lies on the probe's axis.
        target: index of the inclusion whose modulus ``slope`` refers to.
        nodes: of the quadrature over the tissue's depth; 0 for a half-space.
        rings: per block.
    """

    on_axis: tuple[bool, ...] = (True,)
    target: int | None = 0
    nodes: int = 24
    rings: int = RINGS


@lru_cache(maxsize=32)
def function(shape: Shape) -> Any:
    """Return the casadi function: parameters (PROBE, TISSUE, then BALL for each inclusion) to (forces, slope, shares).

    Film forces F_ij per unit displacement of base j in N/m and their derivative by the logarithm of
    the target's Young's modulus (zero without one), both 2 x 2; and the derivatives of ln(ratio) by
    the logarithms of the inner and the outer block's modulus.
    """
    p = ca.SX.sym("p", len(PROBE) + len(TISSUE) + len(BALL) * len(shape.on_axis))
    r2, gap, ro, hi, ho, ei, ni, eo, no, depth, et, nt = ca.vertsplit(p[: len(PROBE) + len(TISSUE)])
    bodies = [ca.vertsplit(p[k : k + len(BALL)]) for k in range(len(PROBE) + len(TISSUE), p.shape[0], len(BALL))]
    balls = [
        Ball(body[0], body[1], body[2], body[3], body[4], on_axis) for body, on_axis in zip(bodies, shape.on_axis, strict=True)
    ]
    layer = Layer(depth if shape.nodes else None, et, nt, shape.nodes)
    forces = film_forces(Block(0.0, r2, hi, ei, ni), Block(r2 + gap, ro, ho, eo, no), layer, balls, shape.rings)
    slope = ca.SX.zeros(2, 2)
    if shape.target is not None:
        modulus = bodies[shape.target][BALL.index("modulus")]
        slope = ca.reshape(ca.jacobian(ca.vec(forces), modulus) * modulus, 2, 2)
    totals = ca.sum2(forces)
    shares = ca.jacobian(ca.log(totals[0] / totals[1]), ca.vertcat(ei, eo)) * ca.horzcat(ei, eo)
    return ca.Function("closed_form", [p], [forces, slope, shares], ["p"], ["forces", "slope", "shares"])


def parameters(scene: Scene) -> tuple[Shape, Floats]:
    """Return the formula's structure for a scene and the values of its parameters, SI."""
    probe, tissue = scene.probe, scene.tissue
    depth = 1.0 if tissue.shape == "half-space" else tissue.depth
    values = [probe.inner_radius, probe.gap, probe.tube_radius, probe.core_height, probe.tube_height]
    for block in (probe.inner, probe.outer):
        values += [block.youngs_modulus, block.poisson_ratio]
    values += [depth, tissue.youngs_modulus, tissue.poisson_ratio]
    offsets = [_offset(scene, body) for body in scene.inclusion]
    for body, offset in zip(scene.inclusion, offsets, strict=True):
        values += [(body.diameter or 0.0) / 2, body.depth, offset, body.youngs_modulus, body.poisson_ratio]
    on_axis = tuple(offset <= 1e-9 * (body.diameter or 1.0) for body, offset in zip(scene.inclusion, offsets, strict=True))
    nodes = 0 if tissue.shape == "half-space" else _nodes(probe.tube_radius / depth)
    return Shape(on_axis, scene.target, nodes), np.array(values)


def _nodes(radius_per_depth: float) -> int:
    """Enough nodes for eq. (H2): 24 up to 0.8 depths, then in proportion, in steps so that few functions are built."""
    return 24 * max(1, math.ceil(radius_per_depth / 0.8))


def _offset(scene: Scene, body: Inclusion) -> float:
    return math.hypot(body.x - scene.placement.x, body.y - scene.placement.y)


@dataclass(frozen=True)
class ClosedForm:
    """Two blocks of ring pressures on an elastic layer, inclusions by Eshelby's polarisation: a first look, and the search."""

    name: str = "closed-form"
    summary: str = "formulas; spheres anywhere, covered by a tenth of their diameter; 5 to 50 % in milliseconds"

    def refusal(self, scene: Scene) -> str | None:
        """Say which kind of thing in the scene the formulas do not know, or None."""
        if lopsided(scene) is not None:
            return lopsided(scene)
        if any(body.diameter is None for body in scene.inclusion):
            return "equivalent-inclusion or solid for an ellipsoid"
        if any(body.depth - body.diameter / 2 < LEAST_COVER * body.diameter for body in scene.inclusion if body.diameter):
            return f"axisymmetric for an inclusion covered by less than {LEAST_COVER:g} of its diameter"
        if scene.tissue.shape != "half-space" and scene.tissue.depth < LEAST_DEPTH * scene.probe.tube_radius:
            return f"axisymmetric for tissue thinner than {LEAST_DEPTH:g} outer radii"
        return None

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Answer as well as the formulas can, with a warning where that is worse than ``accuracy``.

        Raises:
            Refusal: the scene is of another kind, or the formulas break down.
        """
        start = perf_counter()
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        shape, values = parameters(scene)
        forces, slope, shares = (np.array(part) for part in function(shape)(values))
        error = _log_error(scene, shape, values, forces, shares)
        if not (np.all(np.isfinite(forces)) and np.all(forces.sum(axis=1) > 0) and error < LARGEST_ERROR):
            raise Refusal("evaluator", self.name, "axisymmetric, as the formulas break down for this scene")
        told = outputs(scene, FilmForces(forces, Bound(np.zeros(2), error), slope if scene.target is not None else None))
        if told["error_estimate"] > accuracy:
            told["warnings"] += (
                f"an error bound of {told['error_estimate']:.2g} is what the formulas reach, accuracy {accuracy:g} asked for",
            )
        return Result(self.name, perf_counter() - start, **told)


def _log_error(scene: Scene, shape: Shape, values: Floats, forces: Floats, shares: Floats) -> float:
    """Bound on the error of ln(ratio), eq. (C5): what the formulas leave out, each by how much it matters in this scene.

    5 % of each single force for interface shear, which counts for more where they cancel; 0.6 of what
    cutting the blocks into rings changed; all that the inclusions change (their reflection at the
    surface is missing); 0.3 of what the tissue's free sides do to the stiffness; 0.3 of the blocks'
    share (they are no springs); all of groove, film and base. The factors were chosen on random
    scenes against ``axisymmetric`` and are audited on others by ``benchmarks/closed_form.py``.
    """
    probe_and_tissue = len(PROBE) + len(TISSUE)
    even = np.array(function(replace(shape, rings=1))(values)[0])
    bare = np.array(function(replace(shape, on_axis=(), target=None))(values[:probe_and_tissue])[0])
    extra = sum(detail.bound(forces).log_ratio for detail in details(scene.probe))
    rings, inclusions = abs(_log_ratio(even, forces)), abs(_log_ratio(bare, forces))
    cancelled = (np.abs(forces).sum(axis=1) / np.abs(forces.sum(axis=1))).sum()
    return float(0.05 * cancelled + 0.6 * rings + inclusions + 0.3 * _sides(scene, forces) + 0.3 * np.abs(shares).sum() + extra)


def _log_ratio(one: Floats, other: Floats) -> float:
    """The change of ln(ratio) from one set of film forces to another; inf where a film is pulled."""
    a, b = one.sum(axis=1), other.sum(axis=1)
    if not (np.all(a > 0) and np.all(b > 0)):
        return math.inf
    return float(np.log(a[0] / a[1]) - np.log(b[0] / b[1]))


def _sides(scene: Scene, forces: Floats) -> float:
    """By how much, in logarithms, the shortening of the tissue as a column adds to the indentation."""
    tissue = scene.tissue
    if tissue.shape == "half-space":
        return 0.0
    area = math.pi * tissue.radius**2 if tissue.shape == "cylinder" else tissue.length * tissue.breadth
    return math.log1p(float(forces.sum()) * tissue.depth / (tissue.youngs_modulus * area))
