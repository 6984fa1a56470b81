"""Draw tumours and their tissues from the ranges of a design file.

A draw is a scrambled Sobol sequence, so that n tumours fill the ranges more evenly than n random ones. Tumours that do not fit
are drawn again. Tissues differ from patient to patient: two or four are drawn, and the tumours divided among them, since the
probe has to be solved on each. All tumours have the same weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.tissue_sides import compute_side_distance
from probe_design.populations.entries import Range
from probe_design.populations.tables import PopulationRanges, Protocol

MAX_TISSUES, MAX_LAYERED_TISSUES = 4, 2  # on one material, and on layers, where solving a probe takes three times as long
MIN_COVER_PER_DIAMETER = (
    0.1  # of its diameter: minimum distance of a tumour from surface or interface, see ``MIN_COVER_DIAMETERS`` of the closed form
)
SIDE_CLEARANCE_FACTOR = 1 - 1e-6  # fraction of the space to the sides that a tumour may fill
MAX_DRAWS_PER_TUMOUR = 64  # draws per requested tumour before an error
UNSEEN_SEED_OFFSET = 104_729  # added to the seed for tumours that are not used in a search
PLACE_AXES = ("x", "y")
TUMOUR_PARAMETERS = ("depth", "diameter", "object", *PLACE_AXES)


@dataclass(frozen=True)
class TumourDraw:
    """n tumours in t tissues.

    Attributes
    ----------
    scene
        Scene with the values that the population does not give.
    depth, diameter, youngs_modulus, x, y
        Depth of the centre, diameter, Young's modulus, x and y of each tumour, m and Pa, shape (n,).
    poisson_ratio
        Poisson's ratio of all tumours.
    tissue
        Index in ``tissues`` of each tumour's tissue, shape (n,).
    tissues
        The scene without tumours, with each tissue.
    misfits
        Number of tumours drawn that did not fit.
    """

    scene: Scene
    depth: Floats
    diameter: Floats
    youngs_modulus: Floats
    x: Floats
    y: Floats
    poisson_ratio: float
    tissue: Ints
    tissues: tuple[Scene, ...]
    misfits: int = 0

    def __len__(self) -> int:
        """Return the number of tumours."""
        return len(self.depth)

    def compute_distances(self, protocol: Protocol) -> Floats:
        """Return x and y of each tumour less those of the probe at each place of a protocol, m, shape (n, p, 2)."""
        return np.stack([self.x, self.y], axis=-1)[:, None] - protocol.list_places(self.scene.placement.y)

    @property
    def note(self) -> str | None:
        """A note for the user about the draw, or None."""
        if not self.misfits:
            return None
        drawn = self.misfits + len(self)
        return f"{self.misfits} of {drawn} tumours drawn did not fit the tissue under the least cover and were drawn again"

    def replace_probe(self, scene: Scene) -> TumourDraw:
        """Return the same tumours and tissues with another scene's probe, contact and load."""
        replacements = {key: getattr(scene, key) for key in ("probe", "contact", "placement", "load")}
        with_it = tuple(changed_scene.model_copy(update=replacements) for changed_scene in (self.scene, *self.tissues))
        return replace(self, scene=with_it[0], tissues=with_it[1:])

    def find_members(self, number: int) -> Ints:
        """Return the indices of the tumours in the tissue with this number, shape (k,)."""
        return np.flatnonzero(self.tissue == number)


@dataclass(frozen=True)
class ScenePopulation:
    """The ranges of a design file, completed by values of a scene.

    Attributes
    ----------
    scene
        Scene with one inclusion or none.
    ranges
        Ranges by name: depth, diameter, object, x, y; tissue; layer_0_thickness, layer_0_modulus and so on.
    least_cover
        Minimum cover of a tumour, m.
    samples, seed
        Number of tumours and seed of a draw.
    """

    scene: Scene
    ranges: dict[str, Range]
    least_cover: float
    samples: int
    seed: int

    @classmethod
    def from_scene(cls, scene: Scene, given: PopulationRanges) -> ScenePopulation:
        """Complete the ranges of a design file: a quantity that the file leaves out has the scene's value as its only one."""
        inclusion, tissue = scene.inclusion[0] if scene.inclusion else None, scene.tissue
        middle = inclusion or scene.placement
        scene_values: JsonObject = {"tissue": tissue.youngs_modulus, "x": middle.x, "y": middle.y}
        if inclusion is not None:
            scene_values |= {"depth": inclusion.depth, "diameter": inclusion.diameter, "object": inclusion.youngs_modulus}
        stated = {key: getattr(given, key) for key in (*TUMOUR_PARAMETERS, "tissue")}
        for number, layer in enumerate(tissue.layer):
            stated_layer = given.layer[number] if number < len(given.layer) else None
            scene_values |= {f"layer_{number}_thickness": layer.thickness, f"layer_{number}_modulus": layer.youngs_modulus}
            stated |= {f"layer_{number}_{key}": getattr(stated_layer, key, None) for key in ("thickness", "modulus")}
        ranges = {
            key: value_range if value_range is not None else Range((scene_values[key],), log=key not in PLACE_AXES)
            for key, value_range in stated.items()
        }
        return cls(scene, ranges, given.least_cover, given.samples, given.seed)

    @property
    def tissue_parameters(self) -> tuple[str, ...]:
        """Names of the ranges that describe the tissue and its layers, not the tumours."""
        return tuple(key for key in self.ranges if key not in TUMOUR_PARAMETERS)

    def draw_tumours(self, samples: int | None = None, *, unseen: bool = False, tissues: int | None = None) -> TumourDraw:
        """Draw tumours, the same ones each time.

        Parameters
        ----------
        samples
            Number of tumours; default: that of the design file.
        unseen
            Whether to draw other tumours, which are not used in a search.
        tissues
            Maximum number of tissues, if they differ; default: few, so that solving the probe on them is fast.

        Raises
        ------
        InputError
            Too few tumours of the ranges fit the tissue.
        """
        n, seed = samples or self.samples, self.seed + UNSEEN_SEED_OFFSET * unseen
        if all(value_range.is_single for value_range in self.ranges.values()):
            n = 1
        tissue_scenes = self._draw_tissues(
            n, seed + 1, tissues or (MAX_LAYERED_TISSUES if self.scene.tissue.layer else MAX_TISSUES)
        )
        counts = [len(part) for part in np.array_split(np.arange(n), len(tissue_scenes))]
        bodies, misfits = self._draw_bodies(tissue_scenes, counts, seed)
        numbers, nu = np.repeat(np.arange(len(tissue_scenes)), counts), self.poisson_ratio
        depth, diameter, modulus, x, y = bodies.T
        return TumourDraw(self.scene, depth, diameter, modulus, x, y, nu, numbers, tissue_scenes, misfits)

    def _draw_bodies(self, tissues: tuple[Scene, ...], counts: list[int], seed: int) -> tuple[Floats, int]:
        """Draw tumours until enough fit their tissues.

        Each tissue takes whole blocks of consecutive Sobol points, as every fourth point of a Sobol sequence, for instance,
        covers only part of the range.

        Parameters
        ----------
        tissues
            The scene without tumours, with each tissue.
        counts
            Number of tumours wanted in each tissue, the largest first.
        seed
            Seed of the Sobol sequence.

        Returns
        -------
        tuple[Floats, int]
            The tumours, tissue by tissue, with columns as in ``TUMOUR_PARAMETERS``, shape (n, 5), and the number drawn that did
            not fit.
        """
        ranges, block = [self.ranges[key] for key in TUMOUR_PARAMETERS], _find_power_of_two(counts[0])
        # a y that is the same for all takes no dimension of the sequence
        sobol = qmc.Sobol(len(ranges) - ranges[-1].is_single, seed=seed)
        chosen, misfits = [np.empty((0, len(TUMOUR_PARAMETERS))) for _ in tissues], 0
        for _ in range(MAX_DRAWS_PER_TUMOUR):
            for number, (tissue, count) in enumerate(zip(tissues, counts, strict=True)):
                missing = count - len(chosen[number])
                bodies = _draw_values(ranges, sobol.random(block))
                misfits_by_reason = self.find_misfits(tissue, bodies).values()
                fitting = np.flatnonzero(~np.any(list(misfits_by_reason), axis=0))[:missing]
                # points after the last tumour needed are not counted as tried
                tried = 0 if not missing else block if len(fitting) < missing else int(fitting[-1]) + 1
                misfits += tried - len(fitting)
                chosen[number] = np.concatenate([chosen[number], bodies[fitting]])
            if sum(map(len, chosen)) == sum(counts):
                return np.concatenate(chosen), misfits
        fit = Words(f"{sum(map(len, chosen))} of {MAX_DRAWS_PER_TUMOUR * block * len(tissues)} tumours fit")
        # one more block, from which the commonest reason is determined for the message
        bodies = _draw_values(ranges, sobol.random(block))
        reasons = self.find_misfits(tissues[0], bodies)
        reason = max(reasons, key=lambda key: np.mean(reasons[key]))
        raise InputError("population", fit, f"ranges of which more fit: most of these {reason}")

    def find_misfits(self, scene: Scene, bodies: Floats) -> dict[str, Bools]:
        """Return which tumours do not fit a scene's tissue, by reason: too near the surface, an interface, a side or the bottom.

        Parameters
        ----------
        scene
            Scene with the tissue.
        bodies
            Tumours with columns as in ``TUMOUR_PARAMETERS``, shape (n, 5).

        Returns
        -------
        dict[str, Bools]
            Whether each tumour does not fit, shape (n,), by the reason as a message states it.
        """
        tissue, (depth, diameter, _, x, y) = scene.tissue, bodies.T
        radius, cover = diameter / 2, np.maximum(self.least_cover, MIN_COVER_PER_DIAMETER * diameter)
        shallow, across = depth - radius < cover, np.zeros(len(x), dtype=bool)
        for face in tissue.interfaces:
            across |= np.abs(depth - face) - radius < MIN_COVER_PER_DIAMETER * diameter
        side_distance = compute_side_distance(tissue, x, y)
        outside = radius >= SIDE_CLEARANCE_FACTOR * np.minimum(tissue.bottom - depth, side_distance)
        needed = "a depth less half the diameter of a tenth of the diameter and of least_cover"
        return {
            f"are not under the least cover: {needed}": shallow,
            "are crossed by an interface of layers, or within a tenth of a diameter of one": across,
            "reach beyond the tissue's side or bottom": outside & ~shallow,
        }

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio of every tumour: that of the scene's inclusion, or without one that of the tissue."""
        return self.scene.inclusion[0].poisson_ratio if self.scene.inclusion else self.scene.tissue.poisson_ratio

    def _draw_tissues(self, n: int, seed: int, max_count: int) -> tuple[Scene, ...]:
        """Return the scene without tumours with tissues of the population; a single one if its tissue does not vary.

        Raises
        ------
        InputError
            A tissue is not valid, for instance with layers thicker than the whole.
        """
        keys = self.tissue_parameters
        count = 1 if all(self.ranges[key].is_single for key in keys) else min(n, max_count)
        rows = _draw_values(
            [self.ranges[key] for key in keys], qmc.Sobol(len(keys), seed=seed).random(_find_power_of_two(count))[:count]
        )
        return tuple(self.build_tissue_scene(dict(zip(keys, row.tolist(), strict=True))) for row in rows)

    @property
    def middle(self) -> Scene:
        """The scene without tumours, with the tissue in the middle of all ranges."""
        return self.build_tissue_scene({key: self.ranges[key].middle for key in self.tissue_parameters})

    def build_tissue_scene(self, numbers: Mapping[str, float]) -> Scene:
        """Return the scene without tumours, with these numbers of the tissue by the names of ``ranges``.

        Raises
        ------
        InputError
            The tissue is not valid.
        """
        return self.replace_tissue_numbers(self.scene.model_copy(update={"inclusion": ()}), numbers)

    @staticmethod
    def replace_tissue_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
        """Return a scene with these numbers of its tissue, by names of ``ranges``; raise ``InputError`` if it is not valid."""
        try:
            return scene.replace({get_scene_key(name): value for name, value in numbers.items()})
        except InputError as fault:
            raise InputError(f"population, {fault.key}", fault.value, fault.allowed) from None


def is_of_tumour(name: str) -> bool:
    """Return whether the range of this name describes the tumours; otherwise it describes the tissue."""
    return name in TUMOUR_PARAMETERS


def get_scene_key(name: str) -> str:
    """Return the key in a scene, as "tissue.layer[0].thickness", for the name of a tissue's range, as "layer_0_thickness"."""
    if name == "tissue":
        return "tissue.youngs_modulus"
    _, number, what = name.split("_")
    return f"tissue.layer[{number}].{'youngs_modulus' if what == 'modulus' else what}"


def _draw_values(ranges: Sequence[Range], fractions: Floats) -> Floats:
    """Return the value of each quantity at the given fractions of its range.

    Parameters
    ----------
    ranges
        Range of each of q quantities.
    fractions
        Fraction of the population below each value, 0 to 1, shape (n, q); without a column for last quantities of a single value.

    Returns
    -------
    Floats
        Values, shape (n, q).
    """
    middles = np.full((len(fractions), len(ranges) - fractions.shape[1]), 0.5)
    columns = np.hstack([fractions, middles]).T
    return np.stack([value_range.compute_quantiles(column) for value_range, column in zip(ranges, columns, strict=True)], axis=1)


def _find_power_of_two(n: int) -> int:
    """Return the smallest power of two that is at least n, for which a Sobol sequence is balanced."""
    return 1 << max(n - 1, 0).bit_length()


def name_host_modulus(draw: TumourDraw, number: int) -> str:
    """Return the name in ``ScenePopulation.ranges`` of the modulus of the tissue or layer around a tumour."""
    # interfaces are depths, so that the number of those above the tumour's centre is the index of its layer
    faces = draw.tissues[draw.tissue[number]].tissue.interfaces
    layer_index = sum(face <= draw.depth[number] for face in faces)
    return "tissue" if layer_index == len(faces) else f"layer_{layer_index}_modulus"
