"""Write the files of an optimisation of either kind: design, STEP files, drawing, pictures, table and report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from geometry.cad.export import export_parts
from geometry.cad.parts_record import RECORD_NAME, list_part_files
from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.workshop.overview import draw_probe
from probe_design.design_search.optimum import Optimum
from probe_design.design_search.variables import M_PER_MM, VARIABLES, Limit
from probe_design.reporting.page import Chapter, Items, Part, Picture, Text, build_page
from probe_design.reporting.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.reporting.table import Table
from probe_design.reporting.workshop_command import NEXT_PARTS, WORKSHOP_PARTS
from solver.automatic import state_accuracy

C_PER_PC, N_PER_MN = 1e-12, 1e-3  # SI values of the units in tables
WRITING_STAGE = "writing STEP files, pictures and report"
DRAWING_FILE, DRAWING_CAPTION = "drawing.png", "section and view of the probe"
LIMIT_UNITS = {  # SI value of the unit and its name, by what a limit limits; all others are lengths
    **{name: variable.table_unit for name, variable in VARIABLES.items()},
    **dict.fromkeys(("scene", "linearity", "gap_closure"), (N_PER_MN, " mN")),
    "tissue_strain": (1.0, ""), "charge": (C_PER_PC, " pC"),
}  # fmt: skip
Progress = Callable[[str, int, int], None]
Writer = Callable[[Path], object]


@dataclass(frozen=True)
class Report:
    """The report of an optimisation.

    Attributes
    ----------
    optimum
        The result of the optimisation.
    table
        Comparison of start and optimum.
    advice
        The verdict in plain words, one or two sentences on each question.
    assumptions
        What the numbers assume.
    notes
        Explain the numbers of the comparison.
    provenance
        Provenance of the results.
    cautions
        Cautions for the reader.
    shown_scene
        The scene whose maps and stresses are shown.
    map_noise
        Noise of its maps; None leaves maps and stresses out.
    pictures
        Pictures other than the drawing by file name: a caption, and a function that draws each.
    texts
        Further text files.
    chapters
        Chapters between comparison and limits by their titles; a text stands for the picture of that file name.
    limit_notes
        Explain the limits, below their table.
    last_chapters
        Chapters at the end.
    additions
        Further keys of the JSON object.
    messages
        Lines for the terminal, below the table.
    """

    optimum: Optimum[Any]
    table: Table
    advice: Sequence[str]
    assumptions: Sequence[str]
    notes: Sequence[str]
    provenance: Provenance
    cautions: Sequence[str]
    shown_scene: Scene
    map_noise: float | None = None
    pictures: Mapping[str, tuple[str, Writer]] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    chapters: Mapping[str, Sequence[Part | str]] = field(default_factory=dict)
    limit_notes: Sequence[str] = ()
    last_chapters: Sequence[Chapter] = ()
    additions: JsonObject = field(default_factory=dict)
    messages: Sequence[str] = ()

    def build_summary(self, files: Sequence[Path]) -> JsonObject:
        """Return the JSON object of ``probe-design optimize``."""
        summary = self.optimum.build_summary([str(file) for file in files]) | {"advice": list(self.advice)}
        return summary | self.additions | {"provenance": self.provenance}

    def write(self, folder: Path, progress: Progress, *, force: bool = False, question_digest: str | None = None) -> list[Path]:
        """Write everything into ``folder``, all of it or nothing; the STEP files are checked before they take their names.

        ``force`` and ``question_digest`` are those of ``geometry.cad.export.export_parts``.

        Raises
        ------
        ExportError
            A part differs from the parameters.
        InputError
            The folder holds another design.
        MissingLibrary
            CAD cannot be loaded.
        OSError
            The folder cannot be written.
        """
        progress(WRITING_STAGE, 0, 4)
        scene = self.optimum.scene
        probe, edge = scene.probe, scene.contact.edge_radius
        # with the accuracy to which the next command computes it, where the default is out of reach
        texts = {"design.toml": format_toml_comment(self.provenance) + scene_to_toml(state_accuracy(scene)), **self.texts}
        names = [
            *list_part_files(probe), RECORD_NAME, DRAWING_FILE, *self.pictures, *texts, "optimize.json", "report.html",
        ]  # fmt: skip
        paths = [folder / name for name in names]
        writers: dict[str, Writer] = {DRAWING_FILE: lambda path: draw_probe(probe, path, edge)}
        writers |= {name: draw for name, (_, draw) in self.pictures.items()}
        writers |= {name: partial(Path.write_text, data=text, encoding="utf-8") for name, text in texts.items()}
        writers["optimize.json"] = lambda path: path.write_text(
            json.dumps(self.build_summary(paths), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        writers["report.html"] = lambda path: path.write_text(
            self.build_page(names[:-1], self.build_summary(paths), path.parent), encoding="utf-8"
        )
        progress(WRITING_STAGE, 1, 4)
        export_parts(probe, folder, force, question_digest, writers, edge_radius=edge)
        progress(WRITING_STAGE, 4, 4)
        return paths

    def build_page(self, files: Sequence[str], summary: JsonObject, folder: Path) -> str:
        """Return the report as an HTML page.

        Parameters
        ----------
        files
            Files in its folder to which the page links; pictures among them are embedded.
        summary
            The JSON object, which the page contains.
        folder
            Folder of the pictures.
        """
        verdict = self.optimum.verdict
        captions = {DRAWING_FILE: DRAWING_CAPTION} | {name: caption for name, (caption, _) in self.pictures.items()}
        pictures = {name: Picture.from_file(folder / name, caption) for name, caption in captions.items() if name in files}

        def find_parts(parts: Sequence[Part | str]) -> tuple[Part, ...]:
            """Return the parts with pictures in place of their file names, without those that are not drawn."""
            shown_parts = (pictures.get(part) if isinstance(part, str) else part for part in parts)
            return tuple(part for part in shown_parts if part is not None)

        chapters = [Chapter(title, find_parts(parts)) for title, parts in self.chapters.items()]
        limits = [(limit.name, format_limit(limit), "yes" if limit.active else "no") for limit in self.optimum.limits]
        sections = (
            Chapter("What to do next", NEXT_PARTS),
            Chapter("Start and optimum", (Text(f"{verdict[0].upper()}{verdict[1:]}."), self.table, *map(Text, self.notes))),
            *(chapter for chapter in chapters if chapter.parts),
            Chapter("Limits", (Table(("limit", "value", "active"), limits), *map(Text, self.limit_notes))),
            Chapter("What to machine", (*find_parts((DRAWING_FILE,)), Items(tuple(files), links=True), *WORKSHOP_PARTS)),
            *iterate_scene_sections(self.shown_scene, self.map_noise),
            Chapter("What to keep in mind", (Items((*self.cautions, *self.assumptions)),)),
            build_scene_section(self.optimum.scene, "The scene of the design"),
            *self.last_chapters,
        )
        headline, improved = "\n".join(self.advice), self.optimum.winner is not None
        return build_page(title="Probe design", headline=headline, sections=sections, json_object=summary, is_positive=improved)


def format_limit(limit: Limit) -> str:
    """Return the value of a limit in the unit that a person would use: mm, kPa, mN or pC, or none for a pure number."""
    size, unit = LIMIT_UNITS.get(limit.name.rpartition(" ")[2], (M_PER_MM, " mm"))
    return f"{limit.value / size:.4g}{unit}"


def format_heights(probe: Probe) -> str:
    """Return the height of both blocks in mm, or that of each where they differ."""
    return " / ".join(f"{height / M_PER_MM:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height)))
