"""Write a scene's probe as files for the workshop: called from Python and by the command `export`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from geometry.cad.export import Writer
from geometry.cad.export import export_parts as write
from geometry.cad.parts_record import check_same_design
from geometry.common.files import check_writable
from geometry.common.json_types import JsonObject
from geometry.provenance.block import build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.base_sizes import assume_sizes
from geometry.scenes.fit_check import list_doubts
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.workshop.mould_sizes import compute_mould_sizes
from geometry.workshop.overview import draw_probe
from geometry.workshop.package import DEFAULT_CASTING, Casting, build_writers
from probe_design.workshop.ratio_budget import check_tolerance, compute_ratio_budget
from probe_design.workshop.rounding import Rounding, add_cost, round_sizes
from solver.results.evaluator import ProgressCallback, ignore_progress

SCENE_FILE = "scene.toml"


@dataclass(frozen=True)
class ExportSummary:
    """The exported files, with notes for the user.

    Attributes
    ----------
    scene
        The given scene, or the rounded one.
    files
        Paths of the files, the STEP files of the parts first.
    rounding
        The rounded sizes and their effect; None without ``step``.
    remarks
        Notes for the user, one line each.
    """

    scene: Scene
    files: tuple[Path, ...]
    rounding: Rounding | None
    remarks: tuple[str, ...]

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design export``."""
        assumed = {key: str(format_mm(size)) for key, size in assume_sizes(self.scene.probe).items()}
        entries = {"files": [str(file) for file in self.files], "assumed": assumed, "remarks": list(self.remarks)}
        return entries if self.rounding is None else {**entries, "rounding": self.rounding.as_dict()}


def export(
    scene: Scene,
    folder: Path,
    *,
    step: float | None = None,
    force: bool = False,
    tolerance: float = 0.01,
    casting: Casting = DEFAULT_CASTING,
    extra_writers: Callable[[Scene], dict[str, Writer]] = lambda scene: {},
    progress: ProgressCallback = ignore_progress,
) -> ExportSummary:
    """Write STEP files, drawings, film patterns, moulds, lists and assembly instructions of a scene's probe into a folder.

    All files are written or none; see ``geometry.cad.export.export_parts`` and ``geometry.workshop.package.build_writers``.

    Parameters
    ----------
    scene
        Scene of the probe.
    folder
        Folder for the files, created if needed.
    step
        Sizes are rounded to multiples of this length, m; None: not rounded. See ``probe_design.workshop.rounding.round_sizes``.
    force
        Whether to replace parts of another design in the folder.
    tolerance
        Standard deviation of ln ratio that the tolerances may cause: 0.01 for 1 %.
    casting
        How the blocks are cast.
    extra_writers
        Returns further files to write, for the scene as built.
    progress
        Called with a line before each long step.

    Raises
    ------
    ExportError
        A written file does not agree with the scene.
    InputError
        The folder contains another design, or the scene, step or casting is not valid.
    MissingLibrary
        CAD cannot be loaded.
    OSError
        The folder cannot be written.
    """
    check_writable(folder)  # fail before the work, not after it
    check_tolerance(tolerance)
    # raises before the work where no mould is possible
    compute_mould_sizes(scene.probe, scene.contact.edge_radius, casting.shrinkage, casting.draft)
    rounding = None if step is None else round_sizes(scene, step)
    built_scene = scene if rounding is None else rounding.scene
    edge = built_scene.contact.edge_radius
    if not force:
        check_same_design(folder, built_scene.probe, edge)
    progress("tolerances of the dimensions from the ratio")
    budget = compute_ratio_budget(built_scene, tolerance)
    if rounding is not None:
        progress("cost of the rounding")
        rounding = add_cost(rounding, scene)
    progress("solids, drawings, patterns and moulds")
    files: dict[str, Writer] = {
        "drawing.png": partial(draw_probe, built_scene.probe, edge_radius=edge),
        **extra_writers(built_scene),
    }
    text = format_toml_comment(build_provenance()) + scene_to_toml(built_scene)
    files |= {**build_writers(built_scene.probe, edge, budget, casting), SCENE_FILE: partial(_write_text, text)}
    paths = write(built_scene.probe, folder, force, other_files=files, edge_radius=edge)
    remarks = [
        *list_doubts(built_scene),
        *list_missing_films(built_scene.probe),
        budget.remark,
        "" if rounding is None else rounding.remark,
    ]
    return ExportSummary(built_scene, paths, rounding, tuple(text for text in remarks if text))


def list_missing_films(probe: Probe) -> tuple[str, ...]:
    """Return the warning that a probe is built without sensors; empty if it has films."""
    if probe.film is not None:
        return ()
    return ("the probe has no sensors: the scene has no [probe.film], so the base lies on the blocks; add that table",)


def _write_text(text: str, path: Path) -> None:
    """Write a text to a file; the path comes last, as in every ``Writer``."""
    path.write_text(text, encoding="utf-8")
