"""Every command that makes parts hands the scene's round edges on to the parts and to their drawing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from geometry.provenance.block import build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene, scene_to_toml
from geometry.scenes.scene_tables import Contact
from geometry.workshop.tolerance import NO_BUDGET
from probe_design.commands.main import cli
from probe_design.design_report.report import Report
from probe_design.reporting.table import Table
from probe_design.workshop import package  # before anything is replaced, or what is replaced would stay in it
from tests.support.paths import SCENE

EDGE = 0.1e-3
Handed = list[tuple[str, float]]


@pytest.fixture
def scene() -> Scene:
    sharp = read_scene(SCENE)
    return sharp.model_copy(update={"contact": Contact(edge_radius=EDGE)})


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> Handed:
    """What was handed to export and drawing in place of the work."""
    got: Handed = []

    def write(
        probe: object,
        folder: Path,
        force: bool = False,
        question_digest: object = None,
        other_files: Any = None,
        edge_radius: float = 0.0,
    ) -> tuple[Path, ...]:
        got.append(("parts", edge_radius))
        other_files["drawing.png"](folder / "drawing.png")
        return ()

    def draw(probe: object, path: Path, edge_radius: float = 0.0) -> None:
        got.append(("drawing", edge_radius))

    monkeypatch.setattr("probe_design.design_report.report.export_parts", write)
    monkeypatch.setattr("probe_design.design_report.report.draw_probe", draw)
    for name, instead in (("write", write), ("draw_probe", draw), ("compute_ratio_budget", lambda scene, ratio: NO_BUDGET)):
        monkeypatch.setattr(package, name, instead)
    return got


def test_export(tmp_path: Path, scene: Scene, handed: Handed) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(scene_to_toml(scene))
    ended = CliRunner().invoke(cli, ["export", str(file), "-o", str(tmp_path / "out"), "--json"])
    assert ended.exit_code == 0, ended.output
    assert handed == [("parts", pytest.approx(EDGE)), ("drawing", pytest.approx(EDGE))]


@pytest.mark.slow
def test_optimize(tmp_path: Path, scene: Scene, handed: Handed) -> None:
    optimum: Any = SimpleNamespace(scene=scene)
    report = Report(optimum, Table((), ()), (), (), (), build_provenance(scene), (), scene)
    report.write(tmp_path, lambda *_: None)
    assert handed == [("parts", EDGE), ("drawing", EDGE)]
