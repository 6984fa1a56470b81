"""What a reference block does to the two films, predicted: the share of each, its error and its slopes by the design.

Only ln rho counts, rho = F_inner / F_outer: the sum of both forces is the load's, whatever probe and tissue are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Placement, Scene
from geometry.scenes.units import SI
from geometry.scenes.variables import changed, values
from probe_design.built_probe.bench import Reference, Workshop
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.gradients import gradients
from solver.axisymmetric.level import Axisymmetric
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_check import REMEDY, why
from solver.planning.load_limits import largest
from solver.planning.loads import LoadRule
from solver.results.film_forces import outputs

ACCURACY = 1e-3
LINEAR = 0.01  # accuracy at which a load is allowed
STEP = 1e-5  # relative, of the central difference of the nominal areas' ratio, which is a polynomial
TISSUE = "tissue.youngs_modulus"
MODULI = "reference.youngs_modulus"  # a variable beside the design's: all blocks' moduli off by one relative change


@dataclass(frozen=True)
class Share:
    """A reference block's prediction.

    Attributes:
        log_ratio: ln(F_inner / F_outer).
        bound: on its error by the solver.
        slopes: its derivatives by the design's variables, per SI unit, shape (v,).
        by_modulus: d log_ratio / d ln of the block's modulus.
        rule: for loads on the block; None: the load does not matter.
    """

    log_ratio: float
    bound: float
    slopes: Floats
    by_modulus: float
    rule: LoadRule | None = None

    def variance(self, reference: Reference) -> float:
        """Of ``log_ratio`` by the block's modulus and, as evenly spread within its bound (GUM 4.3.7), the solver's error."""
        return (self.by_modulus * reference.tolerance) ** 2 + self.bound**2 / 3

    def under(self, force: float, name: str, linear: bool) -> Share:
        """Return the prediction under a force, N, whose finite strain its bound then counts.

        Raises:
            Refusal: the force is beyond what linear elasticity allows; ``linear`` allows all of which anything is known.
        """
        if self.rule is None:
            return self
        limit, known = largest(self.rule, LINEAR, promise=False), self.rule.knows(force)
        if force > limit.force and not (linear and known):
            remedy = f", {REMEDY}" if known else ""
            raise Refusal(
                "load", Words(f"{force:.3g} N on the {name}"), f"up to {limit.force:.3g} N ({why(limit, LINEAR)}){remedy}"
            )
        return replace(self, bound=self.bound - math.log1p(-self.rule.ratio_change(force)))


@dataclass(frozen=True)
class Shares:
    """The predictions for all tissue blocks of a bench, for one design.

    Attributes:
        variables: keys of ``geometry.scenes.variables.values``, the design's, and MODULI: v of them.
        nominal: their values, SI, shape (v,); of MODULI 1.
        blocks: one for each.
        unmeasured: standard deviations of ln E by variable, of moduli that are the catalogue's and were not measured.
    """

    variables: tuple[str, ...]
    nominal: Floats
    blocks: tuple[Share, ...]
    unmeasured: Mapping[str, float] = field(default_factory=dict)

    @property
    def log_ratios(self) -> Floats:
        """Shape (blocks,)."""
        return np.array([one.log_ratio for one in self.blocks])

    @property
    def slopes(self) -> Floats:
        """Shape (blocks, v)."""
        return np.array([one.slopes for one in self.blocks]).reshape(len(self.blocks), len(self.variables))

    def under(self, forces: Sequence[float], references: Sequence[Reference], linear: bool) -> Shares:
        """Return the predictions under forces, N, on those of the references that are tissue; see ``Share.under``."""
        blocks = [(force, one.name) for force, one in zip(forces, references, strict=True) if one.on == "tissue"]
        return replace(self, blocks=tuple(share.under(*block, linear) for share, block in zip(self.blocks, blocks, strict=True)))

    def tolerances(self, workshop: Workshop) -> Floats:
        """Standard deviations of the variables, SI, shape (v,); the catalogue's of moduli that nobody has measured."""
        known = {name: sd * self.nominal[self.variables.index(name)] for name, sd in self.unmeasured.items()}
        held = zip(self.variables, self.nominal, strict=True)
        return np.array([known.get(name, _tolerance(name, value, workshop)) for name, value in held])


def predicted(scene: Scene, references: Sequence[Reference]) -> Shares:
    """Predict the references that are tissue.

    Args:
        scene: its probe, contact and kind of tissue count; inclusions, placement and tilt do not.
        references: those on ``inner`` and ``outer`` are left out, since they need no prediction.

    Raises:
        Refusal: the meridian level cannot take the probe, or a film is not pressed.
    """
    by_radius = by_outer_radius(scene)
    names = tuple(key for key in values(by_radius) if key.startswith("probe."))
    blocks = tuple(_share(on_block(by_radius, one), names) for one in references if one.on == "tissue")
    nominal = values(by_radius)
    bodies = {"probe.inner.youngs_modulus": scene.probe.inner, "probe.outer.youngs_modulus": scene.probe.outer}
    unmeasured = {name: body.unmeasured.log_sd for name, body in bodies.items() if body.unmeasured is not None}
    return Shares((*names, MODULI), np.array([*(nominal[name] for name in names), 1.0]), blocks, unmeasured)


def log_ratios(scene: Scene, references: Sequence[Reference]) -> Floats:
    """Return ln(F_inner / F_outer) alone on the references that are tissue, shape (blocks,); see ``predicted``."""
    by_radius = by_outer_radius(scene)
    return np.array([_solved(on_block(by_radius, one))[1] for one in references if one.on == "tissue"])


def inner_shares(log_ratios: Floats, references: Sequence[Reference]) -> Floats:
    """Return the share of the load that the inner film feels on each reference, shape (n,).

    Args:
        log_ratios: ln(F_inner / F_outer) on those that are tissue, in their order.
        references: pin and ring press one film alone.
    """
    blocks = iter(expit(log_ratios))
    known = ({"inner": 1.0, "outer": 0.0}.get(one.on) for one in references)
    return np.array([next(blocks) if share is None else share for share in known])


def on_block(scene: Scene, reference: Reference) -> Scene:
    """Return the scene's probe in the middle of a homogeneous block."""
    tissue = scene.tissue.model_copy(update={"youngs_modulus": reference.youngs_modulus, "layer": ()})
    data = scene.model_dump(exclude_unset=True, exclude={"inclusion", "tissue", "placement"})
    upright = data | {"tissue": tissue.model_dump(exclude_unset=True), "placement": Placement().model_dump()}
    return Scene.model_validate(upright, context=SI)


def by_outer_radius(scene: Scene) -> Scene:
    """Return the scene with its probe written by its outer radius, which is what a workshop measures."""
    probe = scene.probe.model_dump(exclude_unset=True, exclude={"area_ratio"}) | {"outer_radius": scene.probe.tube_radius}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI)


def _solved(scene: Scene) -> tuple[Converged, float]:
    """The probe on a block, and ln(F_inner / F_outer) there."""
    solution = Axisymmetric().converged(scene, ACCURACY)
    ratio = outputs(scene, solution.films[0])["ratio"]
    if ratio is None or ratio <= 0:
        raise Refusal("reference.youngs_modulus", scene.tissue.youngs_modulus, "one on which both films are pressed")
    return solution, math.log(ratio * scene.probe.inner_area / scene.probe.outer_area)


def _share(scene: Scene, names: tuple[str, ...]) -> Share:
    solution, log_ratio = _solved(scene)
    gradient = gradients(scene, solution.sample)
    by_name = dict(zip(gradient.variables, gradient.derivatives["ratio"][0] / gradient.values["ratio"][0], strict=True))
    by_modulus = float(by_name[TISSUE] * scene.tissue.youngs_modulus)
    slopes = np.array([*(by_name.get(name, 0.0) + _by_areas(scene, name) for name in names), by_modulus])
    rule = CoarseModel(scene, solution.sample, ()).rule(scene)
    return Share(log_ratio, solution.films[0].bound.log_ratio, slopes, by_modulus, rule)


def _by_areas(scene: Scene, name: str) -> float:
    """Derivative of ln(A_inner / A_outer), which turns a ratio of stresses into one of forces."""
    if name not in ("probe.inner_radius", "probe.outer_radius", "probe.gap"):
        return 0.0
    step = STEP * values(scene)[name]
    high, low = (changed(scene, {name: values(scene)[name] + turn}).probe for turn in (step, -step))
    return math.log(high.inner_area / high.outer_area * low.outer_area / low.inner_area) / (2 * step)


def _tolerance(name: str, value: float, workshop: Workshop) -> float:
    if name == MODULI:  # each block's own tolerance counts, see ``Share.variance``
        return 0.0
    if name.endswith("modulus"):
        return workshop.modulus * value
    return workshop.poisson_ratio if name.endswith("poisson_ratio") else workshop.length
