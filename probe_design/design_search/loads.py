"""Compute the load on a design: the largest that design file, scene and linear elasticity allow.

For one tumour, the load of verification is the smaller of the scene's (its force, or its indentation times the design's
stiffness) and the largest for which finite strain changes the ratio by at most ``MAX_RATIO_CHANGE_RELATIVE``, by the rule of
``solver.planning.loads``. The change of the log-sensitivity by finite strain does not limit the load; it is counted in the
evaluator's error.

Over a population, one force holds for all tumours and tissues, which are unknown beforehand. It is the smallest of the scene's
force, of those that the limits of force, indentation, tissue strain and charge allow, of 1/20 of the force that closes the gap,
and of the force that keeps the ratio within ``MAX_RATIO_CHANGE_RELATIVE`` of linear elasticity over the tumour with the widest
and thinnest cover (``solver.planning.loads``, PL.7). Where the design file names the force as a variable, its bounds, steps or
choices replace the scene's force: the force is the largest of these values within the limits, since a larger one never has a
worse objective. A design without such a value is not allowed. Where ``contact`` models the scene, a ``loaded`` rule has its
limits in place of those of linear elasticity, see ``loaded_limits``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Load
from probe_design.data.noise import find_charge_per_force
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.force_variable import find_max_force, find_variable_force, round_load_down
from probe_design.design_search.loaded_limits import PressedDesign, compute_search_limits, supports_loads
from probe_design.design_search.variables import ProbeSizes
from probe_design.populations.design_file import Design
from probe_design.populations.entries import DesignVariable
from probe_design.populations.film_totals import check_films_compressed, weigh_charges
from probe_design.populations.population import ScenePopulation, TumourDraw
from solver.closed_form.bessel import Array
from solver.planning.coarse_model import CoarseModel, compute_charge_per_force, find_charge_factors
from solver.planning.loads import (
    CLOSURE_FORCE_SHARE,
    MAX_X,
    LoadRule,
    compute_flatness_factor,
    compute_law_factor,
    find_largest_x,
)
from solver.planning.strains import (
    bound_nearing,
    compute_block_strain,
    compute_both_strains,
    compute_cover_factor,
    compute_slimness,
    compute_tissue_strain,
)

MAX_RATIO_CHANGE_RELATIVE = 0.01  # largest allowed relative change of the ratio by finite strain
COVER_SAMPLES = 1024  # tumours whose worst cover limits the force; 16 times as many are 4 % worse on the built-in ranges
COARSE_MODEL_SAFETY_FACTOR = 0.9  # of a result on a coarse mesh without tumours, which errs by 5 % and which tumours stiffen
SCENE_LOAD, STRAIN_LIMIT, GAP_CLOSURE = "scene", "strain", "gap closure"  # limits of a load
MAX_DEPTH, LAST_CONVERGED, TIME_LIMIT = "depth", "last converged load", "time limit"  # limits beyond linear elasticity
BEST_LOAD = "best load"  # beyond linear elasticity: a larger load has a worse objective
LIMIT_OF_RULE = {"ratio": STRAIN_LIMIT, "strain limit": STRAIN_LIMIT, "gap closure": GAP_CLOSURE}


@dataclass(frozen=True)
class Pressing:
    """The load on a design.

    Attributes
    ----------
    load
        The scene's load, or the smaller one of the same kind that is allowed, of ``LOAD_DIGITS`` digits.
    force
        Force on the base under this load, N.
    x
        Strain in the rule for loads, see ``LoadRule``.
    change
        Bound on the relative change of the ratio by finite strain; 0 where finite strain is modelled.
    limited_by
        The limit of the load: ``SCENE_LOAD``, ``STRAIN_LIMIT`` or ``GAP_CLOSURE``; beyond linear elasticity ``SCENE_LOAD``,
        ``GAP_CLOSURE``, ``MAX_DEPTH`` (half an outer radius), ``LAST_CONVERGED`` (0.9 of the last load at which a step
        converges), ``TIME_LIMIT`` or ``BEST_LOAD``.
    """

    load: Load
    force: float
    x: float
    change: float
    limited_by: str


def compute_pressing(scene: Scene, stiffness: float, rule: LoadRule) -> Pressing:
    """Return the load on a scene's probe: the scene's, or the largest at which finite strain changes the ratio little enough.

    Parameters
    ----------
    scene
        Scene with a load above 0.
    stiffness
        Force per unit indentation by an evaluator, N/m.
    rule
        Rule for the scene's load, see ``solver.planning.load_limits``.
    """
    largest, load, limited_by = rule.find_largest_load(MAX_RATIO_CHANGE_RELATIVE, promise=False), scene.load, SCENE_LOAD
    if largest.force < rule.compute_force(scene):
        limited_by = LIMIT_OF_RULE[largest.by]
        allowed = round_load_down(largest.force if load.indentation is None else largest.indentation)
        load = Load(force=allowed) if load.indentation is None else Load(indentation=allowed)
    force = compute_force(load, rule.stiffness)
    return Pressing(
        load, float(compute_force(load, stiffness)), rule.compute_x(force), rule.bound_ratio_change(force), limited_by
    )


def compute_force(load: Load, stiffness: Numeric) -> Numeric:
    """Return the force of a load, N: a force itself, or an indentation times the stiffness, N/m; floats or arrays."""
    return load.force if load.indentation is None else load.indentation * stiffness


def check_load(scene: Scene) -> None:
    """Raise ``InputError`` for a load of 0, which yields no charge."""
    load = scene.load
    key = "force" if load.indentation is None else "indentation"
    if not getattr(load, key):
        raise InputError(f"load.{key}", 0, f"a {key} above 0: at 0 the films give no charge to read")


@dataclass(frozen=True)
class PressingRule:
    """The limits and tissues from which the force on each design is computed.

    Attributes
    ----------
    design
        Design with limits, and with its scene's load.
    tissues
        Tissues of the search's tumours, then those of the verification's, which limit the force too.
    worst_cover_factor
        eq. PL.7 for the worst of its tumours.
    safety_factor
        Factor on the forces that linear elasticity and an open gap allow.
    approach_ratio
        Approach of the gap's walls per indentation at the start, over that of eq. PL.4; a search uses it for all designs.
    charge_factors
        Whether eq. PL.13 holds, 1 or 0, and eq. PL.14 at the start, likewise; 0 and 1 where stresses are read.
    loaded
        Whether forces beyond linear elasticity are allowed.
    omits_cancelling
        Whether designs whose films' charges nearly cancel get no force, see ``weigh_charges``, as a search leaves them out.
    """

    design: Design
    tissues: tuple[Scene, ...]
    worst_cover_factor: float
    approach_ratio: float
    charge_factors: tuple[int, float]
    safety_factor: float = COARSE_MODEL_SAFETY_FACTOR
    loaded: bool = False
    omits_cancelling: bool = True

    @classmethod
    def from_draws(cls, design: Design, draw: TumourDraw, unseen: TumourDraw) -> PressingRule:
        """Return the rule of a design file for the tumours of the search and those of the verification.

        The worst cover is that of many tumours of the population, however few are drawn, so that forces do not depend on
        ``samples``.
        """
        cover_tumours = ScenePopulation.from_scene(design.scene, design.population).draw_tumours(COVER_SAMPLES)
        bodies = [
            # moduli of tumours do not matter for their cover
            Inclusion(diameter=d, depth=z, youngs_modulus=1e4, poisson_ratio=0.45)
            for tumours in (cover_tumours, draw, unseen)
            for d, z in zip(tumours.diameter.tolist(), tumours.depth.tolist(), strict=True)
        ]
        tissues = (*draw.tissues, *(tissue for tissue in unseen.tissues if tissue not in draw.tissues))
        start = _measure_start(draw.tissues[0])
        return cls(design, tissues, compute_cover_factor(bodies), *start, loaded=supports_loads(draw.tissues[0]))

    @classmethod
    def from_scene(cls, design: Design) -> PressingRule:
        """Return the rule of a design file for the tumours of its scene.

        Raises
        ------
        Refusal
            The scene is so extreme that it cannot be solved.
        """
        scene = design.scene
        return cls(design, (scene,), compute_cover_factor(scene.inclusion), *_measure_start(scene), safety_factor=1.0)

    def set_film(self, choice: FilmChoice) -> PressingRule:
        """Return the rule for probes with other films and bonds."""
        design = self.design.model_copy(update={"scene": choice.set_film(self.design.scene)})
        return replace(self, design=design)

    @property
    def charge_per_force(self) -> float:
        """|d33| of the films, C/N."""
        return find_charge_per_force(self.design.scene.probe)

    @property
    def force_variable(self) -> DesignVariable:
        """The design file's variable "force"; a fixed one has the scene's force as its only value."""
        variable, force = self.design.variables.force, self.design.scene.load.force
        return DesignVariable(choices=(force,)) if variable.fixed and force is not None else variable

    def compute_charges(self, totals: Numeric, force: Numeric) -> Numeric:
        """Return the charges of both films under a force on the probe, C, without sign, shape (..., 2); real or complex.

        Parameters
        ----------
        totals
            Forces on both films and, where they are read, their charges, per unit indentation, shape (..., 2 or 4).
        force
            Force, N, shape (...).
        """
        charges = totals[..., -2:] / totals[..., :2].sum(axis=-1, keepdims=True) * force[..., None]
        return charges * self.charge_per_force if totals.shape[-1] == 2 else np.where(np.real(charges) < 0, -charges, charges)

    def compute_pressed_design(self, scene: Scene) -> PressedDesign:
        """Return the force on a scene's probe.

        Raises
        ------
        Refusal
            A tissue is so extreme that it cannot be solved, or a film is in tension.
        """
        sizes, limits, per_force = ProbeSizes.from_scene(scene), list[JsonObject](), list[Floats]()
        for tissue in self.tissues:
            coarse = CoarseModel.from_scene(tissue.model_copy(update={"probe": scene.probe}), details=False)
            totals = coarse.forces.sum(axis=1)
            check_films_compressed(totals, tissue)
            factor = self._find_charge_per_force(tissue.model_copy(update={"probe": scene.probe}))
            charges_per_force = factor * (totals / totals.sum())
            given = {"charges": charges_per_force, "closure": coarse.closure_force}
            rule = replace(self, charge_factors=find_charge_factors(coarse))
            limits.append(rule._compute_allowed_forces(scene, sizes, totals, tissue, **given))
            strain = float(compute_tissue_strain(scene.probe.tube_radius, tissue.tissue))
            per_force.append(np.array([1.0, strain, *(totals * factor)]) / totals.sum())
        allowed = {key: float(min(limit[key] for limit in limits)) for key in limits[0]}
        limited_by = min(allowed, key=lambda key: allowed[key])
        force = self._choose_force(allowed[limited_by])
        indentation, tissue_strain, *film_charges = np.array(per_force).T * force
        charge_range = float(np.min(film_charges)), float(np.max(film_charges))
        return PressedDesign(force, float(indentation.max()), float(tissue_strain.max()), charge_range, limited_by, allowed)

    def _find_charge_per_force(self, scene: Scene) -> Floats:
        """Return the charge of each of a scene's films per force on it, C/N, without sign, shape (2,)."""
        if scene.observable == "stress":
            return np.full(2, self.charge_per_force)
        return np.abs(compute_charge_per_force(scene))

    def apply_force(self, scene: Scene) -> tuple[Scene, PressedDesign]:
        """Return a scene under the force of the rule, with the details of this force."""
        pressed = self.compute_pressed_design(scene)
        return scene.model_copy(update={"load": Load(force=pressed.force)}), pressed

    def compute_forces(self, sizes: ProbeSizes, totals: Array, which: Ints) -> Array:
        """Return the force on n designs over m tumours in closed form, N, shape (n, m); it is the same for all tumours.

        Parameters
        ----------
        sizes
            Sizes of the probes, floats or complex, shape (n,) each.
        totals
            Forces on both films, and charges where they are read, per unit indentation without tumours, shape (n, m, 2 or 4).
        which
            Number of each tumour's tissue, shape (m,).
        """
        forces: list[Array] = []
        weights = np.ones(len(totals), dtype=totals.dtype)
        for number, tissue in enumerate(self.tissues):  # the tissues of the search come first
            members = np.flatnonzero(which == number)
            if not len(members):
                continue
            film_totals = np.moveaxis(totals[:, members[0], :2], 1, 0)
            approach = self.approach_ratio * _compute_wall_approach(tissue, sizes, film_totals)
            closure = film_totals.sum(axis=0) * sizes.gap / approach
            charges = np.moveaxis(self.compute_charges(totals[:, members[0]], np.ones(1)), 1, 0)
            allowed = self._compute_allowed_forces(
                self.design.scene, sizes, film_totals, tissue, charges=charges, closure=closure
            )
            forces += [force + 0 * film_totals[0] for force in allowed.values()]
            if self.omits_cancelling:
                weights *= weigh_charges(self.design.scene, totals[:, members[0]])
        force = weights * find_variable_force(self.force_variable, reduce(select_smaller, forces))
        return np.repeat(force[:, None], totals.shape[1], axis=1)

    def _choose_force(self, allowed_force: float) -> float:
        """Return the largest force, N, up to an allowed one, that the design file's variable or the rounding permits."""
        variable = self.force_variable
        force = float(find_variable_force(variable, allowed_force))
        if math.isnan(force):
            stated = Words(f"no value up to {allowed_force:.3g} N")
            raise Refusal("variables.force", stated, "smaller forces, as the limits of the load allow no larger ones")
        return force if variable.choices or variable.step is not None else round_load_down(force)

    def _compute_allowed_forces(
        self, scene: Scene, sizes: ProbeSizes, totals: Numeric, tissue: Scene, *, charges: Numeric, closure: Numeric
    ) -> JsonObject:
        """Return the force that each limit allows on one tissue, N, by the limit's name.

        Parameters
        ----------
        scene
            Scene with the contact.
        sizes
            Sizes of the probes, floats or arrays.
        totals
            Forces on both films per unit indentation, N/m, first axis 2.
        charges
            Charge of each film per force on the probe, C/N, first axis 2.
        closure
            Force that closes the gap in linear elasticity, N.
        tissue
            The scene with this tissue.
        """
        limits, load, stiffness = self.design.limits, self.design.scene.load, totals[0] + totals[1]
        per_depth = compute_tissue_strain(sizes.outer_radius, tissue.tissue)
        blocks = zip(sizes.heights, totals, sizes.areas, sizes.moduli, strict=True)
        inner, outer = (compute_block_strain(height, total / area / E) for height, total, area, E in blocks)
        outer = outer * compute_slimness(sizes.outer_radius, sizes.outer_radius - sizes.inner_radius - sizes.gap)
        # -min(-a, -b) is the maximum, here of both blocks' strains
        max_block_strain = -select_smaller(-inner, -outer)
        x, strain = compute_both_strains(
            sizes.outer_radius,
            tissue.tissue,
            scene.contact.interface,
            max_block_strain,
            self.worst_cover_factor,
            law=compute_law_factor(tissue),
        )
        allowed: JsonObject = {}
        max_variable_force = find_max_force(self.force_variable)
        if limits.force is not None:
            allowed["force"] = limits.force
        if self.design.protocol.loads:
            allowed["loads"] = max(self.design.protocol.loads)
        elif limits.force is None and max_variable_force is None:
            allowed["scene"] = compute_force(load, stiffness)
        if max_variable_force is not None:
            allowed["largest force"] = max_variable_force
        if limits.pressure is not None:
            allowed["pressure"] = limits.pressure * np.pi * sizes.outer_radius**2
        if self.loaded:
            allowed |= compute_search_limits(limits, tissue, sizes.outer_radius, stiffness, closure)
        else:
            max_x = self.safety_factor * find_largest_x(MAX_RATIO_CHANGE_RELATIVE, promise=None)[0]
            on_tape, factor = self.charge_factors
            min_ratio = on_tape * compute_flatness_factor(sizes.outer_radius, select_smaller(*sizes.heights))
            allowed["linearity"] = max_x / (-select_smaller(-strain, -min_ratio * x) * factor) * stiffness
        if limits.indentation is not None:
            allowed["indentation"] = limits.indentation * stiffness
        if limits.tissue_strain is not None:
            allowed["tissue_strain"] = limits.tissue_strain / per_depth * stiffness
        if limits.gap_closure and not self.loaded:
            allowed["gap_closure"] = self.safety_factor * select_smaller(CLOSURE_FORCE_SHARE * closure, MAX_X / x * stiffness)
        if limits.charge is not None:
            allowed["charge"] = limits.charge[1] / -select_smaller(-charges[0], -charges[1])
        return allowed


def select_smaller(a: Numeric, b: Numeric) -> Numeric:
    """Return the element-wise minimum of two arrays, compared by their real parts so that complex steps pass through."""
    return np.where(np.real(a) <= np.real(b), a, b) if np.ndim(a) or np.ndim(b) else (a if np.real(a) <= np.real(b) else b)


def _measure_start(scene: Scene) -> tuple[float, tuple[int, float]]:
    """Return the approach of the gap's walls on a coarse mesh over its bound by eq. PL.4, and ``charge_factors``."""
    coarse = CoarseModel.from_scene(scene, details=False)
    bound = _compute_wall_approach(scene, ProbeSizes.from_scene(scene), coarse.forces.sum(axis=1))
    return float(coarse.wall_approach / bound), find_charge_factors(coarse)


def _compute_wall_approach(scene: Scene, sizes: ProbeSizes, totals: Numeric) -> Numeric:
    """Return an upper bound on the approach of the gap's walls per unit indentation (eq. PL.4).

    ``totals`` are the forces on both films per unit indentation, N/m, first axis 2.
    """
    inner, outer = (total / (area * E) for total, area, E in zip(totals, sizes.areas, sizes.moduli, strict=True))
    radii = (sizes.inner_radius, sizes.inner_radius + sizes.gap, sizes.outer_radius)
    return bound_nearing(scene.tissue, radii, (inner, outer), sizes.moduli[1])
