"""Types of fields that several requests share: their ranges, and the help of those that mean the same everywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from geometry.common.resources import Limits, get_limits
from geometry.scenes.scene import Scene
from geometry.scenes.units import FREQUENCY_QUANTITY, MEMORY_QUANTITY, TIME_QUANTITY
from probe_design.commands.output import check_picture
from probe_design.commands.request import Number, Option, Request
from probe_design.data.noise import ALLOWED_NOISE, MAX_NOISE, MIN_NOISE

SceneSource = Annotated[
    Scene | Path | str,
    Field(description="a Scene, or the name of a scene file"),
    Option("Scene, or file of a scene.", is_argument=True),
]

Fraction = Annotated[
    float, Number("a number above 0 and below 1, such as 0.01 or 1 %", lambda fraction: 0 < fraction < 1, percent=True)
]
NO_ACCURACY = "the scene's reading.accuracy, or 0.01"
Accuracy = Annotated[Fraction | None, Option("Relative error that ratio, stresses and stiffness may have.", left_out=NO_ACCURACY)]
Noise = Annotated[
    float,
    Number(ALLOWED_NOISE, lambda noise: MIN_NOISE <= noise <= MAX_NOISE, percent=True),
    Option("Relative standard deviation of one reading of the ratio."),
]
MAX_OUTLIER_RATE = 0.3  # above it "wild" readings would be as good as the others
Outliers = Annotated[
    float,
    Number(f"a fraction from 0 to {MAX_OUTLIER_RATE:g}", lambda rate: 0 <= rate <= MAX_OUTLIER_RATE, percent=True),
    Option("Expected fraction of wild readings."),
]
Calibration = Annotated[Path | None, Option("Calibration file that calibrate has written.")]
Frequency = Annotated[float, FREQUENCY_QUANTITY]
Time = Annotated[float, TIME_QUANTITY]
Memory = Annotated[float, MEMORY_QUANTITY]

Linear = Annotated[
    bool, Option("Use linear elasticity at any load; error_estimate counts the known effect of finite strain.")
]  # for commands that otherwise refuse loads beyond linear elasticity
Loads = Annotated[bool, Option("Compute by contact the loads at which the gap closes and linear theory ends; takes seconds.")]
Force = Annotated[bool, Option("Replace parts of another design in the folder.")]
AnyProbe = Annotated[bool, Option("Take readings and calibrations of other serial numbers, too.")]
Picture = Annotated[  # refused before the computation rather than after it
    Path | None, AfterValidator(check_picture), Option("Draw the result to this .png, .svg or .pdf file.", "--plot")
]


class LimitedRequest(Request):
    """A request whose evaluations may take more or less memory and time."""

    memory: Annotated[Memory | None, Option("Memory that one evaluation may take.", left_out="2 GB")] = None
    time: Annotated[Time | None, Option("Time that one evaluation may take.", left_out="120 s")] = None

    @property
    def limits(self) -> Limits:
        """Limits of each evaluation."""
        return replace_limits(get_limits(), self.time, self.memory)


def replace_limits(limits: Limits, time: float | None, memory: float | None) -> Limits:
    """Return limits with time (s) and memory (bytes) replaced where they are given."""
    limits = limits if time is None else replace(limits, seconds=time)
    return limits if memory is None else replace(limits, memory=memory)
