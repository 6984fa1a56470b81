"""Predict the readings without tumours under each load of a scan, and place each reading's force between these loads.

Tables of signals exist at few loads: the scene's own, and those of [protocol] loads; all up to which linear elasticity holds are
one, at rest. A reading at the force F between two of them, F_1 and F_2, has the signal

    s(F) = s_1 + t (s_2 - s_1),   t = (F - F_1) / (F_2 - F_1),   error |t - (F^2 - F_1^2) / (F_2^2 - F_1^2)| |s_2 - s_1|    (LO.6)

where the error is the difference to signals that grow as the square of the force. Without tumours it is computed at F itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.populations.design_file import Design
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.noise import compute_reading_variances
from probe_design.populations.population import ScenePopulation
from probe_design.populations.tables import NoiseModel
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.planning.load_limits import compute_load_limits
from solver.reading_tables.effect_samplers import LOAD_ACCURACY, choose_sampler

MAX_FORCE_CHANGE_RELATIVE = 0.05  # of a reading's force, beyond the loads at which readings are predicted
SAME_FORCE_RELATIVE = 1e-3  # of a load: what this changes is far below the error of ``contact``
MAX_COMPUTED_FORCES = 12  # forces of readings at which the tumour-free readings are computed; more lie on a curve through these


@dataclass(frozen=True)
class TumourFree:
    """The probe on the tissue without tumours, under the scene's load where that is beyond linear elasticity.

    Attributes
    ----------
    scene
        The scene without tumours.
    totals
        Force on each film per unit indentation, N/m, and, where charges are read, charge of each film, C/m; shape (2 or 4,).
    logarithms
        Ln ratio, as it is read, and ln stiffness, N/m; shape (2,).
    errors
        Their standard deviations by errors of the model, shape (2,).
    evaluator
        Name of the model of the readings.
    """

    scene: Scene
    totals: Floats
    logarithms: Floats
    errors: Floats = field(default_factory=lambda: np.zeros(2))
    evaluator: str = EquivalentInclusion.name

    @classmethod
    def from_scene(cls, scene: Scene) -> TumourFree:
        """Solve the probe on the tissue of a scene.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene or its load.
        """
        scene = scene.model_copy(update={"inclusion": ()})
        sampler = choose_sampler(scene)
        films = sampler.films
        totals = np.asarray(stack_totals(scene, films), dtype=float)
        per_area = np.abs(totals[-2:]) / [scene.probe.inner_area, scene.probe.outer_area]
        errors = np.array([films.get_observable(scene).bound.log_ratio, films.stiffness_error]) / 2  # of bounds
        return cls(scene, totals, np.log([per_area[0] / per_area[1], totals[:2].sum()]), errors, sampler.name)

    @property
    def is_linear(self) -> bool:
        """Whether readings are predicted by linear elasticity."""
        return self.evaluator == EquivalentInclusion.name


@dataclass(frozen=True)
class ScanLoads:
    """The loads at which signals are predicted.

    Attributes
    ----------
    nodes
        Tissue without tumours at each, by increasing force; one at most is linear, the first.
    main_index
        Index of the scene's own load among them.
    pressed
        Forces of the protocol, N, by increasing force; without them None, the scene's load.
    """

    nodes: tuple[TumourFree, ...]
    main_index: int = 0
    pressed: tuple[float | None, ...] = (None,)

    @classmethod
    def from_design(cls, design: Design) -> ScanLoads:
        """Solve the probe on the tissue in the middle of a design's ranges, under its load and the loads of its protocol.

        Raises
        ------
        InputError
            The protocol has loads, but the scene's load is no force.
        Refusal
            The evaluator cannot model the scene or a load.
        """
        scene = ScenePopulation.from_scene(design.scene, design.population).middle
        return cls.from_scene(scene, design.protocol.loads)

    @classmethod
    def from_scene(cls, scene: Scene, loads: Sequence[float] = ()) -> ScanLoads:
        """Solve the probe on the tissue of a scene under its load and others, N; see ``from_design``."""
        main = TumourFree.from_scene(scene)
        if not loads:
            return cls((main,))
        force = scene.load.force
        if force is None:
            allowed = "nothing where the scene's load is an indentation; state a force as the scene's load"
            raise InputError("protocol.loads", Words(f"{len(loads)} forces"), allowed)
        others = [load for load in sorted(set(loads)) if abs(load - force) > SAME_FORCE_RELATIVE * force]
        scenes = [scene.model_copy(update={"load": Load(force=load)}) for load in others]
        try:
            loaded = [TumourFree.from_scene(part) for part in scenes]
        except Refusal as fault:  # names the scene's load
            key = "protocol.loads" if fault.key.startswith("load") else fault.key
            raise Refusal(key, fault.value, fault.allowed) from None
        nodes = sorted((main, *loaded), key=lambda node: node.scene.load.force or 0.0)
        linear = [node for node in nodes if node.is_linear]  # alike but for their load: the scene's own or the largest stays
        kept = [main if main.is_linear else linear[-1], *nodes[len(linear) :]] if linear else nodes
        return cls(tuple(kept), next(index for index, node in enumerate(kept) if node is main), tuple(sorted(set(loads))))

    @property
    def main(self) -> TumourFree:
        """The probe on the tissue without tumours under the scene's own load."""
        return self.nodes[self.main_index]

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scene without tumours under each load."""
        return tuple(node.scene for node in self.nodes)

    @property
    def evaluator(self) -> str:
        """Names of the models of the readings."""
        return ", ".join(dict.fromkeys(node.evaluator for node in self.nodes))

    @property
    def errors(self) -> Floats:
        """Standard deviations of the readings without tumours by errors of the model, at each load, shape (l, 2)."""
        return np.stack([node.errors for node in self.nodes])

    @cached_property
    def forces(self) -> Floats:
        """Force of each node, N, 0 of the linear one, shape (l,)."""
        return np.array([0.0 if node.is_linear else node.scene.load.force or 0.0 for node in self.nodes])

    @cached_property
    def linear_limit(self) -> float:
        """Largest force, N, for which linear elasticity holds; 0 where no load is linear."""
        if not self.nodes[0].is_linear:
            return 0.0
        largest = compute_load_limits(self.nodes[0].scene, LOAD_ACCURACY).linear
        return math.inf if largest is None else largest.force

    def check_forces(self, forces: Sequence[float | None]) -> None:
        """Refuse forces, N, None for the scene's load, at which readings are not predicted.

        Raises
        ------
        InputError
            A force is outside the loads.
        """
        low, high = (self.forces[index] * (1 + sign * MAX_FORCE_CHANGE_RELATIVE) for index, sign in ((0, -1), (-1, 1)))
        high = max(high, self.linear_limit)
        for index, force in enumerate(forces):
            if force is None or low <= force <= high:
                continue
            span = f"up to {1e3 * high:.3g} mN" if low == 0 else f"{1e3 * low:.4g} to {1e3 * high:.4g} mN"
            allowed = (
                f"{span}, about the design's load.force and [protocol] loads, between which readings are predicted: state the "
                f"smallest and the largest force of the readings there, loads = [..., '{1e3 * force:.4g} mN']"
            )
            raise InputError(f"reading[{index}].force", Words(f"{1e3 * force:.4g} mN"), allowed)

    def weigh(self, forces: Sequence[float | None]) -> tuple[Floats, Floats]:
        """Return the weights of the nodes in the signals of k readings at these forces, N, and those of their error, LO.6.

        Returns
        -------
        tuple[Floats, Floats]
            Shape (k, l) each: the signal is the sum of the nodes' signals with the first weights, its error that with the second.
        """
        weights, spreads = np.zeros((2, len(forces), len(self.nodes)))
        for row, force in enumerate(forces):
            index = self._find_node(force)
            if index is not None:
                weights[row, index] = 1.0
            elif len(self.nodes) == 1:
                # the signal changes by less than the force does
                weights[row], spreads[row] = 1.0, (force or 0.0) / self.forces[0] - 1
            else:
                upper = int(np.clip(np.searchsorted(self.forces, force or 0.0), 1, len(self.forces) - 1))
                first, second = self.forces[upper - 1 : upper + 1]
                share, square = (((force or 0.0) ** k - first**k) / (second**k - first**k) for k in (1, 2))
                weights[row, upper - 1 : upper + 1] = 1 - share, share
                spreads[row, upper - 1 : upper + 1] = square - share, share - square
        return weights, spreads

    def compute_logarithms(self, forces: Sequence[float | None]) -> Floats:
        """Return ln ratio and ln stiffness without tumours at the forces of k readings, N, shape (k, 2).

        Raises
        ------
        Refusal
            A force is above what ``contact`` models.
        """
        nodes = [self._find_node(force) for force in forces]
        distinct = sorted({force for force, node in zip(forces, nodes, strict=True) if node is None and force is not None})
        if len(distinct) > MAX_COMPUTED_FORCES:
            angles = np.pi * (np.arange(MAX_COMPUTED_FORCES) + 0.5) / MAX_COMPUTED_FORCES
            points = (distinct[0] + distinct[-1]) / 2 - (distinct[-1] - distinct[0]) / 2 * np.cos(angles) / np.cos(angles[0])
            curve = CubicSpline(points, [self._solve(float(force)).logarithms for force in points])
            known = {force: np.asarray(curve(force)) for force in distinct}
        else:
            known = {force: self._solve(force).logarithms for force in distinct}
        rows = [known[force or 0.0] if node is None else self.nodes[node].logarithms
                for force, node in zip(forces, nodes, strict=True)]  # fmt: skip
        return np.array(rows, dtype=float).reshape(len(rows), 2)

    def compute_noise(self, noise: NoiseModel, force: float | None) -> tuple[float, float]:
        """Return the standard deviations of a reading of ratio and stiffness by a design file's noise at a force, N.

        Noise of charges counts the less, the larger the force.
        """
        node = self.main if force is None else self.nodes[int(np.argmin(np.abs(self.forces - force)))]
        scene = node.scene if force is None else node.scene.model_copy(update={"load": Load(force=force)})
        ratio, stiffness = np.sqrt(compute_reading_variances(noise, scene, node.totals[None])[:, 0]).tolist()
        return ratio, stiffness

    def _find_node(self, force: float | None) -> int | None:
        """Return the index of the node at a force, N, or None between nodes."""
        if force is None:
            return self.main_index
        if force <= self.linear_limit:
            return 0
        distances = np.abs(self.forces / force - 1)
        nearest = int(np.argmin(distances))
        return nearest if distances[nearest] < SAME_FORCE_RELATIVE else None

    def _solve(self, force: float) -> TumourFree:
        """Return the tissue without tumours at a force, N, by the evaluator of its load."""
        return TumourFree.from_scene(self.main.scene.model_copy(update={"load": Load(force=force)}))
