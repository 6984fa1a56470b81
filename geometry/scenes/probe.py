"""Describe the probe by numbers: two concentric elastic blocks, their films and their base."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_maximum_mm, format_minimum_mm, is_at_least
from geometry.scenes.catalogue import CatalogueMaterial, fill_in, find_material
from geometry.scenes.film import Film
from geometry.scenes.quantities import (
    Frozen,
    LossFactor,
    MaterialName,
    Modulus,
    PartLength,
    PoissonRatio,
    build_optional_field,
    build_quiet_field,
)

Law = Literal["neo-hookean", "yeoh"]
LawConstant = Annotated[float, Field(ge=-1e4, le=1e4, description="a number from -10000 to 10000")]
LawStrain = Annotated[float, Field(ge=1e-3, le=100.0)]
LAW_CONSTANTS = ("c2_over_c1", "c3_over_c1")
CATALOGUE_NAME_FIELD = Field(
    default=None, description="a name that `probe-design material list` shows", exclude_if=lambda name: name is None
)
AreaRatio = Annotated[float, Field(ge=1e-4, le=1e4)]
Interface = Literal["bonded", "frictionless", "unilateral"]


class Material(Frozen):
    """An isotropic elastic material, by its numbers or by its name in the catalogue.

    Attributes
    ----------
    youngs_modulus
        Of the material; the storage modulus E' where it is lossy; left out: the named material's.
    poisson_ratio
        Likewise.
    loss_factor
        Tan delta = E''/E' at the load's frequency: E = E' (1 + j tan delta), Poisson's ratio being real.
    material
        A name of the catalogue; a number beside it is a measured one, see ``geometry.scenes.catalogue.fill_in``.
    law
        At finite strain, which evaluator contact alone models; its small strains have the modulus and Poisson's ratio above.
    c2_over_c1, c3_over_c1
        Yeoh's constants C2 and C3 over C1, half the shear modulus.
    law_strain
        Uniaxial tensile strain with the largest I - 3 of the curve that the law was fitted to; a strain beyond it warns.
    """

    youngs_modulus: Modulus
    poisson_ratio: PoissonRatio
    loss_factor: LossFactor = 0.0
    material: MaterialName | None = CATALOGUE_NAME_FIELD
    law: Law = build_quiet_field("neo-hookean")
    c2_over_c1: LawConstant = build_quiet_field(0.0)
    c3_over_c1: LawConstant = build_quiet_field(0.0)
    law_strain: LawStrain | None = build_optional_field("a strain from 0.001 to 100")

    @model_validator(mode="before")
    @classmethod
    def _fill_from_catalogue(cls, table: object) -> object:
        """Return a table with the numbers of the material that it names, before pydantic reads it."""
        return fill_in(table)

    @model_validator(mode="after")
    def _check_law(self) -> Self:
        """Raise ``InputError`` for Yeoh's constants beside another law."""
        for key in LAW_CONSTANTS if self.law == "neo-hookean" else ():
            if getattr(self, key):
                raise InputError(key, getattr(self, key), "0, or any number beside law = 'yeoh'")
        return self

    @property
    def catalogue_entry(self) -> CatalogueMaterial | None:
        """The catalogue's entry that the material is named after, None where it has numbers alone."""
        return None if self.material is None else find_material(self.material)

    @property
    def unmeasured_entry(self) -> CatalogueMaterial | None:
        """The catalogue's entry where the modulus is the catalogue's too, None where it was measured or there is no name."""
        entry = self.catalogue_entry
        return entry if entry is not None and entry.is_tabulated(self.youngs_modulus) else None


class Base(Frozen):
    """The base that both blocks hang under: a step as wide as the probe below a wider flange.

    Rigid, or elastic with a modulus and a Poisson ratio. The dimensions serve the CAD model, and the
    solver where the base is elastic; see ``geometry.scenes.base_sizes`` for what holds where they are left out.

    Attributes
    ----------
    rigid
        Whether the base does not give way.
    youngs_modulus
        Of an elastic base.
    poisson_ratio
        Of an elastic base.
    material
        A name of the catalogue; it gives an elastic base its numbers, and of a rigid one says what it is made of.
    flange_radius
        At least the probe's outer radius.
    thickness
        Of the flange.
    step_height
        From the higher of the base's lower faces, on the films and their bonds, to the flange's lower face.
    """

    rigid: bool = False
    youngs_modulus: Modulus | None = None
    poisson_ratio: PoissonRatio | None = None
    material: MaterialName | None = CATALOGUE_NAME_FIELD
    flange_radius: PartLength | None = None
    thickness: PartLength | None = None
    step_height: PartLength | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_from_catalogue(cls, table: object) -> object:
        """Return a table with the numbers of the material that it names; without them for a rigid base, which has none."""
        return fill_in(table, numbers=not (isinstance(table, Mapping) and table.get("rigid")))

    @model_validator(mode="after")
    def _check_rigid_or_elastic(self) -> Self:
        """Raise ``InputError`` unless the base is either rigid or has both elastic constants."""
        moduli = (self.youngs_modulus is not None, self.poisson_ratio is not None)
        if self.rigid and any(moduli):
            raise InputError("rigid", Words("true beside moduli"), "either rigid = true, or youngs_modulus and poisson_ratio")
        if not self.rigid and not all(moduli):
            raise InputError("rigid", Words("neither true nor elastic"), "rigid = true, or both youngs_modulus and poisson_ratio")
        return self


class Groove(Frozen):
    """The channel for the inner film's lead: cut radially through the +x side of the outer block's film end.

    Attributes
    ----------
    width
        Less than the hole's diameter.
    depth
        From the film end, less than the outer block's height.
    """

    width: PartLength
    depth: PartLength


class Probe(Frozen):
    """The concentric probe; lengths in metres, moduli in pascals.

    ``inner`` is the paper's block 2 (solid), ``outer`` its block 1 (tube). Exactly one of
    ``area_ratio`` (A2/A1) and ``outer_radius`` is given, and either ``height`` or both block heights.

    Attributes
    ----------
    inner_radius
        Of the inner block.
    area_ratio
        End area of the inner over that of the outer block; or ``outer_radius``.
    outer_radius
        Of the outer block; or ``area_ratio``.
    gap
        Between the blocks, so that the hole's radius is inner_radius + gap.
    height
        Of both blocks; or one for each.
    inner_height
        Of the inner block.
    outer_height
        Of the outer block.
    """

    inner_radius: PartLength
    area_ratio: AreaRatio | None = Field(default=None, description="a number from 1e-4 to 1e4")
    outer_radius: PartLength | None = None
    gap: PartLength
    height: PartLength | None = None
    inner_height: PartLength | None = None
    outer_height: PartLength | None = None
    inner: Material
    outer: Material
    base: Base = Base(rigid=True)
    groove: Groove | None = None
    film: Film | None = None

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        """Raise ``InputError`` unless the keys determine the probe, and its tube and groove are possible."""
        if (self.area_ratio is None) == (self.outer_radius is None):
            raise InputError(*_describe_given(self, "area_ratio", "outer_radius"), "exactly one of area_ratio and outer_radius")
        heights = ("height", "inner_height", "outer_height")
        if [getattr(self, key) is not None for key in heights] not in ([True, False, False], [False, True, True]):
            raise InputError(*_describe_given(self, *heights), "either height, or both inner_height and outer_height")
        self._check_wall()
        self._check_groove()
        return self

    def _check_wall(self) -> None:
        """Raise ``InputError`` if the tube has no wall."""
        if self.tube_radius - self.hole_radius >= 1e-9 * self.tube_radius:
            return
        allowed = (
            f"an outer radius, now {format_mm(self.tube_radius)}, above inner_radius + gap = "
            f"{format_minimum_mm(self.hole_radius)}"
        )
        raise InputError(*_describe_given(self, "outer_radius", "area_ratio"), allowed)

    def _check_groove(self) -> None:
        """Raise ``InputError`` if the groove is as wide as the hole or as deep as the outer block is high."""
        if self.groove is None:
            return
        for key, limit, limit_name in (("width", 2 * self.hole_radius, "hole diameter"), ("depth", self.tube_height, "height")):
            size = getattr(self.groove, key)
            if is_at_least(size, limit):
                raise InputError(
                    f"groove.{key}", format_mm(size), f"below the outer block's {limit_name} of {format_maximum_mm(limit)}"
                )

    @property
    def hole_radius(self) -> float:
        """Inner radius of the tube."""
        return self.inner_radius + self.gap

    @property
    def tube_radius(self) -> float:
        """Outer radius of the tube, from ``outer_radius`` or A2/A1 = r2^2 / (Ro^2 - Ri^2)."""
        if self.outer_radius is not None:
            return self.outer_radius
        assert self.area_ratio is not None  # held by the validator
        return math.sqrt(self.hole_radius**2 + self.inner_radius**2 / self.area_ratio)

    @property
    def core_height(self) -> float:
        """Height of the inner block."""
        return self.height if self.inner_height is None else self.inner_height  # type: ignore[return-value]

    @property
    def tube_height(self) -> float:
        """Height of the outer block."""
        return self.height if self.outer_height is None else self.outer_height  # type: ignore[return-value]

    @property
    def inner_area(self) -> float:
        """Nominal end area A_2 of the inner block."""
        return math.pi * self.inner_radius**2

    @property
    def outer_area(self) -> float:
        """Nominal end area A_1 of the outer block, groove not subtracted."""
        return math.pi * (self.tube_radius - self.hole_radius) * (self.tube_radius + self.hole_radius)

    @property
    def groove_footprint(self) -> float:
        """Area in m^2 that the groove takes from the outer block's film end, eq. SC.1; zero without a groove."""
        if self.groove is None:
            return 0.0
        return compute_groove_footprint(self.hole_radius, self.tube_radius, self.groove.width / 2)


def format_mm(length: float) -> Words:
    """Write a length for a message: ``5 mm``."""
    return Words(f"{length * 1e3:.6g} mm")


def _describe_given(probe: Probe, *keys: str) -> tuple[str, Words]:
    """Return the first key that has a value and, as text, its value and the others' values; else the first key."""
    first, *other_keys = [key for key in keys if getattr(probe, key) is not None] or keys[:1]
    return first, Words(
        " and ".join([_describe_value(probe, first), *(f"{key} = {_describe_value(probe, key)}" for key in other_keys)])
    )


def _describe_value(probe: Probe, key: str) -> str:
    """Return the value of a key of the probe as text: "missing", a number, or a length in mm."""
    value = getattr(probe, key)
    return "missing" if value is None else f"{value:g}" if key == "area_ratio" else format_mm(value)


def compute_groove_footprint(inner: float, outer: float, a: float) -> float:
    """Return the area of the part |y| < a, x > 0 of the ring between two radii, all of one unit of length.

    The integral over |y| < a of sqrt(Ro^2 - y^2) - sqrt(Ri^2 - y^2), with a half the groove's width, Ri the hole's and Ro the
    tube's radius (SC.1). Half a chord strip of a disc is S(R) = a sqrt(R^2 - a^2) + R^2 asin(a/R); the footprint is
    S(Ro) - S(Ri).
    """
    x_inner, x_outer = (math.sqrt((radius - a) * (radius + a)) for radius in (inner, outer))
    # a (x_o - x_i) written without the difference of two nearly equal roots, for thin walls
    flat = a * (outer - inner) * (outer + inner) / (x_outer + x_inner)
    return flat + outer**2 * math.asin(a / outer) - inner**2 * math.asin(a / inner)
