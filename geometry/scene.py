"""A scene: one probe on one piece of tissue with its inclusions, contact, placement and load."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from geometry import placement
from geometry.errors import InputError, Words
from geometry.probe import Frozen, Interface, Length, Material, Position, Probe
from geometry.units import Quantity

Degrees = Annotated[float, Field(ge=-360.0, le=360.0, description="an angle in degrees, a number from -360 to 360")]
Tilt = Annotated[float, Quantity("angle", "rad", "deg", -1.5533430342749532, 1.5533430342749532)]
Force = Annotated[float, Quantity("force", "N", "N", 0.0, 1e9)]
Indentation = Annotated[float, Quantity("indentation", "m", "um", 0.0, 10.0)]


class CylinderTissue(Material):
    """A round piece of tissue, bonded to the table."""

    shape: Literal["cylinder"]
    radius: Length
    depth: Length


class BlockTissue(Material):
    """A rectangular piece of tissue, bonded to the table; length along x, breadth along y."""

    shape: Literal["block"]
    length: Length
    breadth: Length
    depth: Length


class HalfSpaceTissue(Material):
    """Tissue without an end."""

    shape: Literal["half-space"]


Tissue = Annotated[CylinderTissue | BlockTissue | HalfSpaceTissue, Field(discriminator="shape")]


class Inclusion(Material):
    """A body inside the tissue: a sphere, an ellipsoid or a closed surface from a file.

    Attributes:
        diameter: of a sphere.
        diameters: of an ellipsoid, along axes turned by ``orientation`` (rz, ry, rx in degrees about
            fixed axes).
        surface: file name of an STL or STEP surface, in place of a diameter.
        depth: from the tissue's surface to the centre.
        x, y: the centre beside the tissue's axis.
        target: whether ``log_sensitivity`` refers to this one.
    """

    diameter: Length | None = None
    diameters: Annotated[tuple[Length, Length, Length], Field(strict=False)] | None = None
    orientation: Annotated[tuple[Degrees, Degrees, Degrees], Field(strict=False)] = (0.0, 0.0, 0.0)
    surface: str | None = None
    depth: Length
    x: Position = 0.0
    y: Position = 0.0
    target: bool = False

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if sum(shape is not None for shape in (self.diameter, self.diameters, self.surface)) != 1:
            raise InputError("diameter", Words("not one shape"), "exactly one of diameter, diameters and surface")
        return self


class Contact(Frozen):
    """What holds between the blocks' ends and the tissue."""

    interface: Interface = "bonded"
    friction: Annotated[float, Field(ge=0.0, le=100.0, description="a number from 0 to 100")] = 0.0

    @model_validator(mode="after")
    def _friction_needs_sliding(self) -> Self:
        if self.friction > 0 and self.interface != "unilateral":
            raise InputError("friction", self.friction, "0 unless interface = 'unilateral'")
        return self


class Placement(Frozen):
    """Where the probe's axis meets the tissue; ``tilt`` about the y axis, + lowers the +x side."""

    x: Position = 0.0
    y: Position = 0.0
    tilt: Tilt = 0.0


class Load(Frozen):
    """How the base is pressed: by a force, or by an indentation."""

    force: Force | None = None
    indentation: Indentation | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.force is None) == (self.indentation is None):
            given = "missing" if self.force is None else "force and indentation"
            raise InputError("force", Words(given), "exactly one of force and indentation")
        return self


class Scene(Frozen):
    """Everything that an evaluator needs to know; frozen, in SI units, checked as a whole."""

    probe: Probe
    tissue: Tissue
    inclusion: Annotated[tuple[Inclusion, ...], Field(strict=False)] = ()
    contact: Contact = Contact()
    placement: Placement = Placement()
    load: Load

    @model_validator(mode="after")
    def _fits(self) -> Self:
        placement.check(self)
        return self

    @property
    def target(self) -> int | None:
        """Index of the inclusion that ``log_sensitivity`` refers to, if there is one."""
        marked = [index for index, body in enumerate(self.inclusion) if body.target]
        if marked:
            return marked[0]
        return 0 if len(self.inclusion) == 1 else None
