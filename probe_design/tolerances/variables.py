"""What may be off in a built probe, and by how much: lengths, moduli and Poisson's ratios of its blocks, its films' gains.

With eta standard normal, each number is distributed so that no draw is impossible and the first order is t eta:

    x = x0 e^(t eta / x0)  of lengths, moduli and gains;   nu = 1 / (2 + 2 e^(-a - s eta)),  s = t / (nu0 (1 - 2 nu0))   (TO.1)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from geometry.cad.materials import part_materials
from geometry.common.errors import InputError, one_of
from geometry.scenes.catalogue import find_material
from geometry.scenes.probe import LENGTH
from geometry.scenes.scene import Scene
from geometry.scenes.units import fraction
from geometry.scenes.variables import values
from geometry.workshop.tolerance import RECTANGULAR, tolerance, written
from probe_design.built_probe.bench import Bench, Channels, Workshop

Kind = Literal["length", "modulus", "poisson_ratio", "gain"]
GAINS = ("film.inner.gain", "film.outer.gain")
RADIUS, GAP = "probe.inner_radius", "probe.gap"
BLOCKS = {  # of each length: which block it is of, and whether it lies across the mould's parting plane
    "probe.inner_radius": ("inner", False), "probe.gap": ("outer", False), "probe.outer_radius": ("outer", False),
    "probe.height": ("inner", True), "probe.inner_height": ("inner", True), "probe.outer_height": ("outer", True),
}  # fmt: skip
MM = 1e3
LARGEST = 2.0  # standard deviation of a logarithm
SHARE = f"a relative standard deviation from 0 to {LARGEST:g}, such as 0.02 or 2 %"
RATIO = "a standard deviation from 0 to 0.1, such as 0.003"


@dataclass(frozen=True)
class Toleranced:
    """A number of the probe that may be off.

    Attributes:
        name: its key in the scene file; of a film's gain one of ``GAINS``.
        kind: what it is.
        value: as drawn, SI; 1 of a gain.
        sd: standard deviation of the built one, SI; of ln E of a modulus times it.
        source: where the standard deviation comes from.
    """

    name: str
    kind: Kind
    value: float
    sd: float
    source: str

    def drawn(self, eta: Any) -> Any:
        """Return eq. TO.1 at eta, real or complex, of any shape."""
        if self.kind != "poisson_ratio":
            return self.value * np.exp(self.sd / self.value * eta)
        if self.sd == 0.0 or self.value == 0.0:
            return self.value + 0.0 * eta
        odds = math.log(2 * self.value / (1 - 2 * self.value))
        return 0.5 / (1 + np.exp(-odds - self.sd / (self.value * (1 - 2 * self.value)) * eta))


def toleranced(
    scene: Scene, bench: Bench | None = None, materials: Mapping[str, str] | None = None, given: Mapping[str, Any] | None = None
) -> tuple[Toleranced, ...]:
    """Return what may be off in a scene's probe, which is given by its outer radius.

    Lengths are off by what the process of their block allows (``geometry.workshop.processes``), the gap by what the hole's radius
    is; a modulus that is the catalogue's by what the catalogue says, any other as a measured one.

    Args:
        scene: see ``probe_design.built_probe.block_predictions.by_outer_radius``.
        bench: whose ``[channels]`` hold, and whose ``[workshop]`` does for lengths and measured numbers; left out: see above.
        materials: of the blocks "inner" and "outer", by names of the catalogue: how well their moduli are known.
        given: standard deviations by names, in place of these: text with its unit, "5 %", or SI numbers, relative ones of moduli
            and gains.

    Raises:
        InputError: no such block, material or name, or what is given is no standard deviation.
    """
    workshop, channels = (Workshop(), Channels()) if bench is None else (bench.workshop, bench.channels)
    origin = "built-in bench" if bench is None else "bench"
    found = {name: _of_workshop(name, value, workshop, origin) for name, value in values(scene).items() if _of_blocks(name)}
    if bench is None:
        found |= {name: _of_process(scene, one) for name, one in found.items() if name in BLOCKS}
    found |= {name: Toleranced(name, "gain", 1.0, channels.gain, f"{origin}, [channels] gain") for name in GAINS}
    for block, what in {**tabulated(scene), **(materials or {})}.items():
        found |= _of_material(found, block, what)
    for name, entry in (given or {}).items():
        if name not in found:
            raise InputError("tolerance", name, one_of(name, found))
        found[name] = replace(found[name], sd=_read(found[name], entry), source="given")
    return tuple(found.values())


def tabulated(scene: Scene) -> dict[str, str]:
    """Return the names of the blocks' materials whose moduli are the catalogue's, and so not measured, by block."""
    blocks = {"inner": scene.probe.inner.unmeasured, "outer": scene.probe.outer.unmeasured}
    return {block: one.name for block, one in blocks.items() if one is not None}


def _of_process(scene: Scene, one: Toleranced) -> Toleranced:
    """A length as its block's process makes it; radii are made as diameters."""
    block, closure = BLOCKS[one.name]
    process = part_materials(scene.probe)[block].process
    radius = scene.probe.hole_radius if one.name == GAP else one.value
    factor = 1 if closure else 2
    held = tolerance(factor * MM * radius, process=process, closure=closure)
    sd = held.deviation / (factor * MM * RECTANGULAR)
    source = (
        f"{process}, {held.source}: \N{PLUS-MINUS SIGN}{written(held.deviation)} mm of the {'height' if closure else 'diameter'}"
    )
    return replace(one, sd=sd, source=source)


def _of_blocks(name: str) -> bool:
    """Whether a number of the scene is a block's: films and base are bought or hardly matter."""
    return name.startswith("probe.") and not name.startswith(("probe.film.", "probe.base.")) and name != "probe.area_ratio"


def _of_workshop(name: str, value: float, workshop: Workshop, origin: str) -> Toleranced:
    if name.endswith("modulus"):
        return Toleranced(name, "modulus", value, workshop.modulus * value, f"{origin}, [workshop] modulus")
    if name.endswith("poisson_ratio"):
        return Toleranced(name, "poisson_ratio", value, workshop.poisson_ratio, f"{origin}, [workshop] poisson_ratio")
    return Toleranced(name, "length", value, workshop.length, f"{origin}, [workshop] length")


def _of_material(found: Mapping[str, Toleranced], block: str, what: str) -> dict[str, Toleranced]:
    name = f"probe.{block}.youngs_modulus"
    if name not in found:
        raise InputError("material", f"{block}={what}", "inner=NAME or outer=NAME, of a block")
    one = find_material(what)
    if one.kind == "film" or not one.admits(found[name].value):
        near = f"a material of about {found[name].value:.4g} Pa, as the block; {one.name} has {one.youngs_modulus:.4g} Pa"
        raise InputError("material", f"{block}={what}", near)
    return {name: replace(found[name], sd=one.log_sd * found[name].value, source=f"{one.name}: {one.tolerance}")}


def _read(one: Toleranced, entry: Any) -> float:
    """A standard deviation as it is given, SI."""
    key = f"tolerance.{one.name}"
    if one.kind == "length":
        sd = LENGTH.read(key, entry, units_required=isinstance(entry, str)) if entry not in (0, "0") else 0.0
        if sd > LARGEST * one.value:
            raise InputError(key, entry, f"a length up to {LARGEST:g} times the drawn one, {one.value:.4g} m")
        return sd
    allowed, most = (RATIO, 0.1) if one.kind == "poisson_ratio" else (SHARE, LARGEST)
    sd = fraction(key, entry, allowed)
    if not 0 <= sd <= most:
        raise InputError(key, entry, allowed)
    return sd if one.kind == "poisson_ratio" else sd * one.value
