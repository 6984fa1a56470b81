"""Describe the PVDF films by numbers, with the bonds that hold each between its block and the base."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Self

from pydantic import Field, model_validator

from geometry.common.errors import InputError, ObsoleteKeyWarning, Words
from geometry.scenes.bonds import fill_in_bond
from geometry.scenes.quantities import (
    NUMBER_TEXT,
    POISSON_RATIO_TEXT,
    ChargePerForce,
    Frozen,
    LossFactor,
    MaterialName,
    Modulus,
    Number,
    PartLength,
    PoissonRatio,
    Thickness,
    build_optional_field,
)

MIN_GLUE_MODULUS = 1e8  # Pa: bonds between tape and glue, of which none are known, count as tape
ADHESIVE_KEYS = ("adhesive_thickness", "adhesive_modulus")  # of versions before 0.3: they are read as ``bond_to_base``
ADHESIVE_WARNING = (
    "[probe.film] adhesive_thickness and adhesive_modulus are read as [probe.film.bond_to_base] with a Poisson's ratio of 0.3; "
    "write that table instead, as the next version refuses these keys"
)
MAX_SOFT_RATIO = 30.0  # of the moduli of soft bonds: tapes differ by less, glue is 1000 times stiffer
ADHESIVE_POISSON_RATIO = 0.3  # that those versions computed the adhesive with


class Bond(Frozen):
    """A layer of glue or tape on one side of a film, by its numbers or by its name in the catalogue; rigid without thickness.

    Attributes
    ----------
    thickness
        Of the layer; 0 is a rigid bond, which has no modulus.
    youngs_modulus
        Of the layer, which is isotropic; a tape's is three times its shear modulus.
    poisson_ratio
        Of the layer.
    loss_factor
        Tan delta = E''/E' at the load's frequency.
    name
        In the catalogue of bonds; a number beside it is a measured one.
    """

    thickness: Thickness
    youngs_modulus: Modulus | None = build_optional_field()
    poisson_ratio: PoissonRatio | None = build_optional_field(POISSON_RATIO_TEXT)
    loss_factor: LossFactor = 0.0
    name: MaterialName | None = Field(
        default=None, description="a bond that `probe-design material list` shows", exclude_if=lambda name: name is None
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_catalogue(cls, table: object) -> object:
        """Return a table with the numbers of the bond that it names; a text is a name."""
        return fill_in_bond({"name": table} if isinstance(table, str) else table)

    @model_validator(mode="after")
    def _check_moduli(self) -> Self:
        """Raise ``InputError`` unless a layer with a thickness has both elastic constants."""
        for key in ("youngs_modulus", "poisson_ratio") if self.thickness > 0 else ():
            if getattr(self, key) is None:
                raise InputError(key, Words("missing"), "given for a bond with a thickness, or name = a bond of the catalogue")
        return self

    @property
    def is_rigid(self) -> bool:
        """Whether the bond has no thickness."""
        return self.thickness == 0

    @property
    def is_glue(self) -> bool:
        """Whether the bond is stiffer than any tape, but not rigid."""
        return not self.is_rigid and (self.youngs_modulus or 0.0) >= MIN_GLUE_MODULUS


RIGID_BOND = Bond(thickness=0.0)


class OuterFilm(Frozen):
    """What differs on the outer block's film; its keys are those of the film, and replace them there.

    Attributes
    ----------
    thickness, youngs_modulus, poisson_ratio, d31, d32, d33, electrode_inset, psi1, psi2, bond_to_base, bond_to_block
        As of the film.
    """

    thickness: PartLength | None = build_optional_field()
    youngs_modulus: Modulus | None = build_optional_field()
    poisson_ratio: PoissonRatio | None = build_optional_field(POISSON_RATIO_TEXT)
    d31: ChargePerForce | None = build_optional_field()
    d32: ChargePerForce | None = build_optional_field()
    d33: ChargePerForce | None = build_optional_field()
    electrode_inset: Thickness | None = build_optional_field()
    psi1: Number | None = build_optional_field(NUMBER_TEXT)
    psi2: Number | None = build_optional_field(NUMBER_TEXT)
    bond_to_base: Bond | None = build_optional_field()
    bond_to_block: Bond | None = build_optional_field()


class Film(Frozen):
    """A PVDF film and what holds it, on both blocks; ``outer`` changes that of the outer block.

    The defaults are the paper's: 110 um (section 2.1), Table 1 for ``d31``, ``d32``, ``d33``. Film and bonds fill the space
    between block and base, from the block upwards: ``bond_to_block``, film, ``bond_to_base``.

    Attributes
    ----------
    thickness
        Of the film.
    youngs_modulus
        Of the film, which is elastically isotropic.
    poisson_ratio
        Of the film.
    d31, d32, d33
        Charge per force along length, breadth and thickness.
    electrode_inset
        How far the electrodes end within each free edge of the film.
    psi1, psi2
        Lateral over vertical stress in the film: the paper's eq. (12) then stands in place of the film's stress.
    bond_to_base, bond_to_block
        The bond on either side; left out, it is rigid.
    outer
        What differs on the outer block.
    """

    thickness: PartLength = 110e-6
    youngs_modulus: Modulus = 2.5e9
    poisson_ratio: PoissonRatio = 0.34
    d31: ChargePerForce = 20e-12
    d32: ChargePerForce = 2e-12
    d33: ChargePerForce = -20e-12
    electrode_inset: Thickness = 0.0
    psi1: Number | None = build_optional_field(NUMBER_TEXT)
    psi2: Number | None = build_optional_field(NUMBER_TEXT)
    bond_to_base: Bond | None = build_optional_field()
    bond_to_block: Bond | None = build_optional_field()
    outer: OuterFilm | None = build_optional_field()

    @model_validator(mode="before")
    @classmethod
    def _read_adhesive_keys(cls, table: Any) -> Any:
        """Return a table in which the adhesive of older versions is the bond to the base; warn of these keys."""
        if not isinstance(table, Mapping) or not any(key in table for key in ADHESIVE_KEYS):
            return table
        if "bond_to_base" in table:
            given = next(key for key in ADHESIVE_KEYS if key in table)
            raise InputError(given, Words("beside bond_to_base"), "bond_to_base alone")
        film = {key: value for key, value in table.items() if key not in ADHESIVE_KEYS}
        thickness, modulus = (table.get(key) for key in ADHESIVE_KEYS)
        if thickness is None:
            raise InputError("adhesive_modulus", Words("without adhesive_thickness"), "both, or better bond_to_base")
        modulus = table.get("youngs_modulus", "2.5 GPa") if modulus is None else modulus  # the film's own
        bond = {"thickness": thickness, "youngs_modulus": modulus, "poisson_ratio": ADHESIVE_POISSON_RATIO}
        warnings.warn(ADHESIVE_WARNING, ObsoleteKeyWarning, stacklevel=2)
        return film | {"bond_to_base": bond}

    @model_validator(mode="after")
    def _check_psi(self) -> Self:
        """Raise ``InputError`` where one film alone would follow eq. (12)."""
        for key in ("psi1", "psi2"):
            if self.outer is not None and not self.uses_psi and getattr(self.outer, key) is not None:
                raise InputError(f"outer.{key}", getattr(self.outer, key), "a number beside psi1 or psi2 in [probe.film]")
        return self

    @property
    def by_block(self) -> tuple[Film, Film]:
        """The films of the inner and the outer block, each without ``outer``."""
        return _split_by_block(self)

    @property
    def soft_limit(self) -> float:
        """The largest modulus of a soft bond, Pa: tapes are soft where a film has tape and glue; 0 without bonds."""
        moduli = [bond.youngs_modulus for film in self.by_block for bond in film.bonds if bond.youngs_modulus is not None]
        return MAX_SOFT_RATIO * min(moduli, default=0.0)

    @property
    def has_bonds(self) -> bool:
        """Whether a bond is given on either side of either block's film."""
        given = (self.bond_to_base, self.bond_to_block)
        return any(bond is not None for bond in given) or (self.outer is not None and self.by_block[1].has_bonds)

    @property
    def uses_psi(self) -> bool:
        """Whether the charge follows from ``psi1`` and ``psi2`` in place of the film's stress."""
        return self.psi1 is not None or self.psi2 is not None

    @property
    def stack(self) -> tuple[Bond | Film, ...]:
        """The layers of this film from the block to the base; bonds without thickness are rigid."""
        to_block, to_base = self.bonds
        return to_block, self, to_base

    @property
    def bonds(self) -> tuple[Bond, Bond]:
        """The bonds of this film towards the block and towards the base."""
        return self.bond_to_block or RIGID_BOND, self.bond_to_base or RIGID_BOND

    @property
    def stack_height(self) -> float:
        """Height of film and bonds together, m."""
        return sum(layer.thickness for layer in self.stack)

    @property
    def slips(self) -> tuple[float, float]:
        """How far the film slips on block and base per shear traction, m/Pa: by the bond's t / G and a third of the film's."""
        share = self.thickness * 2 * (1 + self.poisson_ratio) / self.youngs_modulus / 3
        to_block, to_base = (
            bond.thickness * 2 * (1 + (bond.poisson_ratio or 0.0)) / (bond.youngs_modulus or math.inf) for bond in self.bonds
        )
        return to_block + share, to_base + share

    @property
    def shear_length(self) -> float:
        """Length over which the film takes up stress from the base, m: that of a membrane on springs, l of eq. CF.25."""
        return math.sqrt(self.youngs_modulus * self.thickness / (1 - self.poisson_ratio**2) * self.slips[1])

    @property
    def charge_per_force(self) -> float:
        """Charge per compressive force (C/N) of evenly pressed film: psi1 d31 + psi2 d32 + d33, the paper's eq. (12).

        Without ``psi1`` and ``psi2`` it is d33, that of a free film.
        """
        return (self.psi1 or 0.0) * self.d31 + (self.psi2 or 0.0) * self.d32 + self.d33

    @property
    def mean_lateral_charge(self) -> float:
        """(d31 + d32) / 2, C/N: the mean over all directions in the film's plane."""
        return (self.d31 + self.d32) / 2

    @property
    def lateral_charge_difference(self) -> float:
        """(d31 - d32) / 2, C/N: what the film's plane adds along its length and takes off across it."""
        return (self.d31 - self.d32) / 2


@lru_cache(maxsize=64)  # an evaluation asks a dozen times
def _split_by_block(film: Film) -> tuple[Film, Film]:
    """Return the films of the inner and the outer block, each without ``outer``."""
    inner = film.model_copy(update={"outer": None})
    changes = {} if film.outer is None else {key: getattr(film.outer, key) for key in film.outer.model_fields_set}
    return inner, inner.model_copy(update={key: value for key, value in changes.items() if value is not None})
