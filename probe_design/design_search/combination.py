"""Define a combination of discrete choices of a search: values, materials, films and bonds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.scan_choices import ScanChoice
from probe_design.design_search.variables import MODULUS_NAMES, format_variable


@dataclass(frozen=True)
class Combination:
    """One value for each discrete variable and one material for each block.

    Attributes
    ----------
    pinned
        Values of variables by their names, SI.
    poisson
        Poisson's ratios of the inner and the outer block.
    materials
        Names of both blocks' materials, empty if none were requested.
    film
        The films and bonds; None where the scene's stay.
    scan
        The places that are read; None where those of the design file stay.
    """

    pinned: Mapping[str, float]
    poisson: tuple[float, float]
    materials: tuple[str, ...] = ()
    film: FilmChoice | None = None
    scan: ScanChoice | None = None

    @property
    def description(self) -> str:
        """The chosen values and materials in words."""
        values = [
            f"{name} {format_variable(name, value)}"
            for name, value in self.pinned.items()
            if not (self.materials and name in MODULUS_NAMES)
        ]
        values += ["materials " + " / ".join(self.materials)] if self.materials else []
        return ", ".join([*values, *(item.description for item in (self.film, self.scan) if item)])
