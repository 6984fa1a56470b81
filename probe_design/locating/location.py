"""Define the result of `locate`: how probable each number of tumours is, and what is known of each tumour."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, ClassVar

from geometry.common.arrays import Floats
from geometry.common.errors import import_extra
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.locating.next_position import NextPosition
from probe_design.locating.pose_errors import PoseError
from probe_design.locating.posterior import CommonSummary, Summary
from probe_design.locating.prior import TumourPrior
from probe_design.locating.scan_data import ScanData
from solver.results.record import Record

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True)
class Tumour:
    """Posterior of one tumour.

    Attributes
    ----------
    quantities
        Of x, y, depth, diameter, youngs_modulus and ln_contrast; SI units.
    place_region_90
        Area of the smallest region of x and y that holds the tumour's centre with a probability of 0.9, m^2.
    """

    quantities: dict[str, Summary]
    place_region_90: float

    def as_dict(self) -> JsonObject:
        """Return the quantities and the area as a JSON object."""
        return {name: asdict(summary) for name, summary in self.quantities.items()} | {"place_region_90": self.place_region_90}


@dataclass(frozen=True)
class NumberResult:
    """The posterior of one number of tumours, above 0.

    Attributes
    ----------
    number
        Number of tumours.
    tumours
        Each tumour's posterior, the most strongly read first.
    log_bayes_factor
        Ln of the evidence of this number over that of no tumour.
    log_bayes_factor_error
        Its standard deviation by the sampling.
    effective_sample_size
        Of the posterior sample.
    converged
        Whether this size suffices.
    sets
        Equally probable sets of tumours, shape (n, number, 5): x, y, depth, diameter, Young's modulus.
    log_tissue
        Ln of each layer's modulus over the middle of its range, the tissue's last, drawn for each set, shape (n, l).
    log_tissue_sd
        Their standard deviations before the readings, shape (l,); 0 where the modulus is known.
    """

    number: int
    tumours: tuple[Tumour, ...]
    log_bayes_factor: float
    log_bayes_factor_error: float
    effective_sample_size: float
    converged: bool
    sets: Floats
    log_tissue: Floats
    log_tissue_sd: Floats

    @property
    def place_region_90(self) -> float:
        """Area of the regions of all tumours' places, m^2."""
        return sum(tumour.place_region_90 for tumour in self.tumours)

    def as_dict(self) -> JsonObject:
        """Return the JSON object, without the sets and their tissues."""
        internal = ("sets", "log_tissue", "log_tissue_sd")
        values: JsonObject = {name: value for name, value in self.__dict__.items() if name not in internal}
        tumours = [tumour.as_dict() for tumour in self.tumours]
        return values | {"tumours": tumours, "place_region_90": self.place_region_90}


@dataclass(frozen=True)
class Residual:
    """One reading against the best prediction.

    Attributes
    ----------
    x, y
        Of the probe's axis, m.
    blank
        Whether it is a baseline reading.
    ratio, stiffness
        Ln reading less the prediction, the gain included, in standard deviations; None where it is not read.
    ratio_change, stiffness_change
        Ln reading less that of tumour-free tissue, the gain removed; None where it is not read.
    predicted_ratio_change, predicted_stiffness_change
        What the most probable tumours change.
    wild
        Probability that the reading is wild; None unless a rate of wild readings is stated.
    pose_error
        Where the probe stood less the stated place; None where the place is exact.
    """

    x: float
    y: float
    blank: bool
    ratio: float | None
    stiffness: float | None
    ratio_change: float | None
    stiffness_change: float | None
    predicted_ratio_change: float | None
    predicted_stiffness_change: float | None
    wild: float | None
    pose_error: PoseError | None = None


@dataclass(frozen=True, repr=False)
class Location(Record):
    """Result of `locate`, conditional on the population of the design file; SI units.

    Attributes
    ----------
    probability
        Of no tumour, one, two and so on, as far as they are stated; sums to 1.
    prior
        The same before the readings, of all numbers, shape (tumours + 1,).
    by_number
        Posterior of every number of tumours above 0 whose probability is stated.
    withheld
        Larger numbers, whose evidence repeats do not confirm: ``probability`` is conditional on fewer tumours.
    nuisances
        Posterior of ln gain of each channel that is read, and of the numbers of the tissue that the population leaves open.
    explained
        False where no tumours of the population, and not their absence either, explain the readings.
    p_value
        Probability of residuals as large as the smallest that the population reaches; ``explained`` is false below 0.001.
    residuals
        Each reading against the best prediction.
    next
        The best place of the next reading; None if not requested.
    warnings
        What the user has to know.
    evaluator
        Model of the readings.
    model_error
        Relative error of the predicted changes, which the posterior contains.
    seconds
        Time of the inference.
    seed
        Of the random numbers.
    tumour_prior, data, scene
        What the pictures need.
    """

    INTERNAL: ClassVar[tuple[str, ...]] = ("tumour_prior", "data", "scene", "by_number", "next", "nuisances")

    probability: tuple[float, ...]
    prior: tuple[float, ...]
    by_number: tuple[NumberResult, ...]
    withheld: tuple[int, ...]
    nuisances: dict[str, CommonSummary]
    explained: bool
    p_value: float
    residuals: tuple[Residual, ...]
    next: NextPosition | None
    warnings: tuple[str, ...]
    evaluator: str
    model_error: float
    seconds: float
    seed: int
    tumour_prior: TumourPrior
    data: ScanData
    scene: Scene

    @property
    def effective_sample_size(self) -> float:
        """Effective sample size of the most probable number above 0."""
        return self.best.effective_sample_size

    @property
    def number(self) -> int:
        """The most probable number of tumours above 0 whose sample has converged; one where none has."""
        converged = [part.number for part in self.by_number if part.converged] or [1]
        return max(converged, key=lambda number: self.probability[number])

    @property
    def best(self) -> NumberResult:
        """Posterior of the most probable number of tumours above 0."""
        return self.by_number[self.number - 1]

    @property
    def tumours(self) -> tuple[Tumour, ...]:
        """The tumours of the most probable number above 0."""
        return self.best.tumours

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame of the tumours of the most probable number above 0: median and intervals of each quantity, SI."""
        rows = {
            (index + 1, name): (part.median, *part.interval_50, *part.interval_90)
            for index, tumour in enumerate(self.tumours)
            for name, part in tumour.quantities.items()
        }
        pandas = import_extra("pandas")
        columns = ["median", "low_50", "high_50", "low_90", "high_90"]
        index = pandas.MultiIndex.from_tuples(list(rows), names=["tumour", "quantity"])
        frame: pd.DataFrame = pandas.DataFrame(list(rows.values()), index=index, columns=columns)
        return frame

    def to_dataset(self) -> xr.Dataset:
        """Return the numbers of ``to_frame`` by tumour and quantity for xarray."""
        dataset: xr.Dataset = self.to_frame().to_xarray()
        return dataset.assign_attrs(self.collect_numbers() | {"warnings": list(self.warnings)})

    def __str__(self) -> str:
        """Return the probability of each number, and median and 90 % interval of the tumours' quantities, SI units."""
        numbers = ", ".join(f"{number or 'none'}: {value:.2g}" for number, value in enumerate(self.probability))
        rows = [
            f"tumour {index + 1}: {name}  {part.median:.3g} ({part.interval_90[0]:.3g} to {part.interval_90[1]:.3g})"
            for index, tumour in enumerate(self.tumours)
            for name, part in tumour.quantities.items()
        ]
        notes = [f"warning: {text}" for text in self.warnings]
        return "\n".join(["Location", f"probability of a number of tumours: {numbers}", *rows, *notes])

    __repr__ = __str__

    def compute_probability_at_least(self, number: int) -> float:
        """Return the probability of this number of tumours or more."""
        return sum(self.probability[number:])

    def as_dict(self) -> JsonObject:
        """Return the JSON object of the command."""
        best = self.best.as_dict()
        log_factors = [0.0, *(part.log_bayes_factor for part in self.by_number)]
        return super().as_dict() | {
            "probability": [*self.probability, *(None for _ in self.withheld)],
            "tumours": best["tumours"],
            "place_region_90": best["place_region_90"],
            "effective_sample_size": self.effective_sample_size,
            "by_number": [part.as_dict() for part in self.by_number],
            "log_bayes_factors": log_factors,
            "bayes_factors": [min(float(pow(2.718281828459045, min(value, 700.0))), 1e300) for value in log_factors],
            "nuisances": {name: asdict(summary) for name, summary in self.nuisances.items()},
            "population": self.tumour_prior.describe(),
            "next": None if self.next is None else asdict(self.next),
        }
