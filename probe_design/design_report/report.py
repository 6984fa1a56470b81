"""Write the files of an optimisation of either kind: design, STEP files, drawing, pictures, table and report."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from geometry.cad.export import export_parts
from geometry.cad.parts_record import RECORD_NAME, list_part_files
from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance, build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.workshop.overview import draw_probe
from probe_design.design_search.optimum import Optimum
from probe_design.reporting.page import Chapter, Items, Part, Picture, Text, build_page
from probe_design.reporting.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.reporting.table import Table
from probe_design.reporting.workshop_command import WORKSHOP_PARTS

WRITING_STAGE = "writing STEP files, pictures and report"
DRAWING_FILE, DRAWING_CAPTION = "drawing.png", "section and view of the probe"
Progress = Callable[[str, int, int], None]
Writer = Callable[[Path], object]
Found = TypeVar("Found", bound=Optimum[Any])


class Report(ABC, Generic[Found]):
    """The report of an optimisation; subclasses state what only one kind of question has.

    Parameters
    ----------
    optimum
        The result of the optimisation.
    """

    def __init__(self, optimum: Found) -> None:
        self.optimum = optimum

    @abstractmethod
    def build_table(self) -> Table:
        """Return the table that compares start and optimum."""

    @abstractmethod
    def list_notes(self) -> Iterable[str]:
        """Return notes that explain the numbers of the comparison."""

    @property
    @abstractmethod
    def pictures(self) -> Mapping[str, tuple[str, Writer]]:
        """Pictures other than the drawing by file name: a caption, and a function that draws each."""

    @property
    @abstractmethod
    def texts(self) -> Mapping[str, Callable[[], str]]:
        """Further text files."""

    @property
    @abstractmethod
    def provenance(self) -> Provenance:
        """The provenance of the results."""

    @property
    def linear_scene(self) -> tuple[Scene, float | None]:
        """The scene whose maps and stresses are shown, and the noise of its maps; None leaves these out."""
        return self.optimum.scene, None

    @property
    def additions(self) -> JsonObject:
        """Further keys of the JSON object."""
        return {}

    @property
    def messages(self) -> tuple[str, ...]:
        """Lines for the terminal, below the table."""
        return ()

    def build_chapters(self, pictures: Mapping[str, tuple[Picture, ...]]) -> Mapping[str, tuple[Part, ...]]:
        """Return the chapters that only this kind has, between comparison and limits."""
        return {}

    @property
    def limit_notes(self) -> tuple[Text, ...]:
        """Notes that explain the limits, below their table."""
        return ()

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions for the reader."""
        return self.optimum.warnings

    def build_last_chapters(self) -> tuple[Chapter, ...]:
        """Return the chapters that only this kind has, at the end."""
        return ()

    def build_summary(self, files: Sequence[Path]) -> JsonObject:
        """Return the JSON object of ``probe-design optimize``."""
        return self.optimum.build_summary([str(file) for file in files]) | self.additions | {"provenance": self.provenance}

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
        comment, pictures = format_toml_comment(self.provenance), self.pictures
        texts: dict[str, Callable[[], str]] = {
            "design.toml": lambda: comment + scene_to_toml(scene),
            **self.texts,
            "optimize.json": lambda: json.dumps(self.build_summary(paths), indent=2, allow_nan=False) + "\n",
        }
        names = [*list_part_files(probe), RECORD_NAME, DRAWING_FILE, *pictures, *texts, "report.html"]
        paths = [folder / name for name in names]
        writers: dict[str, Writer] = {DRAWING_FILE: lambda path: draw_probe(probe, path, edge)}
        writers |= {name: draw for name, (_, draw) in pictures.items()}
        writers |= {name: partial(_write_text, text) for name, text in texts.items()}
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
        captions = {DRAWING_FILE: DRAWING_CAPTION} | {name: caption for name, (caption, _) in self.pictures.items()}
        pictures = {
            name: (Picture.from_file(folder / name, caption),) if name in files else () for name, caption in captions.items()
        }
        limits = [(limit.name, f"{limit.value:.4g}", "yes" if limit.active else "no") for limit in self.optimum.limits]
        sections = (
            Chapter("Start and optimum", (self.build_table(), *map(Text, self.list_notes()))),
            *(Chapter(title, parts) for title, parts in self.build_chapters(pictures).items() if parts),
            Chapter("Limits", (Table(("limit", "value, SI", "active"), limits), *self.limit_notes)),
            Chapter("What to machine", (*pictures[DRAWING_FILE], Items(tuple(files), links=True), *WORKSHOP_PARTS)),
            *iterate_scene_sections(*self.linear_scene),
            Chapter("What to keep in mind", (Items(self.cautions or ("nothing",)),)),
            build_scene_section(self.optimum.scene, "The scene of the design"),
            *self.build_last_chapters(),
        )
        verdict, improved = self.optimum.verdict, self.optimum.winner is not None
        headline = f"{verdict[0].upper()}{verdict[1:]}."
        return build_page(title="Probe design", headline=headline, sections=sections, answer=summary, is_positive=improved)

    def build_provenance(self, evaluator: str, seed: int | None = None) -> Provenance:
        """Return the provenance of results by an evaluator for the question's scene."""
        return build_provenance(self.optimum.design.scene, evaluator=evaluator, seed=seed)


def _write_text(text: Callable[[], str], path: Path) -> None:
    path.write_text(text(), encoding="utf-8")
