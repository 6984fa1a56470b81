"""Level 1: the closed form, for one scene, for many designs at once, and with derivatives.

One formula, ``closed_probe.answer``, serves all three: ``forces`` evaluates it on arrays of designs, ``gradients`` on arrays of
complex steps, which ``closed_function`` hands to casadi, and ``ClosedForm`` on a scene and what its error is told from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from geometry.errors import Refusal
from geometry.grading import Floats
from geometry.scene import Inclusion, Scene
from solver.bessel import Array
from solver.closed_blocks import Block
from solver.closed_error import Errors, errors
from solver.closed_features import EFFECTS, STEP
from solver.closed_images import Sphere
from solver.closed_probe import FLOOR_REACH, NODES_PER_WAVE, REACH, Tissue, answer
from solver.closed_sides import side_nodes, side_radius
from solver.film_forces import FilmForces, outputs, shortfalls
from solver.result import Result, lopsided

PROBE = (
    "inner_radius", "gap", "outer_radius", "inner_height", "outer_height",
    "inner_modulus", "inner_poisson", "outer_modulus", "outer_poisson",
)  # fmt: skip
TISSUE = ("tissue_depth", "tissue_radius", "tissue_modulus", "tissue_poisson")
BALL = ("radius", "depth", "offset", "modulus", "poisson")
LEAST_COVER = 0.1  # of an inclusion, in its diameters
LARGEST_ERROR = 2.9  # of ln(ratio): beyond it the formulas say nothing
LEAST_DEPTH = 0.1  # of the tissue, in outer radii
BROKEN = "axisymmetric, as the formulas break down for this scene"
MOST = 256  # nodes over wave numbers
CHUNK = 512  # designs at once: what they need then stays in the processor's cache
np.empty(
    2**22 - 2**12
)  # glibc keeps freed arrays smaller than the largest ever freed: a third of the time would go into new ones


@dataclass(frozen=True)
class Shape:
    """What the structure of the formula depends on.

    Attributes:
        on_axis: for each inclusion, whether its centre lies on the probe's axis.
        target: index of the inclusion whose modulus ``slope`` refers to.
        nodes: of the integrals over wave numbers.
        bonded: whether blocks and tissue stick; frictionless otherwise.
        bounded: whether the tissue has a floor at ``tissue_depth``; a half-space otherwise.
        side_nodes: of the integrals for the tissue's sides at ``tissue_radius``; 0 where they are far.
    """

    on_axis: tuple[bool, ...] = (True,)
    target: int | None = 0
    nodes: int = 16
    bonded: bool = True
    bounded: bool = True
    side_nodes: int = 0


def _answer(shape: Shape, p: Array) -> tuple[Array, Array]:
    """The film forces and their slopes for parameters p, shape (parameters, n); both (n, 2, 2)."""
    r2, gap, ro, hi, ho, ei, ni, eo, no, depth, side, et, nt = p[: len(PROBE) + len(TISSUE)]
    bodies = p[len(PROBE) + len(TISSUE) :].reshape(len(shape.on_axis), len(BALL), p.shape[1])
    blocks = Block(None, r2, hi, ei, ni), Block(r2 + gap, ro, ho, eo, no)
    tissue = Tissue(depth if shape.bounded else None, et, nt, side)
    spheres = [Sphere(b[0], b[1], b[2], b[3], b[4], on_axis) for b, on_axis in zip(bodies, shape.on_axis, strict=True)]
    return answer(blocks, tissue, spheres, shape.target, shape.bonded, shape.nodes, shape.side_nodes)


def forces(shape: Shape, values: Array) -> tuple[Floats, Floats]:
    """Evaluate many designs at once, about 15 000 a second on one core with one inclusion on the axis.

    Args:
        shape: see ``Shape``; ``parameters`` makes it from a scene.
        values: the parameters PROBE, TISSUE, then BALL for each inclusion, SI, a column for each design; shape (parameters, n).

    Returns:
        the forces F_ij on film i per unit displacement of base j, N/m, and their derivatives by the logarithm of the target's
        Young's modulus (zero without a target), both of shape (n, 2, 2). Designs outside the formulas' range are not refused;
        where the equations are singular the values are NaN.
    """
    values = np.asarray(values)
    parts = [_solved(shape, values[:, k : k + CHUNK]) for k in range(0, values.shape[1], CHUNK)]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _solved(shape: Shape, values: Array) -> tuple[Array, Array]:
    """``_answer``, NaN for designs whose equations are singular."""
    try:
        return _answer(shape, values)
    except np.linalg.LinAlgError:
        if values.shape[1] == 1:
            none = np.full((1, 2, 2), np.nan, dtype=values.dtype)
            return none, none
        parts = [_solved(shape, values[:, k : k + 1]) for k in range(values.shape[1])]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def gradients(shape: Shape, values: Floats, which: Sequence[int]) -> tuple[Floats, Floats]:
    """Return ``forces`` of one design and their derivatives by some of its parameters, by complex steps: exact to rounding.

    Args:
        shape: see ``Shape``.
        values: the parameters, shape (parameters,).
        which: indices of k of them.

    Returns:
        forces and slope of the design, shape (2, 2, 2), and their derivatives, shape (k, 2, 2, 2).
    """
    steps = np.zeros((len(values), len(which)), dtype=complex)
    steps[list(which), range(len(which))] = 1e-30j * np.abs(values[list(which)])
    found = np.stack(forces(shape, values[:, None] + steps), axis=1)
    return found[0].real, found.imag / (1e-30 * np.abs(values[list(which)]))[:, None, None, None]


def parameters(scene: Scene) -> tuple[Shape, Floats]:
    """Return the formula's structure for a scene and the values of its parameters, SI."""
    probe, tissue = scene.probe, scene.tissue
    values = [probe.inner_radius, probe.gap, probe.tube_radius, probe.core_height, probe.tube_height]
    for block in (probe.inner, probe.outer):
        values += [block.youngs_modulus, block.poisson_ratio]
    depth, side = (1.0, 1.0) if tissue.shape == "half-space" else (tissue.depth, side_radius(tissue))
    values += [depth, side, tissue.youngs_modulus, tissue.poisson_ratio]
    offsets = [_offset(scene, body) for body in scene.inclusion]
    for body, offset in zip(scene.inclusion, offsets, strict=True):
        values += [(body.diameter or 0.0) / 2, body.depth, offset, body.youngs_modulus, body.poisson_ratio]
    on_axis = tuple(offset <= 1e-9 * (body.diameter or 1.0) for body, offset in zip(scene.inclusion, offsets, strict=True))
    bonded, bounded = scene.contact.interface == "bonded", tissue.shape != "half-space"
    sides = side_nodes(probe.tube_radius, depth, side) if bounded else 0
    return Shape(on_axis, scene.target, _nodes(scene), bonded, bounded, sides), np.array(values)


def _nodes(scene: Scene) -> int:
    """Nodes enough for the shallowest point of the spheres' quadrature and the waves' way across."""
    reach = [REACH / (body.depth - 0.4 * (body.diameter or 0.0)) for body in scene.inclusion]
    if scene.tissue.shape != "half-space":
        reach.append(FLOOR_REACH / scene.tissue.depth)
    across = scene.probe.tube_radius + max((_offset(scene, body) for body in scene.inclusion), default=0.0)
    needed = 8 + NODES_PER_WAVE * max(reach, default=0.0) * across
    return min(MOST, 2 * math.ceil(needed / 2))


def _offset(scene: Scene, body: Inclusion) -> float:
    return math.hypot(body.x - scene.placement.x, body.y - scene.placement.y)


@dataclass(frozen=True)
class ClosedForm:
    """Two elastic blocks on an elastic layer, spheres by equivalent inclusion with their image: a first look, and the search."""

    name: str = "closed-form"
    summary: str = "formulas; spheres anywhere, covered by a tenth of their diameter; 1 to 30 % in milliseconds"

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
        films, error = self.films(scene)
        told = outputs(scene, films)
        told["warnings"] += tuple(shortfalls(films, error.largest, accuracy))
        return Result(self.name, perf_counter() - start, **told)

    def films(self, scene: Scene) -> tuple[FilmForces, Errors]:
        """Return the film forces behind an answer and the bounds on their errors; raises as ``evaluate`` does."""
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        shape, found, slopes = variants(scene)
        if not (np.all(np.isfinite(found)) and np.all(found.sum(axis=2) > 0)):
            raise Refusal("evaluator", self.name, BROKEN)
        error = errors(scene, found, slopes, shape.side_nodes > 0)
        if error.log_ratio > LARGEST_ERROR:
            raise Refusal("evaluator", self.name, BROKEN)
        slope = slopes[0] if scene.target is not None else None
        return FilmForces(found[0], error.bound(found[0].sum(axis=1)), slope, error.sensitivity), error


def variants(scene: Scene) -> tuple[Shape, Floats, Floats]:
    """Return a scene's structure, its forces and slopes, and those that its error is told from, in the order of ``EFFECTS``.

    Forces and slopes have the shape (variants, 2, 2); where the formulas break down they are not finite or not positive.
    """
    shape, values = parameters(scene)
    with np.errstate(all="ignore"):
        return shape, *forces(shape, _variants(values))


def _variants(values: Floats) -> Floats:
    """The parameters of the variants, columns."""
    columns = {"scene": values}
    for name in ("inner_modulus", "outer_modulus"):
        columns[name] = values.copy()
        columns[name][PROBE.index(name)] *= STEP
    columns["no inclusions"] = values.copy()
    bodies = columns["no inclusions"][len(PROBE) + len(TISSUE) :].reshape(-1, len(BALL))
    bodies[:, -2:] = values[len(PROBE) + len(TISSUE) - 2 : len(PROBE) + len(TISSUE)]
    return np.stack([columns[name] for name in EFFECTS], axis=1)
