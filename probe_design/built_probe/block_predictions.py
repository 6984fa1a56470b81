"""Predict what both films read on references, with errors and derivatives with respect to the design.

Where readings are stresses, only ln rho is predicted, rho = F_inner / F_outer with the films' forces F on a block of tissue:
their sum is the load, for any probe and tissue. Where they are charges, F is each film's charge over one unit of charge per force
(``reference_charges.compute_charge_units``); the sum is then sigma times the load, and ln sigma is predicted on every reference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import expit

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.meridian.section import TISSUES
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Placement
from geometry.scenes.units import SI_CONTEXT, format_modulus
from geometry.scenes.variables import list_values
from geometry.workshop.tolerance import find_length_sd
from probe_design.built_probe.bench import Reference, Workshop
from probe_design.built_probe.block_derivatives import Derivatives, differentiate_block, differentiate_by_moduli, list_soft_bonds
from probe_design.built_probe.loaded_blocks import BlockPrediction, PressedReference, find_reference_load
from probe_design.built_probe.reference_charges import (
    FILM_KEYS,
    BondModulus,
    LoadFactor,
    compute_charge_units,
    find_bond_log_sd,
    find_film_tolerance,
    is_bond_modulus,
    list_bond_keys,
    predict_pin,
    scale_bonds,
)
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.evaluator import Axisymmetric
from solver.contact.design_derivatives import LoadedDerivatives
from solver.planning.coarse_model import CoarseModel
from solver.results.film_charges import reads_film_states
from solver.results.film_forces import FilmForces

PREDICTION_ACCURACY = 1e-3  # relative accuracy of the solver
BLOCK_MODULI = "reference.youngs_modulus"  # an additional variable: one relative change of all blocks' moduli


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
    load_factors
        ln sigma of every reference, where readings are charges; otherwise none.
    bonds
        The modulus of the bonds at which all this holds; None where it does not matter.
    load_sd
        Relative standard deviation of all loads together, where predictions depend on them.
    growths
        Cache: what loads add to the derivatives, by the number of the reference and the load.
    """

    variables: tuple[str, ...]
    nominal: Floats
    blocks: tuple[BlockPrediction, ...]
    unmeasured: Mapping[str, float] = field(default_factory=dict)
    length_sds: Mapping[str, float] = field(default_factory=dict)
    load_factors: tuple[LoadFactor, ...] = ()
    bonds: BondModulus | None = None
    load_sd: float = 0.0
    growths: dict[tuple[int, float], LoadedDerivatives] = field(default_factory=dict, compare=False, repr=False)

    @property
    def log_ratios(self) -> Floats:
        """ln(F_inner / F_outer) on each block, shape (blocks,)."""
        return np.array([block.log_ratio for block in self.blocks])

    @property
    def derivatives(self) -> Floats:
        """Derivatives of ``log_ratios`` with respect to the variables, per SI unit, shape (blocks, v)."""
        return np.array([block.derivatives for block in self.blocks]).reshape(len(self.blocks), len(self.variables))

    @property
    def load_errors(self) -> Floats:
        """Changes of ``log_ratios`` for one standard deviation of all loads, shape (blocks,)."""
        return self.load_sd * np.array([block.load_derivative for block in self.blocks])

    def list_reference_loads(self) -> list[float]:
        """List the loads, N, up to which the blocks are to be pressed, see ``loaded_blocks.find_reference_load``."""
        return [find_reference_load(block.rule) for block in self.blocks if block.rule is not None]

    def apply_forces(self, forces: Sequence[float], references: Sequence[Reference], linear: bool) -> BlockPredictions:
        """Return the predictions under forces, N, one for each reference; see ``BlockPrediction.apply_force``.

        Raises
        ------
        Refusal
            ``contact`` does not reach a load, or a pin or ring strains its block too much.
        """
        light, blocks, factors = iter(self.blocks), [], []
        for k, (force, reference) in enumerate(zip(forces, references, strict=True)):
            factor = self.load_factors[k] if self.load_factors else None
            if reference.on == "tissue":
                press = partial(self._press, k, force)
                block, factor = next(light).apply_force(force, reference, factor, press, linear=linear)
                blocks.append(block)
            elif factor is not None:
                factor = factor.strain_block(force, reference.name)
            factors += [] if factor is None else [factor]
        return replace(self, blocks=tuple(blocks), load_factors=tuple(factors))

    def _press(self, number: int, force: float, pressed: PressedReference) -> LoadedDerivatives:
        """Return what a force, N, adds to the derivatives on the reference of a number; it is computed once."""
        if (number, force) not in self.growths:
            keys = (*self.variables[:-1], "tissue.youngs_modulus", *list_bond_keys(pressed.loaded.scene))
            self.growths[number, force] = pressed.differentiate(keys)
        return self.growths[number, force]

    def carry_loads(self, pressed: BlockPredictions, changes: Mapping[str, float]) -> BlockPredictions:
        """Return these predictions of a changed design under light loads, with what the loads add to those of the drawing.

        Parameters
        ----------
        pressed
            Under the loads, for the drawing.
        changes
            Changes of variables from the drawing, x0 ln(x / x0) of a positive number x, SI.
        """
        steps = np.array([changes.get(name, 0.0) for name in self.variables])
        pairs = zip(self.blocks, pressed.blocks, strict=True)
        return replace(self, blocks=tuple(block.carry_load(loaded, steps) for block, loaded in pairs))

    def compute_tolerances(self, workshop: Workshop, calibrated: bool = True) -> Floats:
        """Return the variables' standard deviations, SI, shape (v,); unmeasured moduli have the catalogue's.

        Bonds' moduli have the catalogue's, too, but for those that a calibration determines, which are no tolerances then.
        """
        pairs = zip(self.variables, self.nominal, strict=True)
        return np.array([self._find_tolerance(*variable, workshop, calibrated) for variable in pairs])

    def _find_tolerance(self, name: str, value: float, workshop: Workshop, calibrated: bool) -> float:
        """Return the standard deviation of a variable, SI."""
        if name == BLOCK_MODULI:  # counted for each block in ``BlockPrediction.compute_variance``
            return 0.0
        if is_bond_modulus(name):  # which does not matter where readings are stresses
            is_known = self.bonds is None or (calibrated and name in self.bonds.fitted)
            return 0.0 if self.bonds is None or is_known else self.bonds.log_sds[name] * value
        if name.startswith(FILM_KEYS):
            return find_film_tolerance(name, value, workshop)
        if name.endswith("modulus"):
            return self.unmeasured.get(name, workshop.modulus) * value
        if name.endswith("poisson_ratio"):
            return workshop.poisson_ratio
        # any other variable is a length
        return self.length_sds[name] if workshop.length is None else workshop.length


def predict_blocks(
    scene: Scene,
    references: Sequence[Reference],
    log_bonds: float = 0.0,
    previous: BlockPredictions | None = None,
    *,
    variables: Sequence[str] | None = None,
    limit_loads: bool = True,
) -> BlockPredictions:
    """Predict what both films read on references: on blocks of tissue, and where readings are charges, on pins and rings, too.

    Parameters
    ----------
    scene
        For its probe, contact and kind of tissue; inclusions, placement and tilt are ignored.
    references
        Of a bench. Where readings are stresses, pins and rings are skipped, since they need no prediction.
    log_bonds
        ln of the factor on the moduli of the scene's bonds.
    previous
        Predictions of the same references for another such factor: derivatives by the design's variables are taken from there.
    variables
        Keys of the design with respect to which to differentiate, for which most of the time is needed: all numbers of the probe,
        or those of which a part may not be as drawn.
    limit_loads
        Whether to compute the limits of loads on blocks; without them any load is allowed.

    Raises
    ------
    Refusal
        The axisymmetric evaluator cannot compute the probe, or a film is not pressed.
    """
    drawn = express_by_outer_radius(scene)
    reads_charges, by_radius = reads_film_states(scene), scale_bonds(drawn, log_bonds)
    chosen = list_values(by_radius) if variables is None else variables
    names = tuple(key for key in chosen if key.startswith("probe.")) if previous is None else previous.variables[:-1]
    unit = float(abs(compute_charge_units(scene)[0])) if reads_charges else 1.0
    limit_loads = limit_loads and (previous is None or any(block.rule is not None for block in previous.blocks))
    blocks: list[BlockPrediction] = []
    factors: list[LoadFactor] = []
    known: Derivatives | None = None if names else Derivatives(np.zeros(0), np.zeros(0))
    for k, reference in enumerate(references):
        if previous is not None and reads_charges:
            ratio = previous.blocks[len(blocks)].derivatives[:-1] if reference.on == "tissue" else np.zeros(0)
            known = Derivatives(ratio, previous.load_factors[k].derivatives[:-1])
        if reference.on == "tissue":
            block_scene = build_block_scene(by_radius, reference)
            block, factor = _predict_block(block_scene, names, reference.tolerance, unit, known, limit_loads=limit_loads)
            blocks.append(block)
            factors.append(factor)
        elif reads_charges:
            factors.append(predict_pin(by_radius, reference, names, unit, None if known is None else known.load_factor))
    nominal = list_values(by_radius)
    bodies = {"probe.inner.youngs_modulus": scene.probe.inner, "probe.outer.youngs_modulus": scene.probe.outer}
    unmeasured = {name: body.unmeasured_entry.log_sd for name, body in bodies.items() if body.unmeasured_entry is not None}
    values = np.array([*(nominal[name] for name in names), 1.0])
    length_sds = {
        name: find_length_sd(by_radius.probe, name)
        for name in names
        if not name.endswith(("modulus", "poisson_ratio")) and not name.startswith(FILM_KEYS)
    }
    return BlockPredictions(
        (*names, BLOCK_MODULI),
        values,
        tuple(blocks),
        unmeasured,
        length_sds,
        tuple(factors) if reads_charges else (),
        BondModulus.from_scene(scene, log_bonds) if reads_charges and find_bond_log_sd(scene) > 0 else None,
        growths={} if previous is None else previous.growths,
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


def solve_block(scene: Scene) -> tuple[Converged, FilmForces, float]:
    """Solve the probe on a block; return the solution, what readings are the ratio of, and ln(F_inner / F_outer) of that."""
    solution = Axisymmetric().compute_converged(scene, PREDICTION_ACCURACY)
    films = solution.films[0]
    read = films.get_observable(scene) if reads_film_states(scene) else films
    inner, outer = read.totals
    if not inner * outer > 0 or not read.ratio_error < 1:
        modulus = format_modulus(scene.tissue.youngs_modulus)
        if reads_film_states(scene):  # films of other kinds; or the block bends a film that is glued to it, on soft tape
            charges = " and ".join(f"{1e12 * charge:.2g}" for charge in read.totals / films.totals)
            given = Words(f"films of {charges} pC/N (inner, outer) on a block of {modulus}")
            remedy = "take one film for both blocks, without [probe.film.outer], and one bond for both of its sides"
            raise Refusal("probe.film", given, f"films whose charges have one sign, neither about 0; {remedy}")
        raise Refusal("reference.youngs_modulus", Words(modulus), "one on which both films are pressed")
    return solution, read, math.log(inner / outer)


def _predict_block(
    scene: Scene, names: tuple[str, ...], tolerance: float, unit: float, known: Derivatives | None, *, limit_loads: bool
) -> tuple[BlockPrediction, LoadFactor]:
    """Predict ln(F_inner / F_outer) and ln sigma on one block, with their derivatives.

    Parameters
    ----------
    scene
        Of the probe on the block.
    names
        Keys of the scene's numbers with respect to which to differentiate; the block's modulus is added as the last.
    tolerance
        Relative standard deviation of the block's modulus.
    unit
        Charge per force, C/N, above 0; 1 where readings are stresses.
    known
        Derivatives with respect to ``names``; None: they are computed.
    limit_loads
        Whether to compute the limits of loads.
    """
    solution, read, log_ratio = solve_block(scene)
    shares = read.totals / read.totals.sum()
    groups = TISSUES, list_soft_bonds(scene.probe)
    by_modulus, by_bonds = (differentiate_by_moduli(solution, bodies, reads_film_states(scene)) for bodies in groups)
    derivatives = differentiate_block(scene, solution, names, shares) if known is None else known
    modulus_derivative, bond_derivative = float(by_modulus @ [1.0, -1.0]), float(by_bonds @ [1.0, -1.0])
    prediction = BlockPrediction(
        log_ratio,
        read.bound.log_ratio,
        np.append(derivatives.log_ratio, modulus_derivative),
        modulus_derivative,
        CoarseModel(scene, solution.sample, ()).build_rule(scene) if limit_loads else None,
        bond_derivative,
        scene=scene,
    )
    sigma = abs(read.totals.sum() / solution.films[0].totals.sum()) / unit
    error = float(read.relative_errors.max() + solution.films[0].stiffness_error)
    factor = LoadFactor(
        math.log(sigma),
        error**2 / 3 + float(shares @ by_modulus * tolerance) ** 2,
        np.append(derivatives.load_factor, shares @ by_modulus),
        float(shares @ by_bonds),
        (float(by_bonds[0]), float(by_bonds[1])),
    )
    return prediction, factor
