"""Define the tables of a design file: frozen, in SI units, every key with its default and meaning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.quantities import LENGTH_QUANTITY, Frozen, Length
from geometry.scenes.scene_tables import MAX_LAYERS, Force, Indentation, Observable
from geometry.scenes.units import MODULUS_QUANTITY, PERCENTAGE, Quantity
from probe_design.data.noise import DEFAULT_CHARGE_NOISE_C, DEFAULT_NOISE, MAX_NOISE
from probe_design.populations.entries import NUMBER_QUANTITY, DesignVariable, Range, Ranged, Varied

POSITION_QUANTITY = Quantity("position", "m", "mm", -10.0, 10.0)
FORCE_QUANTITY = Quantity("force", "N", "mN", 1e-9, 1e9)
CHARGE_QUANTITY = Quantity("charge", "C", "pC", 0.0, 1e-3)
DEFAULT_SAMPLES, MAX_SAMPLES, MAX_POSITIONS, MAX_TUMOURS, MAX_LOADS = 64, 4096, 101, 3, 6
MAX_RASTER_LINES = 15

Lengths = Annotated[Range, Ranged(LENGTH_QUANTITY)]
Pressure = Annotated[float, Quantity("pressure", "Pa", "kPa", 1e-3, 1e9)]
Moduli = Annotated[Range, Ranged(MODULUS_QUANTITY)]
Places = Annotated[Range, Ranged(POSITION_QUANTITY, log=False)]
Charge = Annotated[float, CHARGE_QUANTITY]
Distance = Annotated[float, replace(LENGTH_QUANTITY, low=0.0)]
Weights = Annotated[tuple[Annotated[float, Field(ge=0.0, le=1e6)], ...], Field(strict=False, max_length=MAX_TUMOURS + 1)]
ChannelSet = Literal["ratio", "stiffness", "both"]
CHANNEL_INDICES: dict[ChannelSet, tuple[int, ...]] = {"ratio": (0,), "stiffness": (1,), "both": (0, 1)}  # of a scan's channels
Relative = Annotated[float, PERCENTAGE, Field(ge=0.0, le=MAX_NOISE, allow_inf_nan=False)]


def _describe_relative(what: str) -> str:
    """Return the description of a key with a relative noise of the given kind."""
    return f"{what}: a number from 0 to {MAX_NOISE:g} or a percentage, relative, one standard deviation"


class LayerRanges(Frozen):
    """What differs of one layer of the tissue, ``[[population.layer]]`` in the order of ``[[tissue.layer]]``."""

    thickness: Lengths | None = Field(default=None, description="left out: the scene's", examples=[["1 mm", "2 mm"]])
    modulus: Moduli | None = Field(default=None, description="left out: the scene's", examples=[["50 kPa", "200 kPa"]])


Layers = Annotated[tuple[LayerRanges, ...], Field(strict=False, max_length=MAX_LAYERS)]


class PopulationRanges(Frozen):
    """Which tumours there are, each in its own tissue; what is left out is that of the scene's one inclusion and tissue.

    Two values are the ends of a range over which the logarithm is spread evenly, of ``x`` the place itself; one, or three and
    more, are a list of equally likely ones.
    """

    depth: Lengths | None = Field(
        default=None, description="from the surface to the centre; left out: the scene's", examples=[["3 mm", "20 mm"]]
    )
    diameter: Lengths | None = Field(default=None, description="left out: the scene's", examples=[["5 mm", "15 mm"]])
    object: Moduli | None = Field(
        default=None, description="Young's modulus of the tumours; left out: the scene's", examples=[["20 kPa", "100 kPa"]]
    )
    tissue: Moduli | None = Field(
        default=None,
        description="Young's modulus of the tissue below its layers; left out: the scene's",
        examples=[["4 kPa", "9 kPa"]],
    )
    x: Places | None = Field(
        default=None,
        description="where the tumour lies along the line of readings, spread evenly; left out: the scene's, and for `locate` "
        "and `survey` from the first to the last reading",
        examples=[["-4 mm", "4 mm"]],
    )
    y: Places | None = Field(
        default=None,
        description="the same along y; left out: as x in a raster and where the readings of `locate` lie at several y, else the "
        "scene's",
        examples=[["-16 mm", "16 mm"]],
    )
    margin: Distance = Field(
        default=0.0, description="how far beyond the ranges of x and y tumours may lie, for `locate` and `survey` alone"
    )
    tumours: Annotated[int, Field(ge=1, le=MAX_TUMOURS)] = Field(
        default=MAX_TUMOURS,
        description=f"largest number of tumours in one patient, 1 to {MAX_TUMOURS}, for `locate` and `survey` alone; before the "
        "readings every number from none to this one is equally probable, unless weights says otherwise",
    )
    weights: Weights = Field(
        default=(),
        description="probability of no tumour, of one and so on before the readings, up to a common factor; left out: all equal",
        examples=[[0.9, 0.08, 0.015, 0.005]],
    )
    layer: Layers = Field(default=(), description="tables [[population.layer]] of thickness and modulus, as the scene has layers")
    least_cover: Length = Field(
        default=0.5e-3, description="least tissue above a tumour, which is a tenth of its diameter at any rate"
    )
    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES)] = Field(
        default=DEFAULT_SAMPLES, description=f"tumours drawn, a whole number from 1 to {MAX_SAMPLES}"
    )
    seed: Annotated[int, Field(ge=0, lt=2**31)] = Field(
        default=0, description="of the draw, a whole number from 0: other tumours of the same kind"
    )

    @model_validator(mode="after")
    def _check_weights(self) -> Self:
        """Refuse weights of other numbers of tumours, and weights that are all 0."""
        if self.weights and (len(self.weights) != self.tumours + 1 or not sum(self.weights) > 0):
            allowed = f"{self.tumours + 1} numbers, of none to {self.tumours} tumours, of which one is above 0"
            raise InputError("weights", list(self.weights), allowed)
        return self

    @property
    def number_prior(self) -> Floats:
        """Probability of each number of tumours before the readings, from none on, shape (tumours + 1,)."""
        weights = np.array(self.weights or (1.0,) * (self.tumours + 1))
        return np.asarray(weights / weights.sum())

    @property
    def is_varied(self) -> bool:
        """Whether the tumours of the population differ from each other."""
        given = [self.depth, self.diameter, self.object, self.tissue, self.x, self.y]
        given += [value_range for layer in self.layer for value_range in (layer.thickness, layer.modulus)]
        return any(value_range is not None and not value_range.is_single for value_range in given)


def _expand_positions(entry: object, units_required: bool) -> Any:
    """Expand an entry ``[from, to, number]`` to a list of positions as texts; return any other entry unchanged.

    A whole number as the third of three entries is the number of positions, as a position would be a text with its unit.
    """
    if not isinstance(entry, Sequence) or isinstance(entry, str) or len(entry) != 3:
        return entry
    low, high, number = entry
    if isinstance(number, bool) or not isinstance(number, int):
        return entry
    if not 1 <= number <= MAX_POSITIONS:
        raise InputError("", list(entry), f"[from, to, number] with a number from 1 to {MAX_POSITIONS}")
    first, last = (POSITION_QUANTITY.read("", number_or_text, units_required) for number_or_text in (low, high))
    return [POSITION_QUANTITY.format_value(float(number_or_text)) for number_or_text in np.linspace(first, last, number)]


class Protocol(Frozen):
    """How a patient is examined: readings along a line over the tissue through the probe's place, along x, or in a raster."""

    positions: Annotated[
        tuple[Annotated[float, POSITION_QUANTITY], ...], Field(strict=False, min_length=1, max_length=MAX_POSITIONS)
    ] = Field(
        default=tuple(np.linspace(-16e-3, 16e-3, 9).tolist()),
        description="of the probe's axis: [from, to, number], or a list of positions with their units",
        examples=[["-16 mm", "16 mm", 9]],
    )
    raster: bool = Field(
        default=False,
        description="whether the positions, at most 15 then, are those along x and along y of a square raster, as `survey` takes "
        "them: true or false",
    )
    loads: Annotated[tuple[Annotated[float, FORCE_QUANTITY], ...], Field(strict=False, max_length=MAX_LOADS)] = Field(
        default=(),
        description=f"a list of up to {MAX_LOADS} forces under each of which every place is read, or the largest that limits "
        "allow; left out: under that; `locate` predicts readings under these loads, the scene's, and between; `survey` chooses",
        examples=[["0.1 N", "0.3 N"]],
    )
    observable: Observable | None = Field(
        default=None,
        description="what a reading is: 'charge', the ratio of the films' charges, or 'stress', that of the stresses on them; "
        "left out: as the scene",
        examples=["charge"],
    )
    stiffness: bool = Field(
        default=False,
        description="whether force over indentation is read beside the ratio and the probe designed for both: true or false; "
        "every result states what the ratio alone, the stiffness alone and both detect",
    )
    blank: bool = Field(
        default=True,
        description="whether a tumour-free place of the tissue is read too, from which all readings are counted: true or false",
    )
    false_alarm: Annotated[float, PERCENTAGE, Field(ge=1e-4, le=0.5)] = Field(
        default=0.05,
        description="fraction of patients without a tumour in whom one is detected, over the whole scan: 0.0001 to 0.5",
    )

    @field_validator("positions", mode="before")
    @classmethod
    def _expand_positions(cls, entry: object, info: ValidationInfo) -> Any:
        """Expand ``[from, to, number]``, see the function of this name, before pydantic checks the positions."""
        return _expand_positions(entry, bool(info.context and info.context.get("units_required")))

    @model_validator(mode="after")
    def _check_raster(self) -> Self:
        """Refuse a raster of too many lines."""
        if self.raster and len(self.positions) > MAX_RASTER_LINES:
            raise InputError(
                "positions", Words(f"{len(self.positions)}"), f"at most {MAX_RASTER_LINES} along each side of a raster"
            )
        return self

    @property
    def places(self) -> Floats:
        """The positions along a line as an array, m, shape (k,)."""
        return np.array(self.positions)

    @property
    def count(self) -> int:
        """Number of places that are read."""
        return len(self.positions) ** 2 if self.raster else len(self.positions)

    def list_places(self, y: float) -> Floats:
        """Return x and y of the probe's axis at each place, m, shape (p, 2); a line lies at ``y``."""
        across = self.places if self.raster else np.array([y])
        return np.stack(np.meshgrid(self.places, across), axis=-1).reshape(-1, 2)

    @property
    def channel_set(self) -> ChannelSet:
        """The channels for which the probe is designed."""
        return "both" if self.stiffness else "ratio"

    @property
    def with_both_channels(self) -> Protocol:
        """The protocol with both channels read."""
        return self.model_copy(update={"stiffness": True})

    @property
    def channels(self) -> int:
        """Readings at each position: ln ratio, and ln stiffness where it is read."""
        return len(CHANNEL_INDICES[self.channel_set])


class NoiseModel(Frozen):
    """What keeps two readings of the same from being alike; see ``docs/guides/population.md``."""

    white: Relative = Field(default=0.01, description=_describe_relative("of each reading of the ratio by itself"))
    gain: Relative = Field(default=DEFAULT_NOISE, description=_describe_relative("of each channel's gain, common to a scan"))
    stiffness_white: Relative = Field(default=0.03, description=_describe_relative("of each reading of the stiffness"))
    stiffness_gain: Relative = Field(default=0.05, description=_describe_relative("of all stiffnesses of a scan together"))
    charge: Charge = Field(
        default=DEFAULT_CHARGE_NOISE_C,
        description="of each channel's charge, a charge with its unit, such as '0.01 pC', one standard deviation",
    )
    tilt: Relative = Field(default=0.0, description=_describe_relative("of each reading of the ratio by the probe's tilt at it"))
    pose: Distance = Field(
        default=0.0,
        description="of the probe's place at each reading along x and along y, a length, one standard deviation, for `locate` "
        "and `survey` alone; a reading's own x_sd and y_sd replace it",
    )
    calibration: str | None = Field(
        default=None,
        description="the name of a file that `probe-design calibrate` has written, whose gains take the place of gain",
        examples=["probe.toml"],
    )


class DesignLimits(Frozen):
    """What a design must keep to; what is left out follows from the start, the tissue and linear elasticity."""

    outer_radius: Length | None = Field(default=None, description="largest outer radius of the probe", examples=["8 mm"])
    height: Length | None = Field(default=None, description="largest height of the blocks", examples=["10 mm"])
    wall: Length | None = Field(default=None, description="least thickness of the outer block", examples=["0.5 mm"])
    force: Force | None = Field(default=None, description="largest force on the probe", examples=["0.5 N"])
    indentation: Indentation | None = Field(default=None, description="largest indentation", examples=["1000 um"])
    tissue_strain: Annotated[float, PERCENTAGE, Field(gt=0.0, le=1.0)] | None = Field(
        default=None, description="largest mean strain of the tissue under the probe: above 0, up to 1", examples=[0.1]
    )
    indentation_per_depth: Annotated[float, PERCENTAGE, Field(gt=0.0, le=1.0)] = Field(
        default=0.3, description="largest indentation over the tissue's depth, where contact models the load: above 0, up to 1"
    )
    pressure: Pressure | None = Field(default=None, description="largest mean pressure under the probe", examples=["10 kPa"])
    presses: Annotated[int, Field(ge=1, le=10_000)] | None = Field(
        default=None,
        description="largest number of presses of a scan, the baseline reading and every load counted: a whole number",
        examples=[26],
    )
    gap_closure: bool = Field(default=True, description="whether the gap has to stay open under the load: true or false")
    charge: Annotated[tuple[Charge, Charge], Field(strict=False)] | None = Field(
        default=None,
        description="least and largest charge of each channel that the amplifiers take",
        examples=[["1 pC", "1000 pC"]],
    )

    @model_validator(mode="after")
    def _refuse_zero_load(self) -> Self:
        """Refuse a limit of 0, under which the films give no charge."""
        for key, given in (("force", self.force), ("indentation", self.indentation)):
            if given == 0:
                raise InputError(key, 0, f"a {key} above 0: at 0 the films give no charge to read")
        return self

    @model_validator(mode="after")
    def _check_charge_order(self) -> Self:
        """Refuse limits of the charge that are not in order."""
        if self.charge is not None and not self.charge[0] < self.charge[1]:
            texts = [CHARGE_QUANTITY.format_value(limit) for limit in self.charge]
            raise InputError("charge", texts, "[least, largest], the least first")
        return self


VariedLength = Annotated[DesignVariable, Varied(LENGTH_QUANTITY)]
VariedModulus = Annotated[DesignVariable, Varied(MODULUS_QUANTITY)]
VariedForce = Annotated[DesignVariable, Varied(FORCE_QUANTITY)]
VariedNumber = Annotated[DesignVariable, Varied(NUMBER_QUANTITY)]
Materials = Annotated[tuple[str, ...], Field(strict=False, max_length=100)]


class DesignVariables(Frozen):
    """What the search may change of the probe and its load; what is left out varies within what a workshop can make."""

    inner_radius: VariedLength = Field(
        default=DesignVariable(), description="of the inner block", examples=[{"bounds": ["1 mm", "6 mm"], "step": "0.1 mm"}]
    )
    area_ratio: VariedNumber = Field(
        default=DesignVariable(), description="A2/A1, inner over outer end area", examples=[[0.1, 4.0]]
    )
    gap: VariedLength = Field(
        default=DesignVariable(), description="between the blocks", examples=[{"choices": ["0.1 mm", "0.2 mm", "0.3 mm"]}]
    )
    height: VariedLength = Field(default=DesignVariable(), description="of both blocks", examples=[["2 mm", "10 mm"]])
    inner_height: VariedLength = Field(
        default=DesignVariable(),
        description="of the inner block, in place of height: with it or outer_height each block has its own, and the base a step",
        examples=[["2 mm", "10 mm"]],
    )
    outer_height: VariedLength = Field(
        default=DesignVariable(), description="of the outer block, likewise", examples=[["2 mm", "10 mm"]]
    )
    inner_modulus: VariedModulus = Field(default=DesignVariable(), description="of the inner block", examples=["fixed"])
    outer_modulus: VariedModulus = Field(default=DesignVariable(), description="of the outer block", examples=["fixed"])
    force: VariedForce = Field(
        default=DesignVariable(),
        description="on the probe, in place of the scene's: each design has the largest that its limits allow",
        examples=[{"choices": ["0.1 N", "0.2 N", "0.3 N"]}],
    )
    presses: VariedNumber = Field(
        default=DesignVariable(),
        description="places of a scan, of which bounds without a step allow up to five numbers; in a raster squares",
        examples=[[9, 25]],
    )
    pitch: VariedLength = Field(
        default=DesignVariable(),
        description="between neighbouring places, about the middle of positions; left out: presses share their length; of bounds "
        "without a step five are tried",
        examples=[["4 mm", "8 mm"]],
    )
    materials: Materials = Field(
        default=(),
        description="names of `probe-design material list`: each block is of one of these, modulus and Poisson's ratio together",
        examples=[["dragon-skin-30", "ecoflex-00-30"]],
    )

    film: Materials = Field(
        default=(),
        description="names of `probe-design material list`: each film, on both blocks, is tried one by one",
        examples=[["pvdf-28um", "pvdf-52um", "pvdf-110um"]],
    )
    film_thickness: VariedLength = Field(
        default=DesignVariable(),
        description="of both films, in place of film; left out: the scene's; of bounds without a step five thicknesses are tried",
        examples=[{"choices": ["28 um", "52 um", "110 um"]}],
    )
    bond: Materials = Field(
        default=(),
        description="names of `probe-design material list`: each bond, on both sides of both films, is tried one by one",
        examples=[["tape-50um", "tape-25um", "epoxy-20um"]],
    )
    bond_to_base: Materials = Field(
        default=(), description="the same of the bond to the base alone, in place of bond", examples=[["tape-50um", "rigid"]]
    )
    bond_to_block: Materials = Field(
        default=(), description="the same of the bond to the block alone, in place of bond", examples=[["tape-50um", "rigid"]]
    )
    bond_thickness: VariedLength = Field(
        default=DesignVariable(),
        description="of the scene's bonds, in place of bond; left out: the scene's",
        examples=[["25 um", "130 um"]],
    )

    @property
    def given_heights(self) -> tuple[str, ...]:
        """Which of inner_height and outer_height are given."""
        return tuple(key for key in ("inner_height", "outer_height") if getattr(self, key) != DesignVariable())
