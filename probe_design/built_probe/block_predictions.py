"""Predict the films' fractions of the load on reference blocks, with errors and derivatives with respect to the design.

Only ln rho is predicted, rho = F_inner / F_outer with the films' forces F: their sum is the load, for any probe and tissue.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Placement
from geometry.scenes.units import SI_CONTEXT
from geometry.scenes.variables import list_values
from geometry.workshop.tolerance import find_length_sd
from probe_design.built_probe.bench import Reference, Workshop
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import compute_gradients
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_check import LINEAR_REMEDY, explain_limit
from solver.planning.load_limits import find_largest_load
from solver.planning.loads import LoadRule
from solver.results.film_forces import compute_result_fields

PREDICTION_ACCURACY = 1e-3  # relative accuracy of the solver
LINEARITY_ACCURACY = 0.01  # largest relative change by finite strain at which a load is allowed
TISSUE_MODULUS = "tissue.youngs_modulus"
BLOCK_MODULI = "reference.youngs_modulus"  # an additional variable: one relative change of all blocks' moduli


@dataclass(frozen=True)
class BlockPrediction:
    """The prediction for a reference block.

    Attributes
    ----------
    log_ratio
        ln(F_inner / F_outer).
    bound
        Bound on the solver's error of ``log_ratio``.
    derivatives
        Derivatives of ``log_ratio`` with respect to the design's variables, per SI unit, shape (v,).
    modulus_derivative
        Derivative of ``log_ratio`` with respect to the logarithm of the block's modulus.
    rule
        Limits of loads on the block; None: the load does not matter.
    """

    log_ratio: float
    bound: float
    derivatives: Floats
    modulus_derivative: float
    rule: LoadRule | None = None

    def compute_variance(self, reference: Reference) -> float:
        """Return the variance of ``log_ratio`` due to the block's modulus and the solver's error.

        The solver's error is uniformly distributed from -bound to bound, so that its variance is bound^2 / 3.
        """
        return (self.modulus_derivative * reference.tolerance) ** 2 + self.bound**2 / 3

    def apply_force(self, force: float, name: str, linear: bool) -> BlockPrediction:
        """Return the prediction under a force, with the effect of finite strain added to the bound.

        Parameters
        ----------
        force
            Load on the block, N.
        name
            Of the block, for messages.
        linear
            Whether to allow a force above the limit of linear elasticity, if its effect can be estimated.

        Raises
        ------
        Refusal
            The force is above the limit of linear elasticity, and is not allowed by ``linear``.
        """
        if self.rule is None:
            return self
        limit, is_known = find_largest_load(self.rule, LINEARITY_ACCURACY, promise=False), self.rule.is_known(force)
        if force > limit.force and not (linear and is_known):
            remedy = f", {LINEAR_REMEDY}" if is_known else ""
            allowed = f"up to {limit.force:.3g} N ({explain_limit(limit, LINEARITY_ACCURACY)}){remedy}"
            raise Refusal("load", Words(f"{force:.3g} N on the {name}"), allowed)
        # finite strain may reduce the ratio to (1 - change) times itself: -ln(1 - change) is added to the bound on ln ratio
        return replace(self, bound=self.bound - math.log1p(-self.rule.bound_ratio_change(force)))


@dataclass(frozen=True)
class BlockPredictions:
    """The predictions for all tissue blocks of a bench, for one design.

    Attributes
    ----------
    variables
        Names of the v variables: the design's keys of the scene file, and BLOCK_MODULI.
    nominal
        Their values, SI, shape (v,); 1 for BLOCK_MODULI.
    blocks
        One prediction for each block.
    unmeasured
        Standard deviations of ln E by variable, for moduli from the catalogue that were not measured.
    length_sds
        Standard deviations of lengths by variable, m, where the bench states none.
    """

    variables: tuple[str, ...]
    nominal: Floats
    blocks: tuple[BlockPrediction, ...]
    unmeasured: Mapping[str, float] = field(default_factory=dict)
    length_sds: Mapping[str, float] = field(default_factory=dict)

    @property
    def log_ratios(self) -> Floats:
        """ln(F_inner / F_outer) on each block, shape (blocks,)."""
        return np.array([block.log_ratio for block in self.blocks])

    @property
    def derivatives(self) -> Floats:
        """Derivatives of ``log_ratios`` with respect to the variables, per SI unit, shape (blocks, v)."""
        return np.array([block.derivatives for block in self.blocks]).reshape(len(self.blocks), len(self.variables))

    def list_linear_limits(self) -> list[float]:
        """List the largest loads, N, that linear elasticity allows on the blocks."""
        rules = (block.rule for block in self.blocks if block.rule is not None)
        return [find_largest_load(rule, LINEARITY_ACCURACY, promise=False).force for rule in rules]

    def apply_forces(self, forces: Sequence[float], references: Sequence[Reference], linear: bool) -> BlockPredictions:
        """Return the predictions under forces (N), one for each reference; see ``BlockPrediction.apply_force``.

        Only references that are blocks of tissue have a prediction; the forces on pins and rings are ignored.
        """
        loads = [(force, reference.name) for force, reference in zip(forces, references, strict=True) if reference.on == "tissue"]
        blocks = (block.apply_force(*load, linear) for block, load in zip(self.blocks, loads, strict=True))
        return replace(self, blocks=tuple(blocks))

    def compute_tolerances(self, workshop: Workshop) -> Floats:
        """Return the variables' standard deviations, SI, shape (v,); unmeasured moduli have the catalogue's."""
        return np.array(
            [self._find_tolerance(*variable, workshop) for variable in zip(self.variables, self.nominal, strict=True)]
        )

    def _find_tolerance(self, name: str, value: float, workshop: Workshop) -> float:
        """Return the standard deviation of a variable, SI."""
        if name == BLOCK_MODULI:  # counted for each block in ``BlockPrediction.compute_variance``
            return 0.0
        if name.endswith("modulus"):
            return self.unmeasured.get(name, workshop.modulus) * value
        if name.endswith("poisson_ratio"):
            return workshop.poisson_ratio
        # any other variable is a length
        return self.length_sds[name] if workshop.length is None else workshop.length


def predict_blocks(scene: Scene, references: Sequence[Reference]) -> BlockPredictions:
    """Predict the films' fractions of the load on the references that are blocks of tissue.

    Parameters
    ----------
    scene
        For its probe, contact and kind of tissue; inclusions, placement and tilt are ignored.
    references
        Pins and rings are skipped, since they need no prediction.

    Raises
    ------
    Refusal
        The axisymmetric evaluator cannot compute the probe, or a film is not pressed.
    """
    by_radius = express_by_outer_radius(scene)
    names = tuple(key for key in list_values(by_radius) if key.startswith("probe."))
    blocks = tuple(
        _predict_block(build_block_scene(by_radius, reference), names) for reference in references if reference.on == "tissue"
    )
    nominal = list_values(by_radius)
    bodies = {"probe.inner.youngs_modulus": scene.probe.inner, "probe.outer.youngs_modulus": scene.probe.outer}
    unmeasured = {name: body.unmeasured_entry.log_sd for name, body in bodies.items() if body.unmeasured_entry is not None}
    values = np.array([*(nominal[name] for name in names), 1.0])
    length_sds = {
        name: find_length_sd(by_radius.probe, name) for name in names if not name.endswith(("modulus", "poisson_ratio"))
    }
    return BlockPredictions((*names, BLOCK_MODULI), values, blocks, unmeasured, length_sds)


def predict_log_ratios(scene: Scene, references: Sequence[Reference]) -> Floats:
    """Return ln(F_inner / F_outer) on the references that are tissue, shape (blocks,); see ``predict_blocks``."""
    by_radius = express_by_outer_radius(scene)
    return np.array(
        [_solve_block(build_block_scene(by_radius, reference))[1] for reference in references if reference.on == "tissue"]
    )


def compute_inner_fractions(log_ratios: Floats, references: Sequence[Reference]) -> Floats:
    """Return the inner film's fraction of the load on each reference, shape (n,).

    Parameters
    ----------
    log_ratios
        ln(F_inner / F_outer) on the references that are tissue, in their order.
    references
        All references; a pin presses the inner film only, a ring the outer one.
    """
    fractions = np.array([float(reference.on == "inner") for reference in references])
    # from ln(F_inner / F_outer) to F_inner / (F_inner + F_outer)
    fractions[[reference.on == "tissue" for reference in references]] = expit(log_ratios)
    return fractions


def build_block_scene(scene: Scene, reference: Reference) -> Scene:
    """Build the scene of the probe in the middle of a homogeneous reference block."""
    tissue = scene.tissue.model_copy(update={"youngs_modulus": reference.youngs_modulus, "layer": ()})
    data = scene.model_dump(exclude_unset=True, exclude={"inclusion", "tissue", "placement"})
    upright = data | {"tissue": tissue.model_dump(exclude_unset=True), "placement": Placement().model_dump()}
    return Scene.model_validate(upright, context=SI_CONTEXT)


def express_by_outer_radius(scene: Scene) -> Scene:
    """Return the scene with the probe's outer radius in place of its area ratio, since a workshop measures the radius."""
    probe = scene.probe.model_dump(exclude_unset=True, exclude={"area_ratio"}) | {"outer_radius": scene.probe.tube_radius}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)


def _solve_block(scene: Scene) -> tuple[Converged, float]:
    """Solve the probe on a block; return the solution and ln(F_inner / F_outer)."""
    solution = Axisymmetric().compute_converged(scene, PREDICTION_ACCURACY)
    ratio = compute_result_fields(scene, solution.films[0])["ratio"]
    if ratio is None or ratio <= 0:
        raise Refusal("reference.youngs_modulus", scene.tissue.youngs_modulus, "one on which both films are pressed")
    return solution, math.log(ratio * scene.probe.inner_area / scene.probe.outer_area)


def _predict_block(scene: Scene, names: tuple[str, ...]) -> BlockPrediction:
    """Predict ln(F_inner / F_outer) on one block, with its derivatives.

    Parameters
    ----------
    scene
        Of the probe on the block.
    names
        Keys of the scene's numbers with respect to which to differentiate; the block's modulus is added as the last.
    """
    solution, log_ratio = _solve_block(scene)
    gradient = compute_gradients(scene, solution.sample)
    log_derivatives = gradient.derivatives["ratio"][0] / gradient.values["ratio"][0]  # d ln(ratio) = d ratio / ratio
    derivative_by_name = dict(zip(gradient.variables, log_derivatives, strict=True))
    modulus_derivative = float(derivative_by_name[TISSUE_MODULUS] * scene.tissue.youngs_modulus)
    derivatives = [derivative_by_name.get(name, 0.0) + differentiate_area_ratio(scene.probe, name) for name in names]
    rule = CoarseModel(scene, solution.sample, ()).build_rule(scene)
    bound = solution.films[0].bound.log_ratio
    return BlockPrediction(log_ratio, bound, np.array([*derivatives, modulus_derivative]), modulus_derivative, rule)


def differentiate_area_ratio(probe: Probe, name: str) -> float:
    """Return the derivative of ln(A_inner / A_outer), the areas' ratio, with respect to a number of the scene, 1/m.

    It converts a ratio of stresses to one of forces. The outer area is that of the ring between hole and outer radius.
    """
    ring = probe.outer_area / math.pi  # r_outer^2 - r_hole^2, with r_hole = r_inner + gap
    hole = 2 * probe.hole_radius / ring
    derivatives = {"probe.inner_radius": 2 / probe.inner_radius + hole, "probe.gap": hole}
    return (derivatives | {"probe.outer_radius": -2 * probe.tube_radius / ring}).get(name, 0.0)
