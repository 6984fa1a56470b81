"""Uncertain numbers of a built probe: lengths, moduli and Poisson's ratios of its blocks, and gains of its films.

With eta standard normal, x0 (nu0) the drawn value, t its standard deviation and a = ln(2 nu0 / (1 - 2 nu0)), each number is
distributed so that no draw is impossible and its first order is t eta:

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
BLOCKS = {  # of each length: its block, and whether it crosses the parting plane of the mould
    "probe.inner_radius": ("inner", False), "probe.gap": ("outer", False), "probe.outer_radius": ("outer", False),
    "probe.height": ("inner", True), "probe.inner_height": ("inner", True), "probe.outer_height": ("outer", True),
}  # fmt: skip
MM = 1e3
LARGEST = 2.0  # standard deviation of a logarithm, at most
SHARE = f"a relative standard deviation from 0 to {LARGEST:g}, such as 0.02 or 2 %"
RATIO = "a standard deviation from 0 to 0.1, such as 0.003"


@dataclass(frozen=True)
class Toleranced:
    """A number of the probe that varies between built probes.

    Attributes:
        name: its key in the scene file; for the gain of a film one of ``GAIN_NAMES``.
        kind: length, modulus, Poisson's ratio or gain.
        value: as drawn, SI; 1 for a gain.
        sd: standard deviation of the built value, SI; for a modulus E that of ln E, times E.
        source: where the standard deviation comes from.
    """

    name: str
    kind: Kind
    value: float
    sd: float
    source: str

    def drawn(self, eta: Any) -> Any:
        """Return the value at standard normal ``eta``, eq. TO.1; real or complex, any shape."""
        if self.kind != "poisson_ratio":
            return self.value * np.exp(self.sd / self.value * eta)
        if self.sd == 0.0 or self.value == 0.0:
            return self.value + 0.0 * eta
        odds = math.log(2 * self.value / (1 - 2 * self.value))
        return 0.5 / (1 + np.exp(-odds - self.sd / (self.value * (1 - 2 * self.value)) * eta))


def toleranced(
    scene: Scene, bench: Bench | None = None, materials: Mapping[str, str] | None = None, given: Mapping[str, Any] | None = None
) -> tuple[Toleranced, ...]:
    """Return the uncertain numbers of a scene's probe, which is given by its outer radius.

    Lengths vary by the tolerance of the process of their block (``geometry.workshop.processes``), the gap by that of the hole's
    radius. A modulus from the catalogue varies as the catalogue states, any other as a measured one.

    Args:
        scene: see ``probe_design.built_probe.block_predictions.by_outer_radius``.
        bench: its ``[channels]`` give the gains, its ``[workshop]`` lengths and measured numbers; by default as above.
        materials: names in the catalogue of the materials of the blocks "inner" and "outer", for the scatter of their moduli.
        given: standard deviations by name, which replace the above: text with a unit, "5 %", or SI numbers; relative for
            moduli and gains.

    Raises:
        InputError: there is no such block, material or name, or a given value is no standard deviation.
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
    """Return, by block, the names of materials whose moduli come from the catalogue and are not measured."""
    blocks = {"inner": scene.probe.inner.unmeasured, "outer": scene.probe.outer.unmeasured}
    return {block: one.name for block, one in blocks.items() if one is not None}


def _of_process(scene: Scene, one: Toleranced) -> Toleranced:
    """Return a length with the tolerance of its block's process; radii are made as diameters."""
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
    """Return whether a number belongs to a block: films and base are bought, or hardly matter."""
    return name.startswith("probe.") and not name.startswith(("probe.film.", "probe.base.")) and name != "probe.area_ratio"


def _of_workshop(name: str, value: float, workshop: Workshop, origin: str) -> Toleranced:
    """Build an uncertain number with the standard deviation of the bench's ``[workshop]``."""
    if name.endswith("modulus"):
        return Toleranced(name, "modulus", value, workshop.modulus * value, f"{origin}, [workshop] modulus")
    if name.endswith("poisson_ratio"):
        return Toleranced(name, "poisson_ratio", value, workshop.poisson_ratio, f"{origin}, [workshop] poisson_ratio")
    return Toleranced(name, "length", value, workshop.length, f"{origin}, [workshop] length")


def _of_material(found: Mapping[str, Toleranced], block: str, what: str) -> dict[str, Toleranced]:
    """Return a block's modulus with the standard deviation of a material in the catalogue."""
    name = f"probe.{block}.youngs_modulus"
    if name not in found:
        raise InputError("material", f"{block}={what}", "inner=NAME or outer=NAME, of a block")
    one = find_material(what)
    if one.kind == "film" or not one.admits(found[name].value):
        near = f"a material of about {found[name].value:.4g} Pa, as the block; {one.name} has {one.youngs_modulus:.4g} Pa"
        raise InputError("material", f"{block}={what}", near)
    return {name: replace(found[name], sd=one.log_sd * found[name].value, source=f"{one.name}: {one.tolerance}")}


def _read(one: Toleranced, entry: Any) -> float:
    """Read a given standard deviation, SI."""
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
