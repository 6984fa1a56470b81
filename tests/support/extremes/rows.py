"""The rows of the matrix of extremes: scenes with true values that no solver of this project has found."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace

from geometry import Load, Scene, read_scene
from tests.support.paths import REFERENCE

FOLDERS = {
    "extremes": "numbers at their limits, alone and together",
    "extreme": "more limits of the range of designs",
    "extra": "corners of the range of designs",
    "half-space": "tissue without an end",
    "off-axis": "tumours off the axis, pairs, ellipsoids",
    "tissue-layers": "skin, fat, bone, films: tissue of layers",
    "tissue-layers-off-axis": "tumours off the axis in tissue of layers",
}
LIGHT, SMALL = 1e-3, 1e-3  # of loads; m, probes narrower than which are pressed more lightly by the square
STRESSES = ("stress_inner", "stress_outer")
SENSITIVITY_FLOOR = 1e-4  # below it the references' uncertainty of the log-sensitivity is relative to this


@dataclass(frozen=True)
class Truth:
    """True values of a scene; ``None``: not known.

    Attributes
    ----------
    uncertainty
        Of ratio, stresses and stiffness, relative.
    doubt
        Of the log-sensitivity, absolute.
    """

    ratio: float | None
    stress_inner: float | None = None
    stress_outer: float | None = None
    stiffness: float | None = None
    log_sensitivity: float | None = None
    uncertainty: float = 0.0
    doubt: float = 0.0


@dataclass(frozen=True)
class Row:
    """A scene of the matrix.

    Attributes
    ----------
    group
        Heading of its table.
    origin
        Where the true values come from.
    """

    group: str
    name: str
    scene: Scene
    truth: Truth
    origin: str

    @property
    def key(self) -> str:
        """Group and name."""
        return f"{self.group}/{self.name}"


def lightened(row: Row) -> Row:
    """Return a row of linear elasticity under a thousandth of its load or less, where ``auto`` is linear."""
    load, truth = row.scene.load, row.truth
    share = LIGHT * min(1.0, row.scene.probe.tube_radius / SMALL) ** 2
    light = {key: value and share * value for key, value in (("force", load.force), ("indentation", load.indentation))}
    stresses = {key: value and share * value for key in STRESSES if (value := getattr(truth, key)) is not None}
    return replace(row, scene=row.scene.model_copy(update={"load": Load(**light)}), truth=replace(truth, **stresses))


def truths(folder: str) -> dict[str, Truth]:
    """Return the stored values of a folder of ``tests/reference``."""
    expected = json.loads((REFERENCE / folder / "expected.json").read_text(encoding="utf-8"))
    return {name: _truth(values) for name, values in expected.items()}


def _truth(values: dict[str, float]) -> Truth:
    uncertainty, log_sensitivity = values["relative_uncertainty"], values.get("log_sensitivity")
    doubt = values.get("log_sensitivity_uncertainty", uncertainty * max(abs(log_sensitivity or 0.0), SENSITIVITY_FLOOR))
    inner, outer = values["stress_inner_pa"], values["stress_outer_pa"]
    return Truth(values["ratio"], inner, outer, values["stiffness_n_per_m"], log_sensitivity, uncertainty, doubt)


def referenced() -> Iterator[Row]:
    """Yield the scenes of ``tests/reference`` whose results NGSolve has computed."""
    for folder in FOLDERS:
        known = truths(folder)
        for path in sorted((REFERENCE / folder).glob("*.toml")):
            yield Row(folder, path.stem, read_scene(path), known.get(path.stem, Truth(None)), "NGSolve")


def rows() -> list[Row]:
    """Return every scene of the matrix."""
    from tests.support.extremes.laws import lawful
    from tests.support.extremes.loads import loaded

    return [*referenced(), *lawful(), *loaded()]
