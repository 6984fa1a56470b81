"""The block that states where numbers come from: complete, the same for the same scene, without a machine's paths."""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from PIL import Image

from geometry import InputError, read_scene, scene_from_toml
from geometry.provenance.block import build_provenance, compute_file_digest, compute_scene_digest, record_command
from geometry.provenance.texts import format_html_script, format_toml_comment, read_block
from geometry.workshop.overview import draw_probe
from tests.support.paths import SCENE

TEXT = SCENE.read_text(encoding="utf-8")


def test_a_block_has_all_its_parts() -> None:
    block = build_provenance(read_scene(SCENE), evaluator="solid", accuracy=0.02, seed=7)
    assert block.keys() == {
        "format", "version", "program", "dependencies", "scene", "evaluator", "accuracy", "seed", "command", "inputs"
    }  # fmt: skip
    assert block["program"] == version("palpation-probe-design")
    assert block["dependencies"]["numpy"] == version("numpy")
    assert (block["evaluator"], block["accuracy"], block["seed"], block["command"]) == ("solid", 0.02, 7, None)


def test_a_scene_s_digest_is_of_its_numbers_not_of_its_text() -> None:
    other_words = scene_from_toml("# a comment\n" + TEXT.replace('"5 mm"', '"0.005 m"'))
    assert compute_scene_digest(other_words) == compute_scene_digest(read_scene(SCENE))
    moved = read_scene(SCENE)
    moved = moved.model_copy(update={"probe": moved.probe.model_copy(update={"gap": 1.001 * moved.probe.gap})})
    assert compute_scene_digest(moved) != compute_scene_digest(read_scene(SCENE))


def test_a_surface_counts_by_what_it_holds(tmp_path: Path) -> None:
    digests = []
    for folder, content in (("a", "one"), ("b", "one"), ("c", "two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "tumour.stl").write_text(content)
        scene = read_scene(SCENE)
        body = scene.inclusion[0].model_copy(update={"diameter": None, "surface": str(tmp_path / folder / "tumour.stl")})
        digests.append(compute_scene_digest(scene.model_copy(update={"inclusion": (body,)})))
    assert digests[0] == digests[1] != digests[2]


def test_a_command_and_its_files_are_told() -> None:
    words = ["evaluate", str(SCENE), "--accuracy", "0.1"]
    with record_command(words, SCENE, accuracy=0.1):
        block = build_provenance()
    assert block["command"] == ["evaluate", "scene.toml", "--accuracy", "0.1"]
    assert block["inputs"] == {"scene.toml": hashlib.sha256(SCENE.read_bytes()).hexdigest()}
    assert block["scene"] == compute_scene_digest(read_scene(SCENE))
    assert block["accuracy"] == 0.1
    assert build_provenance()["command"] is None


@pytest.mark.parametrize(
    ("word", "left"),
    [
        ("/home/somebody/scene.toml", "scene.toml"),
        ("-o/home/somebody/out", "-oout"),
        ("--output=/home/somebody/out", "--output=out"),
        (r"C:\Users\somebody\scene.toml", "scene.toml"),
        ("/home/somebody/run.probe, x=-8 mm", "run.probe, x=-8 mm"),
        ("designs/scene.toml", "designs/scene.toml"),
        ("../scene.toml", "../scene.toml"),
        ("2 N/m", "2 N/m"),
        ("tcp://host:8786", "tcp://host:8786"),
        ("/", "/"),
        ("-o/", "-o/"),
        ("/home/somebody/out/", "out/"),
    ],
)
def test_paths_of_a_machine_are_left_out(word: str, left: str) -> None:
    with record_command([word]):
        assert build_provenance()["command"] == [left]


def test_a_block_comes_back_out_of_every_text(tmp_path: Path) -> None:
    block = build_provenance(read_scene(SCENE))
    answer = {"ratio": 0.5, "note": "</script><b>", "provenance": block}
    (tmp_path / "a.json").write_text(json.dumps(answer))
    (tmp_path / "a.html").write_text(f"<html>{format_html_script('answer', answer)}<p>more</p></html>")
    (tmp_path / "a.toml").write_text(format_toml_comment(block) + TEXT)
    for name in ("a.json", "a.html"):
        assert read_block(tmp_path / name) == (block, {"ratio": 0.5, "note": "</script><b>"})
    assert read_block(tmp_path / "a.toml") == (block, tomllib.loads(TEXT))
    assert read_scene(tmp_path / "a.toml") == read_scene(SCENE)
    (tmp_path / "parts.json").write_text(json.dumps(answer))
    assert read_block(tmp_path)[0] == block


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"provenance": 3}', '{"provenance": {"format": "other"}}', "a = 1", "\0", "{"])
def test_what_has_no_block_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a").write_text(text)
    with pytest.raises(InputError, match="block of provenance"):
        read_block(tmp_path / "a")
    with pytest.raises(InputError, match="file = "):
        read_block(tmp_path / "nothing")


def test_pictures_tell_it_too(tmp_path: Path) -> None:
    """Read by pillow, matplotlib having written it."""
    with record_command(["export", "scene.toml"]):
        draw_probe(read_scene(SCENE).probe, tmp_path / "drawing.png")
    with Image.open(tmp_path / "drawing.png") as picture:
        assert json.loads(picture.info["Description"])["command"] == ["export", "scene.toml"]


def test_files_without_an_end_have_no_digest(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"a")
    assert compute_file_digest(tmp_path / "small") == hashlib.sha256(b"a").hexdigest()
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10**12)
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "large", tmp_path / "pipe", tmp_path, Path("/dev/zero"), tmp_path / "none", Path("\0")):
        assert compute_file_digest(path) is None
