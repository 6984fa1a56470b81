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

from geometry.common.errors import InputError, one_of
from geometry.scenes.catalogue import find_material
from geometry.scenes.probe import LENGTH
from geometry.scenes.scene import Scene
from geometry.scenes.units import fraction
from geometry.scenes.variables import values
from probe_design.built_probe.bench import Bench, Channels, Workshop

Kind = Literal["length", "modulus", "poisson_ratio", "gain"]
GAINS = ("film.inner.gain", "film.outer.gain")
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

    Args:
        scene: see ``probe_design.built_probe.block_predictions.by_outer_radius``.
        bench: whose ``[workshop]`` and ``[channels]`` hold; left out: their defaults.
        materials: of the blocks "inner" and "outer", by names of the catalogue: how well their moduli are known.
        given: standard deviations by names, in place of these: text with its unit, "5 %", or SI numbers, relative ones of moduli
            and gains.

    Raises:
        InputError: no such block, material or name, or what is given is no standard deviation.
    """
    workshop, channels = (Workshop(), Channels()) if bench is None else (bench.workshop, bench.channels)
    found = {name: _of_workshop(name, value, workshop) for name, value in values(scene).items() if _of_blocks(name)}
    found |= {name: Toleranced(name, "gain", 1.0, channels.gain, "bench, [channels] gain") for name in GAINS}
    for block, what in (materials or {}).items():
        found |= _of_material(found, block, what)
    for name, entry in (given or {}).items():
        if name not in found:
            raise InputError("tolerance", name, one_of(name, found))
        found[name] = replace(found[name], sd=_read(found[name], entry), source="given")
    return tuple(found.values())


def _of_blocks(name: str) -> bool:
    """Whether a number of the scene is a block's: films and base are bought or hardly matter."""
    return name.startswith("probe.") and not name.startswith(("probe.film.", "probe.base.")) and name != "probe.area_ratio"


def _of_workshop(name: str, value: float, workshop: Workshop) -> Toleranced:
    if name.endswith("modulus"):
        return Toleranced(name, "modulus", value, workshop.modulus * value, "bench, [workshop] modulus")
    if name.endswith("poisson_ratio"):
        return Toleranced(name, "poisson_ratio", value, workshop.poisson_ratio, "bench, [workshop] poisson_ratio")
    return Toleranced(name, "length", value, workshop.length, "bench, [workshop] length")


def _of_material(found: Mapping[str, Toleranced], block: str, what: str) -> dict[str, Toleranced]:
    name = f"probe.{block}.youngs_modulus"
    if name not in found:
        raise InputError("material", f"{block}={what}", "inner=NAME or outer=NAME, of a block")
    one = find_material(what)
    off = abs(math.log(found[name].value / one.youngs_modulus))
    if one.kind != "elastomer" or off > 2 * one.log_sd:
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
