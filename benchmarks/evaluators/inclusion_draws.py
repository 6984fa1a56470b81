"""Draw random scenes with one tumour on the axis, with or without layers, each determined by a seed and a number."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from geometry import Contact, CylinderTissue, Inclusion, Load, Material, Probe, Scene
from geometry.scenes.scene_tables import Layer

COVERS = (0.02, 2.0)  # diameters
GAPS = (0.02, 1.0)  # diameters: between the sphere and the interfaces of its layer
CONTRASTS = (10.0, 1e3)  # of layers: the largest of every other scene each
STIFFEST = (10.0, 1e2, 1e4)  # likewise of scenes that may have skins: of every third scene each
NEAR_GAP_DIAMETERS = (1e-4, 0.05)  # diameters: between a sphere that all but touches and what it is near to
SKIN_THICKNESSES = 0.5  # mm: the thinnest
RATIOS = (0.3, 0.45, 0.49, 0.4999)  # Poisson's, of layers
CONTACTS = ("bonded", "frictionless")


@dataclass(frozen=True)
class DrawnScene:
    """A scene in numbers: lengths in mm; ``_ratio``: of the tissue's modulus or of a radius, as said.

    Attributes
    ----------
    tissue_radius, tissue_depth
        mm.
    cover
        Tissue above the sphere, diameters.
    contrast
        The sphere's modulus over that of the tissue about it.
    inner_modulus, outer_modulus
        Over the tissue's, 6 kPa.
    layers
        From the surface downwards: thickness, modulus over the tissue's own, Poisson's ratio.
    """

    inner_radius: float
    area_ratio: float
    gap: float
    inner_height: float
    outer_height: float
    inner_modulus: float
    outer_modulus: float
    block_poisson: float
    tissue_radius: float
    tissue_depth: float
    tissue_poisson: float
    diameter: float
    cover: float
    contrast: float
    inclusion_poisson: float
    contact: str
    layers: tuple[tuple[float, float, float], ...] = ()

    def __str__(self) -> str:
        """All numbers, as they are given to ``DrawnScene`` again."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return ", ".join(f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value!r}" for name, value in values)

    def scene(self, modulus: float = 6e3) -> Scene:
        """Return it as a scene; raises ``InputError`` or ``ValueError`` where its parts do not fit."""
        mm, blocks = 1e-3, self.block_poisson
        probe = Probe(
            inner_radius=self.inner_radius * mm,
            area_ratio=self.area_ratio,
            gap=self.gap * mm,
            inner_height=self.inner_height * mm,
            outer_height=self.outer_height * mm,
            inner=Material(youngs_modulus=self.inner_modulus * modulus, poisson_ratio=blocks),
            outer=Material(youngs_modulus=self.outer_modulus * modulus, poisson_ratio=blocks),
        )
        layers = tuple(Layer(thickness=h * mm, youngs_modulus=c * modulus, poisson_ratio=nu) for h, c, nu in self.layers)
        tissue = CylinderTissue(
            shape="cylinder",
            radius=self.tissue_radius * mm,
            depth=self.tissue_depth * mm,
            youngs_modulus=modulus,
            poisson_ratio=self.tissue_poisson,
            layer=layers,
        )
        depth = (self.cover + 0.5) * self.diameter * mm
        body = Inclusion(
            diameter=self.diameter * mm,
            depth=depth,
            youngs_modulus=self.contrast * tissue.find_material(depth).youngs_modulus,
            poisson_ratio=self.inclusion_poisson,
        )
        contact = Contact(interface="bonded" if self.contact == "bonded" else "frictionless")
        return Scene(probe=probe, tissue=tissue, inclusion=(body,), contact=contact, load=Load(indentation=1e-6))


def draw(seed: int, number: int) -> DrawnScene:
    """Return one scene, the same for the same seed and number."""
    rng = np.random.default_rng([seed, number])

    def draw_log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    radius, height = draw_log_uniform(0.5, 10), draw_log_uniform(0.1, 4)
    area_ratio, gap = draw_log_uniform(0.05, 20), draw_log_uniform(0.005, 0.4) * radius
    outer = float(np.sqrt((radius + gap) ** 2 + area_ratio * radius**2))
    diameter, cover = draw_log_uniform(0.2, 4) * outer, draw_log_uniform(*COVERS)
    room = (draw_log_uniform(1.3, 15) * outer, draw_log_uniform(0.7, 1.0) * diameter)
    return DrawnScene(
        inner_radius=radius,
        area_ratio=area_ratio,
        gap=gap,
        inner_height=height * radius,
        outer_height=height * radius * draw_log_uniform(0.7, 1.4),
        inner_modulus=draw_log_uniform(0.3, 1e3),
        outer_modulus=draw_log_uniform(0.3, 1e3),
        block_poisson=float(rng.uniform(0.3, 0.499)),
        tissue_radius=max(room),
        tissue_depth=(1 + cover) * diameter * draw_log_uniform(1.05, 5),
        tissue_poisson=float(rng.choice([rng.uniform(0.3, 0.499), 0.45, 0.49, 0.499])),
        diameter=diameter,
        cover=cover,
        contrast=draw_log_uniform(1e-2, 1e3),
        inclusion_poisson=float(rng.uniform(0.1, 0.499)),
        contact=str(rng.choice(CONTACTS)),
    )


def draw_layered(seed: int, number: int) -> DrawnScene:
    """Return the same scene with one to three layers, none of whose interfaces crosses the sphere."""
    rng, plain = np.random.default_rng([seed, number, 1]), draw(seed, number)

    def gap() -> float:
        return float(np.exp(rng.uniform(*np.log(GAPS)))) * plain.diameter

    top, low = plain.cover * plain.diameter, (plain.cover + 1) * plain.diameter
    layers_above, layers_below = [(1, 0), (0, 1), (1, 1), (2, 0), (2, 1)][int(rng.integers(5))]
    first, last = top - min(gap(), 0.9 * top), low + min(gap(), 0.9 * (plain.tissue_depth - low))
    depths = [first * rng.uniform(0.1, 0.9)] * (layers_above == 2) + [first] * (layers_above > 0) + [last] * layers_below
    max_contrast = CONTRASTS[number % 2]
    materials = ((float(np.exp(rng.uniform(-1, 1) * np.log(max_contrast))), float(rng.choice(RATIOS))) for _ in depths)
    layers = tuple((float(h), *material) for h, material in zip(np.diff([0.0, *depths]), materials, strict=True))
    return replace(plain, layers=layers)


def draw_skins(seed: int, number: int) -> DrawnScene:
    """Return the same scene with one to three layers of wider contrasts, often a thin skin; no interface crosses the sphere."""
    rng, plain = np.random.default_rng([seed, number, 2]), draw(seed, number)

    def gap(max_gap: float) -> float:
        return min(float(np.exp(rng.uniform(*np.log(GAPS)))) * plain.diameter, 0.9 * max_gap)

    top, low = plain.cover * plain.diameter, (plain.cover + 1) * plain.diameter
    layers_above, layers_below = [(1, 0), (0, 1), (1, 1), (2, 0), (2, 1), (1, 2)][int(rng.integers(6))]
    first, last = top - gap(top), low + gap(plain.tissue_depth - low)
    skin = rng.random() < 0.6 and 0.9 * top > SKIN_THICKNESSES
    thin = float(np.exp(rng.uniform(*np.log([SKIN_THICKNESSES, 0.9 * top])))) if skin else first * float(rng.uniform(0.1, 0.9))
    upper = sorted([thin, first])[:layers_above] if skin or layers_above == 2 else [first] * layers_above
    depths = [*upper, last, last + (plain.tissue_depth - last) * float(rng.uniform(0.1, 0.9))][: len(upper) + layers_below]
    max_stiffness = STIFFEST[number % 3]
    materials = ((float(np.exp(rng.uniform(-1, 1) * np.log(max_stiffness))), float(rng.choice(RATIOS))) for _ in depths)
    layers = tuple((float(h), *material) for h, material in zip(np.diff([0.0, *depths]), materials, strict=True))
    return replace(plain, layers=layers)


def draw_near(seed: int, number: int) -> DrawnScene:
    """Return the same scene with the sphere all but touching an interface above or below it, the tissue's bottom or side."""
    rng, plain = np.random.default_rng([seed, number, 3]), draw(seed, number)
    gap = float(np.exp(rng.uniform(*np.log(NEAR_GAP_DIAMETERS)))) * plain.diameter
    kind, top, low = number % 4, plain.cover * plain.diameter, (plain.cover + 1) * plain.diameter
    if kind == 3:
        outer = float(np.hypot(plain.inner_radius + plain.gap, plain.inner_radius / np.sqrt(plain.area_ratio)))
        return replace(plain, tissue_radius=max(plain.diameter / 2 + gap, 1.05 * outer))
    if kind == 2:
        return replace(plain, tissue_depth=low + gap)
    max_contrast = CONTRASTS[int(rng.integers(2))]
    material = (float(np.exp(rng.uniform(-1, 1) * np.log(max_contrast))), float(rng.choice(RATIOS)))
    if kind == 0 and top > 2 * gap:
        return replace(plain, layers=((top - gap, *material),))
    depth = low + gap
    return replace(plain, layers=((depth, *material),), tissue_depth=max(plain.tissue_depth, 1.2 * depth))
