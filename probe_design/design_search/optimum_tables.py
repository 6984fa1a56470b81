"""The result of an optimisation as a text and as labelled arrays: the numbers of probe and load of each verified design."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from geometry.common.errors import import_extra
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class OptimumTables(ABC):
    """What ``Optimum`` has for reading it: ``print``, pandas and xarray."""

    @property
    @abstractmethod
    def verdict(self) -> str:
        """The result in one sentence, with the reason why a gain counts or does not."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """Warnings to the user, one line each."""

    @abstractmethod
    def list_scenes(self) -> dict[str, Scene]:
        """List the scenes of the verified designs by their headings, the recommended one last."""

    def __str__(self) -> str:
        """Return the verdict, the numbers of the recommended probe, and the warnings."""
        *_, recommended = self.list_scenes().values()
        numbers = [f"{name}  {value:.5g}" for name, value in _list_numbers(recommended).items()]
        notes = [f"warning: {text}" for text in self.warnings]
        return "\n".join([type(self).__name__, self.verdict, *numbers, *notes])

    __repr__ = __str__

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame: designs as columns, numbers of probe and load as rows, SI units."""
        columns = {name: _list_numbers(scene) for name, scene in self.list_scenes().items()}
        frame: pd.DataFrame = import_extra("pandas").DataFrame(columns).rename_axis("number")
        return frame

    def to_dataset(self) -> xr.Dataset:
        """Return the numbers of ``to_frame`` for xarray, with the verdict in ``attrs``."""
        dataset: xr.Dataset = self.to_frame().to_xarray()
        return dataset.assign_attrs(verdict=self.verdict, warnings=list(self.warnings))


def _list_numbers(scene: Scene) -> dict[str, float]:
    """Return the numbers of probe and load by their keys, SI units."""
    return {name: value for name, value in list_values(scene).items() if name.startswith(("probe.", "load."))}
