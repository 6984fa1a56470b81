"""Describe the tables of a scene, each checked by itself: tissue and layers, inclusions, contact, placement and load."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from itertools import accumulate
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import BaseModel, Discriminator, Field, Tag, model_validator

from geometry.common.errors import InputError, Words
from geometry.scenes.probe import Interface, Material, Probe
from geometry.scenes.quantities import Frozen, Length, Position, Thickness, build_quiet_field
from geometry.scenes.units import PERCENTAGE, Quantity

if TYPE_CHECKING:
    from geometry.common.arrays import Numeric

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Diameters = Annotated[tuple[Length, Length, Length], Field(strict=False)]
Orientation = Annotated[tuple[Degrees, Degrees, Degrees], Field(strict=False)]
FileName = Annotated[str, Field(min_length=1, max_length=1000, pattern=r"^[^\x00-\x1f]+$")]
Tilt = Annotated[float, Quantity("angle", "rad", "deg", -1.5533430342749532, 1.5533430342749532)]
LOAD_QUANTITIES = {"force": Quantity("force", "N", "N", 0.0, 1e9), "indentation": Quantity("indentation", "m", "mm", 0.0, 10.0)}
Force = Annotated[float, LOAD_QUANTITIES["force"]]
Indentation = Annotated[float, LOAD_QUANTITIES["indentation"]]


Observable = Literal["charge", "stress"]


class Layer(Material):
    """A layer of the tissue, bonded to what is above and below it.

    Attributes
    ----------
    thickness
        Below the layer above, or below the surface.
    """

    thickness: Length


MAX_LAYERS = 8
Layers = Annotated[tuple[Layer, ...], Field(strict=False, max_length=MAX_LAYERS)]
_LAYERS_FIELD = Field(
    default=(), description=f"up to {MAX_LAYERS} tables, each headed [[tissue.layer]], from the surface downwards"
)


class _Layered(Material):
    """Tissue of one material, below layers if there are any.

    Attributes
    ----------
    shape
        Of the tissue; it determines the other keys.
    youngs_modulus
        Of the tissue below its layers.
    poisson_ratio
        Likewise.
    loss_factor
        Likewise, tan delta.
    law, c2_over_c1, c3_over_c1, law_strain
        Likewise.
    layer
        From the surface downwards.
    """

    layer: Layers = _LAYERS_FIELD

    @property
    def interfaces(self) -> tuple[float, ...]:
        """Depths of the layers' lower faces, m, from the surface downwards."""
        return tuple(accumulate(layer.thickness for layer in self.layer))

    @property
    def bottom(self) -> float:
        """Depth of the tissue's bottom, m; infinite in a half-space."""
        return float(getattr(self, "depth", math.inf))

    def find_material(self, depth: float) -> Material:
        """Return the layer at a depth, m, or the tissue itself below its layers; an interface belongs to what is below it."""
        return (*self.layer, self)[bisect_right(self.interfaces, depth)]


class CylinderTissue(_Layered):
    """A round piece of tissue, bonded to the table.

    Attributes
    ----------
    radius
        Of the piece.
    depth
        From its top to the table.
    """

    shape: Literal["cylinder"]
    radius: Length
    depth: Length

    @property
    def side_radius(self) -> float:
        """Radius of the cylinder of equal cross-section, m."""
        return self.radius


class BlockTissue(_Layered):
    """A rectangular piece of tissue, bonded to the table.

    Attributes
    ----------
    length
        Along x.
    breadth
        Along y.
    depth
        From its top to the table.
    """

    shape: Literal["block"]
    length: Length
    breadth: Length
    depth: Length

    @property
    def side_radius(self) -> float:
        """Radius of the cylinder of equal cross-section, m."""
        return math.sqrt(self.length * self.breadth / math.pi)


class HalfSpaceTissue(_Layered):
    """Tissue without an end."""

    shape: Literal["half-space"]


def _read_shape(tissue: object) -> str | None:
    """Return the shape of a tissue, table or object, by which pydantic chooses its model; None if it is no text.

    Pydantic's own message for a wrong shape fails for very large integers, so that only text is passed on.
    """
    shape = tissue.get("shape") if isinstance(tissue, Mapping) else getattr(tissue, "shape", None)
    return shape if isinstance(shape, str) else None


Tissue = Annotated[
    Annotated[CylinderTissue, Tag("cylinder")]
    | Annotated[BlockTissue, Tag("block")]
    | Annotated[HalfSpaceTissue, Tag("half-space")],
    Discriminator(_read_shape),
]
TISSUE_MODELS: dict[str, type[BaseModel]] = {"cylinder": CylinderTissue, "block": BlockTissue, "half-space": HalfSpaceTissue}


class Inclusion(Material):
    """A body inside the tissue: a sphere, an ellipsoid or a closed surface from a file.

    Attributes
    ----------
    diameter
        Of a sphere.
    diameters
        Of an ellipsoid, along axes turned by ``orientation``.
    orientation
        Rz, ry, rx in degrees about fixed axes.
    surface
        File name of an STL or STEP surface, in place of a diameter.
    depth
        From the tissue's surface to the centre.
    x, y
        Lateral offset of the centre from the tissue's axis.
    target
        Whether ``log_sensitivity`` refers to this one.
    """

    diameter: Length | None = None
    diameters: Diameters | None = Field(default=None, description="three lengths with their units, ['8 mm', '6 mm', '5 mm']")
    orientation: Orientation = Field(default=(0.0, 0.0, 0.0), description="three numbers from -360 to 360, degrees")
    surface: FileName | None = Field(default=None, description="the name of an STL or STEP file")
    depth: Length
    x: Position = 0.0
    y: Position = 0.0
    target: bool = False

    @model_validator(mode="after")
    def _check_exactly_one_shape(self) -> Self:
        """Raise ``InputError`` unless one of the keys of a shape is given: diameter, diameters or surface."""
        if sum(shape is not None for shape in (self.diameter, self.diameters, self.surface)) != 1:
            raise InputError("diameter", self._describe_shapes(), "exactly one of diameter, diameters and surface")
        return self

    def _describe_shapes(self) -> Words:
        """Return, for the message, why the shape is refused: it is missing, or other keys of a shape stand beside the first."""
        given = [key for key in ("diameter", "diameters", "surface") if getattr(self, key) is not None]
        return Words("given beside " + " and ".join(given[1:]) if given else "missing")


class Contact(Frozen):
    """What holds between the blocks' ends and the tissue.

    Attributes
    ----------
    interface
        How they hold together.
    friction
        Coulomb's coefficient, where they may open.
    edge_radius
        Of the blocks' lower edges; a face ends as far from its walls.
    """

    interface: Interface = "bonded"
    friction: Annotated[float, Field(ge=0.0, le=100.0, description="a number from 0 to 100")] = 0.0
    edge_radius: Thickness = 0.0

    @model_validator(mode="after")
    def _check_friction(self) -> Self:
        """Raise ``InputError`` for friction at an interface that cannot open."""
        if self.friction > 0 and self.interface != "unilateral":
            raise InputError("friction", self.friction, "0 unless interface = 'unilateral'")
        return self


class Placement(Frozen):
    """Where the probe's axis meets the tissue.

    Attributes
    ----------
    x, y
        From the middle of the tissue's top.
    tilt
        About the y axis, + lowers the +x side.
    """

    x: Position = 0.0
    y: Position = 0.0
    tilt: Tilt = 0.0


class Load(Frozen):
    """How the base is pressed: by a force, or by an indentation.

    Static charges leak away, and a film measures changes. Without a preload, films answer to one press from zero to the peak,
    along the whole load path. With a preload they answer to the change of the force about it: their charges and stresses are the
    tangent response about the preload times (force - preload). Both are the same in linear elasticity alone.

    Attributes
    ----------
    force
        On the base: the peak.
    indentation
        Of the base, less than the tissue's depth.
    preload
        Static part of the force, below the peak: films answer to the change of the force about it; 0: to one press from zero.
    """

    force: Force | None = None
    indentation: Indentation | None = None
    preload: Force = build_quiet_field(0.0)

    @model_validator(mode="after")
    def _check_exactly_one(self) -> Self:
        if (self.force is None) == (self.indentation is None):
            given = "missing" if self.force is None else f"{self.force:g} N and indentation = {self.indentation:g} m"
            raise InputError("force", Words(given), "exactly one of force and indentation")
        if self.preload and not self.preload < (self.force or 0.0):
            peak = "given with load.force" if self.force is None else f"below load.force = {self.force:g} N, the peak"
            raise InputError("preload", Words(f"{self.preload:g} N"), f"0, or a static force {peak}")
        return self

    @property
    def amplitude(self) -> float | None:
        """Change of the force that films answer to, N: force - preload; None where an indentation is given."""
        return None if self.force is None else self.force - self.preload

    @property
    def response(self) -> str:
        """What the films' charges, stresses and their ratio are, in words."""
        if not self.preload:
            return "one press from zero to the peak"
        return f"the tangent response about a preload of {self.preload:g} N, times {self.amplitude:g} N"

    @property
    def departure(self) -> Load:
        """A press from zero that departs from linear elasticity as the readings do: for small strains, twice the preload.

        Where a film's force is a F (1 + b F) of the force F, it departs by b F, and its tangent by 2 b F.
        """
        return Load(force=2 * self.preload) if self.preload else self

    def find_indentation(self, stiffness: Numeric) -> Numeric:
        """Return the indentation whose linear response the readings are, m, for stiffnesses, N/m; floats or arrays."""
        return 0 * stiffness + self.indentation if self.amplitude is None else self.amplitude / stiffness


class Reading(Frozen):
    """What a reading of the probe is.

    Attributes
    ----------
    observable
        The ratio of the films' charges or of the stresses on them; left out, charges where the films have bonds, else stresses.
    accuracy
        Accuracy of results for which a command names none, relative; left out, 0.01.
    """

    observable: Observable | None = None
    accuracy: (
        Annotated[float, PERCENTAGE, Field(gt=0, lt=1, description="a number above 0 and below 1, such as 0.01 or 1 %")] | None
    ) = None


MAX_INCLUSIONS = 1000
Inclusions = Annotated[tuple[Inclusion, ...], Field(strict=False, max_length=MAX_INCLUSIONS)]


class SceneTables(Frozen):
    """The tables of a scene; whether their bodies fit together is checked by ``Scene`` alone."""

    probe: Probe
    tissue: Tissue
    inclusion: Inclusions = Field(default=(), description=f"up to {MAX_INCLUSIONS} tables, each headed [[inclusion]]")
    contact: Contact = Contact()
    placement: Placement = Placement()
    load: Load
    reading: Reading = Field(default=Reading(), exclude_if=lambda reading: reading == Reading())

    @model_validator(mode="after")
    def _check_reading(self) -> Self:
        """Raise ``InputError`` where charges are to be read without films."""
        if self.reading.observable == "charge" and self.probe.film is None:
            raise InputError("reading.observable", "charge", "'stress', or [probe.film] given")
        return self
