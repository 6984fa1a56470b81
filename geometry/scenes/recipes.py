"""Interpolate an elastomer's modulus by the fraction of thinner or the mixing ratio, within the measured range only."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from geometry.common.errors import InputError, Words
from geometry.common.percent import format_percent

_NAME_PATTERN = re.compile(
    r"(?P<name>.*?)(?:\s+with\s+(?:(?P<share>[\d.]+)\s*%\s*thinner|thinner\s+(?P<turned>[\d.]+)\s*%)|\s+(?P<ratio>[\d.]+)\s*:\s*1)?"
)


@dataclass(frozen=True)
class Thinned:
    """Measured moduli of a product with thinner.

    Attributes
    ----------
    thinner
        Shares added to parts A and B, as the database has them ("A + B + 12.5 % T"), rising.
    youngs_modulus
        Of each, Pa.
    scatter
        Standard deviation of each, Pa.
    """

    thinner: tuple[float, ...]
    youngs_modulus: tuple[float, ...]
    scatter: tuple[float, ...]

    def compute_softening(self, share: float) -> tuple[float, float]:
        """Return ln(E / E without thinner) at a fraction of thinner, and the standard deviation that the interpolation adds.

        ln E is interpolated between the measured fractions by a monotone cubic (scipy's PCHIP). The standard deviation combines
        the largest relative scatter of a sample and the cubic's difference from straight lines:

            sd = (sd_sample^2 + (ln E_cubic - ln E_line)^2)^(1/2).   (SC.4)

        Raises
        ------
        InputError
            The fraction is outside the range of those that were measured.
        """
        if not self.thinner[0] <= share <= self.thinner[-1]:
            low, high = (format_percent(end, 6) for end in (self.thinner[0], self.thinner[-1]))
            allowed = f"a share of thinner from {low} to {high}, as measured: nothing is extrapolated"
            raise InputError("thinner", Words(format_percent(share, 6)), allowed)
        if share == self.thinner[0]:
            return 0.0, 0.0
        import numpy as np
        from scipy.interpolate import PchipInterpolator

        logs = np.log(self.youngs_modulus)
        cubic = float(PchipInterpolator(self.thinner, logs)(share))
        line = float(np.interp(share, self.thinner, logs))
        sample = max(sd / value for sd, value in zip(self.scatter, self.youngs_modulus, strict=True))
        return cubic - float(logs[0]), math.hypot(sample, cubic - line)


@dataclass(frozen=True)
class MixingRatio:
    """A modulus by the ratio of base to agent: E = ``modulus`` / ratio, for ratios that were measured.

    Attributes
    ----------
    low, high
        The smallest and the largest measured ratio.
    usual
        The ratio used where none is given.
    modulus
        Pa.
    """

    low: float
    high: float
    usual: float
    modulus: float

    def compute_youngs_modulus(self, ratio: float) -> float:
        """Return E at a ratio, Pa.

        Raises
        ------
        InputError
            The ratio is outside the range of those that were measured.
        """
        if not self.low <= ratio <= self.high:
            allowed = f"parts of base to one of agent, from {self.low:g} to {self.high:g}, as measured: nothing is extrapolated"
            raise InputError("ratio", ratio, allowed)
        return self.modulus / ratio


def parse_name(text: str) -> tuple[str, float | None, float | None]:
    """Return name, fraction of thinner and mixing ratio of ``"ecoflex-00-10 with 30 % thinner"`` or ``"sylgard-184 20:1"``.

    Raises
    ------
    InputError
        The recipe has text in place of a number.
    """
    match = _NAME_PATTERN.fullmatch(text.strip())
    groups: dict[str, str] = match.groupdict() if match else {"name": text}
    share, ratio = groups.get("share") or groups.get("turned"), groups.get("ratio")
    try:
        return (
            normalise_name(groups["name"]),
            None if share is None else float(share) / 100,
            None if ratio is None else float(ratio),
        )
    except ValueError:
        raise InputError("material", text, "a name, 'NAME with 30 % thinner' or 'NAME 20:1'") from None


def normalise_name(name: str) -> str:
    """Return a name in the catalogue's spelling: dragon-skin-30 for "Dragon Skin 30"."""
    return re.sub(r"[\s_]+", "-", name.strip().lower())
