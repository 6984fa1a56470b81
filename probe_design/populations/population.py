"""Tumours drawn from the ranges of a design file, each in its own tissue.

A draw is a scrambled Sobol sequence, so that n tumours fill the ranges more evenly than n random ones; those that do not fit are
drawn again. Tissues differ from patient to patient: two or four are drawn, and the tumours shared out among them, as
each takes a probe solved on it. All tumours count the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.stats import qmc

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Words
from geometry.scenes.messages import most_telling
from geometry.scenes.scene import Scene
from geometry.scenes.variables import changed
from probe_design.populations.ranges import Range
from probe_design.populations.tables import PopulationRanges

MOST_TISSUES, MOST_LAYERED = 4, 2  # of one material, and of layers, on which a probe takes three times as long to solve
COVER = 0.1  # of its diameter: least tissue between a tumour and surface or interface, see ``closed_form``'s ``LEAST_COVER``
CLEAR = 1 - 1e-6  # of the room that a tumour may fill
TRIES = 64  # times the tumours asked for that are drawn before giving up
UNSEEN = 104_729  # added to the seed for tumours that a search has not seen
OF_TUMOUR = ("depth", "diameter", "object", "x")


@dataclass(frozen=True)
class TumourDraw:
    """n tumours in t tissues.

    Attributes:
        scene: what the population leaves out.
        depth, diameter, youngs_modulus, x: of the tumours, m and Pa, shape (n,).
        poisson_ratio: of all.
        tissue: number of each tumour's tissue, shape (n,).
        tissues: the scene without tumours in each tissue.
        misfits: how many were drawn that did not fit.
    """

    scene: Scene
    depth: Floats
    diameter: Floats
    youngs_modulus: Floats
    x: Floats
    poisson_ratio: float
    tissue: Ints
    tissues: tuple[Scene, ...]
    misfits: int = 0

    def __len__(self) -> int:
        """How many tumours."""
        return len(self.depth)

    @property
    def beside(self) -> float:
        """How far the tumours lie beside the line of readings, m."""
        body, line = self.scene.inclusion, self.scene.placement.y
        return (body[0].y if body else line) - line

    @property
    def note(self) -> str | None:
        """What has to be said of it."""
        if not self.misfits:
            return None
        drawn = self.misfits + len(self)
        return f"{self.misfits} of {drawn} tumours drawn did not fit the tissue under the least cover and were drawn again"

    def on(self, scene: Scene) -> TumourDraw:
        """Return the same tumours and tissues under another scene's probe, contact and load."""
        own = {key: getattr(scene, key) for key in ("probe", "contact", "placement", "load")}
        with_it = tuple(one.model_copy(update=own) for one in (self.scene, *self.tissues))
        return replace(self, scene=with_it[0], tissues=with_it[1:])

    def of_tissue(self, number: int) -> Ints:
        """Return the numbers of the tumours in one tissue."""
        return np.flatnonzero(self.tissue == number)


@dataclass(frozen=True)
class ScenePopulation:
    """The ranges of a design file with what they leave out taken from a scene.

    Attributes:
        scene: with one inclusion or none.
        ranges: by name: depth, diameter, object, x; tissue; layer_0_thickness, layer_0_modulus and so on.
        least_cover: m.
        samples, seed: of draws.
    """

    scene: Scene
    ranges: dict[str, Range]
    least_cover: float
    samples: int
    seed: int

    @classmethod
    def of(cls, scene: Scene, given: PopulationRanges) -> ScenePopulation:
        """Complete the ranges of a design file."""
        own, tissue = scene.inclusion[0] if scene.inclusion else None, scene.tissue
        usual: dict[str, Any] = {"tissue": tissue.youngs_modulus, "x": own.x if own else scene.placement.x}
        if own is not None:
            usual |= {"depth": own.depth, "diameter": own.diameter, "object": own.youngs_modulus}
        stated = {key: getattr(given, key) for key in (*OF_TUMOUR, "tissue")}
        for number, layer in enumerate(tissue.layer):
            said = given.layer[number] if number < len(given.layer) else None
            usual |= {f"layer_{number}_thickness": layer.thickness, f"layer_{number}_modulus": layer.youngs_modulus}
            stated |= {f"layer_{number}_{key}": getattr(said, key, None) for key in ("thickness", "modulus")}
        ranges = {key: one if one is not None else Range((usual[key],), log=key != "x") for key, one in stated.items()}
        return cls(scene, ranges, given.least_cover, given.samples, given.seed)

    @property
    def of_tissue(self) -> tuple[str, ...]:
        """Names of what is the tissue's."""
        return tuple(key for key in self.ranges if key not in OF_TUMOUR)

    def drawn(self, samples: int | None = None, *, unseen: bool = False, tissues: int | None = None) -> TumourDraw:
        """Draw tumours; the same ones each time.

        Args:
            samples: how many; left out: as many as the design file says.
            unseen: whether to draw others, that no search has seen.
            tissues: how many, at most, where they differ; left out: so few as a probe is soon solved on.

        Raises:
            InputError: hardly any tumour of the ranges fits the tissue.
        """
        n, seed = samples or self.samples, self.seed + UNSEEN * unseen
        if all(one.single for one in self.ranges.values()):
            n = 1
        every = self._tissues(n, seed + 1, tissues or (MOST_LAYERED if self.scene.tissue.layer else MOST_TISSUES))
        shares = [len(part) for part in np.array_split(np.arange(n), len(every))]
        bodies, misfits = self._bodies(every, shares, seed)
        depth, diameter, modulus, x = bodies.T
        numbers, nu = np.repeat(np.arange(len(every)), shares), self._poisson_ratio
        return TumourDraw(self.scene, depth, diameter, modulus, x, nu, numbers, every, misfits)

    def _bodies(self, tissues: tuple[Scene, ...], shares: list[int], seed: int) -> tuple[Floats, int]:
        """So many tumours as fit each tissue, as ``TUMOUR_PARAMETERS``, (n, 4), and how many before the last of them did not.

        Each tissue has blocks of consecutive points: every fourth of a Sobol sequence lies in a part of the range alone.
        """
        sobol, block = qmc.Sobol(len(OF_TUMOUR), seed=seed), _power(shares[0])
        chosen, misfits = [np.empty((0, len(OF_TUMOUR))) for _ in tissues], 0
        for _ in range(TRIES):
            for number, (tissue, share) in enumerate(zip(tissues, shares, strict=True)):
                missing = share - len(chosen[number])
                bodies = _values([self.ranges[key] for key in OF_TUMOUR], sobol.random(block))
                fitting = np.flatnonzero(self.fits(tissue, bodies))[:missing]
                tried = 0 if not missing else block if len(fitting) < missing else int(fitting[-1]) + 1
                misfits += tried - len(fitting)
                chosen[number] = np.concatenate([chosen[number], bodies[fitting]])
            if sum(map(len, chosen)) == sum(shares):
                return np.concatenate(chosen), misfits
        fit = Words(f"{sum(map(len, chosen))} of {TRIES * block * len(tissues)} tumours fit")
        why = self._misfit(tissues[0], _values([self.ranges[key] for key in OF_TUMOUR], sobol.random(block)))
        raise InputError("population", fit, f"ranges of which more fit: most of these {why}")

    def _misfit(self, tissue: Scene, bodies: Floats) -> str:
        """Describe the most frequent reason why tumours do not fit."""
        depth, diameter = bodies.T[:2]
        radius, shallow = diameter / 2, np.maximum(self.least_cover, COVER * diameter)
        cover = np.mean(depth - radius < shallow)
        faces = [np.abs(depth - face) - radius < COVER * diameter for face in tissue.tissue.interfaces]
        across = np.mean(np.any(faces, axis=0)) if faces else 0.0
        beyond = np.mean(~self.fits(tissue.model_copy(update={"tissue": _unlayered(tissue)}), bodies)) - cover
        shares = {
            "are not under the least cover: a depth less half the diameter of a tenth of the diameter and of least_cover": cover,
            "are crossed by an interface of layers, or within a tenth of a diameter of one": across,
            "reach beyond the tissue's side or floor": beyond,
        }
        return max(shares, key=lambda key: shares[key])

    def fits(self, tissue: Scene, bodies: Floats) -> Bools:
        """Return which tumours, shape (n, 4), lie within one layer of a scene's tissue and under the least cover."""
        of, (depth, diameter, _, x), y = tissue.tissue, bodies.T, self._y
        radius, cover = diameter / 2, np.maximum(self.least_cover, COVER * diameter)
        good = depth - radius >= cover
        for face in of.interfaces:
            good &= np.abs(depth - face) - radius >= COVER * diameter
        if of.shape == "half-space":
            return np.asarray(good)
        beside = (
            of.radius - np.hypot(x, y)
            if of.shape == "cylinder"
            else np.minimum(of.length / 2 - np.abs(x), of.breadth / 2 - abs(y))
        )
        return np.asarray(good & (radius < CLEAR * np.minimum(of.depth - depth, beside)))

    @property
    def _y(self) -> float:
        return self.scene.inclusion[0].y if self.scene.inclusion else self.scene.placement.y

    @property
    def _poisson_ratio(self) -> float:
        return self.scene.inclusion[0].poisson_ratio if self.scene.inclusion else self.scene.tissue.poisson_ratio

    def _tissues(self, n: int, seed: int, most: int) -> tuple[Scene, ...]:
        """The scene without tumours in tissues of the population, one where nothing of it differs.

        Raises:
            InputError: a tissue is none, such as one with layers thicker than it is deep.
        """
        keys = self.of_tissue
        count = 1 if all(self.ranges[key].single for key in keys) else min(n, most)
        rows = _values([self.ranges[key] for key in keys], qmc.Sobol(len(keys), seed=seed).random(_power(count))[:count])
        return tuple(self.in_tissue(dict(zip(keys, row.tolist(), strict=True))) for row in rows)

    @property
    def middle(self) -> Scene:
        """The scene without tumours in the tissue in the middle of all ranges."""
        return self.in_tissue({key: self.ranges[key].middle for key in self.of_tissue})

    def in_tissue(self, numbers: Mapping[str, float]) -> Scene:
        """Return the scene without tumours in a tissue with these numbers, by the names of ``ranges``.

        Raises:
            InputError: it is none.
        """
        return self.varied(self.scene.model_copy(update={"inclusion": ()}), numbers)

    @staticmethod
    def varied(scene: Scene, numbers: Mapping[str, float]) -> Scene:
        """Return a scene with other numbers of its tissue. Raises ``InputError``: it is none."""
        try:
            return changed(scene, {scene_key(name): value for name, value in numbers.items()})
        except ValidationError as refused:
            fault = most_telling(refused)
            raise InputError(f"population, {fault.key}", fault.value, fault.allowed) from None


def is_of_tumour(name: str) -> bool:
    """Whether a range is of the tumours themselves, or of their tissue."""
    return name in OF_TUMOUR


def scene_key(name: str) -> str:
    """Return the scene's key of a range of the tissue: tissue, layer_0_thickness, layer_0_modulus and so on."""
    if name == "tissue":
        return "tissue.youngs_modulus"
    _, number, what = name.split("_")
    return f"tissue.layer[{number}].{'youngs_modulus' if what == 'modulus' else what}"


def _values(ranges: Sequence[Range], shares: Floats) -> Floats:
    """Values of quantities that these shares of the population stay below, shape (n, quantities)."""
    return np.stack([one.at(column) for one, column in zip(ranges, shares.T, strict=True)], axis=1)


def _power(n: int) -> int:
    """The least power of two that is not below n: what a Sobol sequence is balanced for."""
    return 1 << max(n - 1, 0).bit_length()


def _unlayered(scene: Scene) -> Any:
    return scene.tissue.model_copy(update={"layer": ()})


def host_modulus(draw: TumourDraw, number: int) -> str:
    """Return the name, as of ``ScenePopulation.ranges``, of the modulus of the tissue or layer about a tumour."""
    faces = draw.tissues[draw.tissue[number]].tissue.interfaces
    above = sum(face <= draw.depth[number] for face in faces)
    return "tissue" if above == len(faces) else f"layer_{above}_modulus"
