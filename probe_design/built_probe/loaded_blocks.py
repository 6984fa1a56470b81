"""Predict what both films read on one reference block under any load: beyond linear elasticity by ``contact``.

The films' logarithms and their derivatives are those of linear elasticity plus what the load adds, by ``contact`` and
``solver.contact.design_derivatives``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from geometry.scenes.variables import list_values
from probe_design.built_probe.bench import Reference
from probe_design.built_probe.reference_charges import LoadFactor, list_bond_keys
from solver.contact.design_derivatives import LoadedDerivatives, compute_loaded_derivatives
from solver.contact.evaluator import ContactEvaluator, press_refined
from solver.contact.loaded_scene import LoadedScene
from solver.contact.states import StoppedError
from solver.planning.load_limits import find_largest_load
from solver.planning.loads import LoadRule
from solver.results.film_charges import reads_film_states
from solver.results.film_forces import FilmForces
from solver.results.load_limits import LargestLoad

LINEARITY_ACCURACY = 0.01  # largest relative change by finite strain at which a load counts as linear
CONTACT_ACCURACY = 5e-3  # of contact's linear part; a fifth of it is reached
ENOUGH_LOG_RATIO_ERROR = 2e-3  # what the load adds to the error of ln ratio, below which no finer mesh is pressed
SAFE_FRACTION = 0.8  # of the largest linear load, with which a guide asks to press
REFERENCE_X = 0.05  # indentation over the outer radius up to which references are pressed: no tissue folds onto the walls


@dataclass(frozen=True)
class PressedReference:
    """The probe on a reference block under a load.

    Attributes
    ----------
    light, films
        Film forces per indentation, with the charges where they are modelled: under a light load and under the load.
    loaded
        The load paths.
    """

    light: FilmForces
    films: FilmForces
    loaded: LoadedScene

    @classmethod
    def from_force(cls, scene: Scene, force: float, name: str) -> PressedReference:
        """Press a block's scene by a force, N, or by the scene's preload, whose tangent response counts; ``name`` for messages.

        Raises
        ------
        Refusal
            No step converges at the load; the message has the largest at which one does.
        """
        entry, evaluator = ("load", Words(f"{force:.3g} N on the {name}")), ContactEvaluator()
        load = scene.load if scene.load.preload else Load(force=force)
        try:
            with threadpool_limits(1, user_api="blas"):
                at_rest = evaluator.prepare_scene(scene.model_copy(update={"load": load}), CONTACT_ACCURACY)
                light = at_rest.linear.films[0]
                enough = choose_read(light, scene).bound.log_ratio + ENOUGH_LOG_RATIO_ERROR
                result, loaded, _ = press_refined(at_rest, lambda films: choose_read(films, scene).bound.log_ratio <= enough)
        except StoppedError as fault:
            raise evaluator.build_stop_refusal(entry, fault) from fault
        except SolveError as fault:
            raise Refusal(*entry, f"a smaller load, or a block that contact can compute ({fault})") from fault
        return cls(light, result.films, loaded)

    @property
    def read(self) -> FilmForces:
        """What readings are the ratio of under the load: the charges or the forces."""
        return choose_read(self.films, self.loaded.scene)

    @property
    def added_log_ratio(self) -> float:
        """What the load adds to ln of the inner over the outer film's reading."""
        return float(np.log(self.read.totals / choose_read(self.light, self.loaded.scene).totals) @ [1.0, -1.0])

    @property
    def added_log_sigma(self) -> float:
        """What the load adds to ln sigma of eq. BP.11."""
        light = choose_read(self.light, self.loaded.scene)
        return math.log(self.read.totals.sum() / light.totals.sum() * self.light.totals.sum() / self.films.totals.sum())

    def differentiate(self, names: Sequence[str]) -> LoadedDerivatives:
        """Return what the load adds to the derivatives by numbers of the scene, of what is read; k = 2."""
        derivatives = compute_loaded_derivatives(self.loaded, names)
        columns = slice(2, 4) if reads_film_states(self.loaded.scene) else slice(0, 2)
        return replace(derivatives, growths=derivatives.growths[:, columns], by_force=derivatives.by_force[columns])


def choose_read(films: FilmForces, scene: Scene) -> FilmForces:
    """Return the charges where a scene reads films' states, else the forces."""
    return films.get_observable(scene) if reads_film_states(scene) else films


def find_linear_limit(rule: LoadRule) -> LargestLoad:
    """Return the largest load for which a block is predicted by linear elasticity."""
    return find_largest_load(rule, LINEARITY_ACCURACY, promise=False)


def find_departure(scene: Scene, force: float) -> float:
    """Return the force, N, that departs from linear elasticity as readings of an amplitude do, see ``Load.departure``."""
    return scene.load.departure.force or force if scene.load.preload else force


def find_reference_load(rule: LoadRule) -> float:
    """Return the load, N, up to which a block is to be pressed: a safe linear one, or a small indentation with an open gap.

    Beyond it the block's prediction is less certain, which gains from stiff electronics do not need.
    """
    small = min(REFERENCE_X * rule.stiffness / rule.strain, rule.largest_known_force)
    return max(SAFE_FRACTION * find_linear_limit(rule).force, small)


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
    bond_derivative
        Derivative of ``log_ratio`` with respect to the logarithm of the modulus of the soft bonds.
    load_derivative
        Derivative of ``log_ratio`` with respect to the logarithm of the load.
    scene
        The probe on the block.
    added
        What the load adds to ``log_ratio``.
    growth
        What it adds to ``derivatives``, shape (v,).
    """

    log_ratio: float
    bound: float
    derivatives: Floats
    modulus_derivative: float
    rule: LoadRule | None = None
    bond_derivative: float = 0.0
    load_derivative: float = 0.0
    scene: Scene | None = field(default=None, repr=False)
    added: float = 0.0
    growth: Floats | None = field(default=None, repr=False)

    def compute_variance(self, reference: Reference) -> float:
        """Return the variance of ``log_ratio`` due to the block's modulus and the solver's error.

        The solver's error is uniformly distributed from -bound to bound, so that its variance is bound^2 / 3.
        """
        return (self.modulus_derivative * reference.tolerance) ** 2 + self.bound**2 / 3

    def apply_force(
        self,
        force: float,
        reference: Reference,
        factor: LoadFactor | None,
        differentiate: Callable[[PressedReference], LoadedDerivatives],
        *,
        linear: bool,
    ) -> tuple[BlockPrediction, LoadFactor | None]:
        """Return the prediction and sigma under a force: by ``contact`` beyond linear elasticity.

        Parameters
        ----------
        force
            Load on the block, N.
        reference
            The block.
        factor
            sigma under a light load; None where readings are stresses.
        differentiate
            Returns what the load adds to the derivatives by the variables, then by the tissue's modulus and those of soft bonds.
        linear
            Whether to keep to linear elasticity, where the effect of finite strain can be estimated, which counts as an error.

        Raises
        ------
        Refusal
            ``contact`` does not reach the force.
        """
        if self.scene is None or self.rule is None:
            return self, factor
        departure, limit = find_departure(self.scene, force), find_linear_limit(self.rule).force
        if departure <= limit or (linear and self.rule.is_known(departure)):
            # finite strain may reduce the ratio to (1 - change) times itself: -ln(1 - change) is added to the bound on ln ratio
            return replace(self, bound=self.bound - math.log1p(-self.rule.bound_ratio_change(departure))), factor
        pressed = PressedReference.from_force(self.scene, force, reference.name)
        derivatives, values, count = differentiate(pressed), list_values(self.scene), len(self.derivatives) - 1
        read, difference, added = pressed.read, np.array([1.0, -1.0]), derivatives.growths
        by_modulus = added[count] * values["tissue.youngs_modulus"]
        by_bonds = np.array([values[key] for key in list_bond_keys(self.scene)]) @ added[count + 1 :]
        changes = np.vstack([added[:count], by_modulus])
        growth = changes @ difference
        loaded = replace(
            self,
            log_ratio=self.log_ratio + pressed.added_log_ratio,
            bound=read.bound.log_ratio,
            derivatives=self.derivatives + growth,
            modulus_derivative=self.modulus_derivative + float(growth[-1]),
            bond_derivative=self.bond_derivative + float(by_bonds @ difference),
            load_derivative=float(derivatives.by_force @ difference),
            added=pressed.added_log_ratio,
            growth=growth,
        )
        if factor is None or factor.film_bond_derivatives is None:
            return loaded, factor
        shares = read.totals / read.totals.sum()
        # the light derivatives of ln sigma have the light shares of both films: with others those of ln ratio add
        by_variable = factor.derivatives + (shares[0] - expit(self.log_ratio)) * self.derivatives + changes @ shares
        bond_derivatives = np.array(factor.film_bond_derivatives) + by_bonds
        error = float(read.relative_errors.max() + pressed.films.stiffness_error)
        return loaded, replace(
            factor,
            log=factor.log + pressed.added_log_sigma,
            variance=error**2 / 3 + float(by_variable[-1] * reference.tolerance) ** 2,
            derivatives=by_variable,
            bond_derivative=float(shares @ bond_derivatives),
            film_bond_derivatives=(float(bond_derivatives[0]), float(bond_derivatives[1])),
            load_derivative=float(derivatives.by_force @ shares),
        )

    def carry_load(self, loaded: BlockPrediction, steps: Floats) -> BlockPrediction:
        """Return this prediction for a light load with what the load of ``loaded`` adds; see ``BlockPredictions.carry_loads``."""
        if loaded.growth is None:
            return self
        added = loaded.added + float(loaded.growth @ steps)
        derivatives = self.derivatives + loaded.growth
        return replace(self, log_ratio=self.log_ratio + added, derivatives=derivatives, added=loaded.added, growth=loaded.growth)
