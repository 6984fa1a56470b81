"""A scene's probe as files for the workshop: one call from Python, and what the verb `export` does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from geometry.cad.drawing import draw
from geometry.cad.export import Writer
from geometry.cad.export import export as write
from geometry.cad.record import check_same
from geometry.common.files import check_writable
from geometry.provenance.block import provenance
from geometry.provenance.texts import toml_comment
from geometry.scenes.base_sizes import assumed_sizes
from geometry.scenes.fit import doubts
from geometry.scenes.probe import Probe, mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.workshop.mould_sizes import mould_sizes
from geometry.workshop.package import USUAL, Casting, writers
from probe_design.workshop.budget import check_tolerance, ratio_budget
from probe_design.workshop.rounding import Rounding, costed, rounded

SCENE = "scene.toml"
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        scene: whose probe it is: the one that was given, or the rounded one.
        files: their paths, the STEP files of the parts first.
        rounding: what was rounded and what it costs; None where nothing was asked for.
        remarks: what a user has to know, one line each.
    """

    scene: Scene
    files: tuple[Path, ...]
    rounding: Rounding | None
    remarks: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design export``."""
        assumed = {key: str(mm(size)) for key, size in assumed_sizes(self.scene.probe).items()}
        found = {"files": [str(file) for file in self.files], "assumed": assumed, "remarks": list(self.remarks)}
        return found if self.rounding is None else {**found, "rounding": self.rounding.as_dict()}


def export(
    scene: Scene,
    folder: Path,
    *,
    step: float | None = None,
    force: bool = False,
    tolerance: float = 0.01,
    casting: Casting = USUAL,
    beside: Callable[[Scene], dict[str, Writer]] = lambda scene: {},
    tell: Tell = lambda text: None,
) -> Exported:
    """Write STEP files, drawings, film patterns, moulds, lists and the order of assembly of a scene's probe into a folder.

    All of them or none; see ``geometry.cad.export.export`` and ``geometry.workshop.package.writers``.

    Args:
        scene: whose probe.
        folder: for the files, made if needed.
        step: m, to which sizes are rounded; None: they stay. See ``probe_design.workshop.rounding.rounded``.
        force: whether parts of another design that are there are replaced.
        tolerance: standard deviation of ln ratio that the tolerances may make: 0.01 for 1 %.
        casting: how the blocks are cast.
        beside: what else is written, for the scene as it is built.
        tell: called with a line before each long piece of work.

    Raises:
        ExportError: a file does not hold what the scene says.
        InputError: the folder holds another design, or the scene, step or casting is none.
        MissingLibrary: CAD cannot be loaded.
        OSError: the folder cannot be written.
    """
    check_writable(folder)  # what would fail after the work fails before it
    check_tolerance(tolerance)
    mould_sizes(scene.probe, scene.contact.edge_radius, casting.shrinkage, casting.draft)
    rounding = None if step is None else rounded(scene, step)
    built = scene if rounding is None else rounding.scene
    edge = built.contact.edge_radius
    if not force:
        check_same(folder, built.probe, edge)
    tell("what the ratio leaves the dimensions")
    budget = ratio_budget(built, tolerance)
    if rounding is not None:
        tell("what the rounding costs")
        rounding = costed(rounding, scene)
    tell("solids, drawings, patterns and moulds")
    files: dict[str, Writer] = {"drawing.png": partial(draw, built.probe, edge_radius=edge), **beside(built)}
    text = toml_comment(provenance()) + scene_to_toml(built)
    files |= {**writers(built.probe, edge, budget, casting), SCENE: partial(_write, text)}
    paths = write(built.probe, folder, force, beside=files, edge_radius=edge)
    remarks = [*doubts(built), *missing_films(built.probe), budget.remark, "" if rounding is None else rounding.remark]
    return Exported(built, paths, rounding, tuple(text for text in remarks if text))


def missing_films(probe: Probe) -> tuple[str, ...]:
    """Return the warning that a probe is built without sensors, where it is."""
    if probe.film is not None:
        return ()
    return ("the probe has no sensors: the scene has no [probe.film], so the base lies on the blocks; add that table",)


def _write(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")
