"""Scenes: the reference files load and round-trip, Python takes SI floats, files need units, nothing can be changed."""

from __future__ import annotations

import math
import os
import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from geometry import (
    BlockTissue,
    Contact,
    Groove,
    Inclusion,
    InputError,
    Load,
    Material,
    Placement,
    Probe,
    Scene,
    read_scene,
    scene_from_dict,
    scene_from_toml,
    scene_to_dict,
    scene_to_toml,
)
from tests.support.paths import REFERENCE

FILES = sorted(REFERENCE.glob("*/*.toml"))
SHALLOW = REFERENCE / "axisymmetric" / "shallow.toml"

GLUE = {"thickness": 1e-5, "youngs_modulus": 1e9, "poisson_ratio": 0.4}


def test_the_reference_folders_are_complete() -> None:
    counts = {folder: len(list((REFERENCE / folder).glob("*.toml"))) for folder in ("axisymmetric", "solid", "extra")}
    assert counts == {"axisymmetric": 8, "solid": 5, "extra": 51}


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
class TestReferenceScenes:
    def test_round_trip(self, path: Path) -> None:
        scene = read_scene(path)
        assert scene_from_toml(scene_to_toml(scene)) == scene
        assert scene_from_dict(scene_to_dict(scene)) == scene
        assert read_scene(str(path)) == scene

    def test_every_number_of_the_file_is_in_the_scene(self, path: Path) -> None:
        units = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "N": 1.0}
        scene = read_scene(path).model_dump()

        def compare(table: dict[str, object], values: dict[str, object]) -> None:
            for key, wanted in table.items():
                actual = values[key]
                if isinstance(wanted, dict):
                    assert isinstance(actual, dict)
                    compare(wanted, actual)
                elif isinstance(wanted, list):
                    assert isinstance(actual, tuple)
                    for wanted_item, actual_item in zip(wanted, actual, strict=True):
                        compare(
                            *(
                                (wanted_item, actual_item)
                                if isinstance(wanted_item, dict)
                                else ({key: wanted_item}, {key: actual_item})
                            )
                        )
                elif isinstance(wanted, str) and " " in wanted:
                    number, unit = wanted.split(" ")
                    assert actual == pytest.approx(float(number) * units[unit], rel=1e-15)
                else:
                    assert actual == wanted

        compare(tomllib.loads(path.read_text()), scene)


def make() -> Scene:
    """Every table and key that a scene may have, in Python: SI floats."""
    rubber, tissue = Material(youngs_modulus=1e5, poisson_ratio=0.4), {"youngs_modulus": 6e3, "poisson_ratio": 0.45}
    heights = {"inner_height": 3e-3, "outer_height": 4e-3}
    return Scene(
        probe=Probe(
            inner_radius=4e-3, outer_radius=6e-3, gap=1e-4, inner=rubber, outer=rubber,
            base={"youngs_modulus": 2e9, "poisson_ratio": 0.3, "thickness": 2e-3}, groove=Groove(width=2e-3, depth=1e-3),
            film={
                "thickness": 5e-5, "psi1": -0.5, "bond_to_base": GLUE,
                "outer": {"electrode_inset": 1e-4, "bond_to_block": {"name": "tape-50um", "youngs_modulus": 4e5}},
            },
            **heights,
        ),
        tissue=BlockTissue(shape="block", length=0.1, breadth=0.08, depth=0.06, **tissue),
        inclusion=[
            Inclusion(diameters=(8e-3, 6e-3, 5e-3), orientation=(30, 20.5, -10), depth=7e-3, x=-1 / 300, target=True, **tissue),
            Inclusion(surface="tumour é.stl", depth=math.pi * 1e-2, y=1e-2, **tissue),
        ],
        contact=Contact(interface="unilateral", friction=0.3),
        placement=Placement(x=1e-3, y=-1e-3, tilt=0.05),
        load=Load(force=0.1),
    )  # fmt: skip


class TestPython:
    def test_floats_are_si_and_written_with_units(self) -> None:
        tables = scene_to_dict(make())
        assert tables["probe"]["gap"] == "0.1 mm"
        assert tables["load"] == {"force": "0.1 N"}
        assert tables["inclusion"][0]["diameters"] == ["8 mm", "6 mm", "5 mm"]
        assert tables["placement"] == {"x": "1 mm", "y": "-1 mm", "tilt": "0.05 rad"}

    def test_round_trip_to_the_last_digit(self) -> None:
        scene = make()
        read_scene_again = scene_from_toml(scene_to_toml(scene))
        assert read_scene_again == scene
        assert read_scene_again.inclusion[1].depth == math.pi * 1e-2
        assert scene_to_toml(read_scene_again) == scene_to_toml(scene)

    def test_file_of_the_same_floats_needs_units(self) -> None:
        with pytest.raises(InputError, match=r"^load\.force = 0\.1: allowed: a force with its unit.* \(the unit is missing\)$"):
            scene_from_dict(scene_to_dict(make()) | {"load": {"force": 0.1}})

    @pytest.mark.parametrize("value", [math.nan, math.inf, -1e-3, 0, True, None, [1e-3], 10**400, "1"])
    def test_what_python_refuses(self, value: object) -> None:
        with pytest.raises(ValidationError):
            Groove(width=value, depth=1e-3)

    def test_target(self) -> None:
        inclusion = Inclusion(diameter=1e-3, depth=5e-3, youngs_modulus=1e3, poisson_ratio=0.3)
        second = inclusion.model_copy(update={"x": 5e-3})

        def target(*bodies: Inclusion) -> int | None:
            return make().model_copy(update={"inclusion": bodies}).target

        assert (target(), target(inclusion), target(inclusion, second)) == (None, 0, None)
        assert target(inclusion, second.model_copy(update={"target": True})) == 1

    @pytest.mark.parametrize(
        "path", ["load.force", "probe.inner.poisson_ratio", "placement.x", "contact", "inclusion", "probe.new"]
    )
    def test_frozen(self, path: str) -> None:
        *parents, last = path.split(".")
        table: object = make()
        for key in parents:
            table = getattr(table, key)
        with pytest.raises(ValueError, match=r"scene\.replace|frozen|no field"):
            setattr(table, last, 0.1)

    def test_equal_scenes_hash_alike(self) -> None:
        assert hash(make()) == hash(make())


class TestFiles:
    @pytest.mark.parametrize(
        ("content", "fault"),
        [
            (b"", r"empty: allowed: a scene with \[probe\]"),
            (b"# nothing\n", r"empty: allowed: "),
            (b"probe = \n", r"not TOML: .*line 1.*: allowed: a TOML scene file"),
            (b"hello world", r"not TOML: "),
            (b"[probe\n", r"not TOML: "),
            (b"a = 1\na = 2\n", r"not TOML: "),
            (b"a = 1\r", r"not TOML: "),
            (b"a = " + b"[" * 100_000, r"TOML with a huge integer or deep nesting: "),
            (b"a = " + b"9" * 5000, r"TOML with a huge integer or deep nesting: "),
            (b".".join([b"a"] * 10_000) + b" = 1", r"a line with 100 dots: "),
            (b"\x00", r"not TOML: "),
            (b"<!doctype html>\n" + 200 * b"a.", r"a page, not TOML: .*use a browser"),
            (b"x,y,ratio,blank\n0 mm,0 mm,0.5,true\n", r"readings of a scan, CSV, not TOML: .*--readings of probe-design locate"),
            (b"stretch,stress MPa\n1,0\n", r"a curve of a material, CSV, not TOML: .*probe-design material fit"),
            (b"time;CH1\n0;1\n", r"CSV, not TOML: .*--replay of probe-design read"),
            (b"ISO-10303-21;\nHEADER;\n", r"a STEP file, not TOML: .*`surface` of an"),
            (b'{"format": "probe-design parts"}', r"JSON, not TOML: allowed: a TOML scene file; use probe-design rerun"),
            (b"\xff\xfe\x00\x01binary", r"a TOML file, which is UTF-8 text"),
            ("a = 1".encode("utf-16"), r"a TOML file, which is UTF-8 text"),
            (b"#" * 1_000_001, r"a TOML file of at most 1000000 bytes"),
        ],
        ids=range(20),
    )
    def test_content(self, tmp_path: Path, content: bytes, fault: str) -> None:
        path = tmp_path / "scene.toml"
        path.write_bytes(content)
        with pytest.raises(InputError, match=fault) as refused:
            read_scene(path)
        assert "\n" not in str(refused.value)
        assert "scene.toml" in str(refused.value)

    @pytest.mark.parametrize("name", ["missing.toml", "", "a\x00b", "x" * 5000, "missing/folder.toml", "\udcff.toml"])
    def test_no_such_file(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match=r"^scene file = .*allowed: a TOML file that can be read \(.*\)$"):
            read_scene(tmp_path / name)

    @pytest.mark.skipif(os.name == "nt", reason="Windows has no such device")
    def test_endless_device(self) -> None:
        with pytest.raises(InputError, match=r"^scene file = '/dev/zero': allowed: a TOML file of at most 1000000 bytes$"):
            read_scene("/dev/zero")

    def test_line_ends_and_byte_order_mark_of_windows(self, tmp_path: Path) -> None:
        path = tmp_path / "windows.toml"
        path.write_bytes(b"\xef\xbb\xbf" + SHALLOW.read_bytes().replace(b"\n", b"\r\n"))
        assert read_scene(path) == read_scene(SHALLOW)


def test_surface_files_are_relative_to_the_scene_file(tmp_path: Path) -> None:
    text = (REFERENCE / "solid" / "flank.toml").read_text(encoding="utf-8")
    assert 'diameter = "8 mm"' in text
    path = tmp_path / "scene.toml"
    path.write_text(text.replace('diameter = "8 mm"', 'surface = "tumour.stl"'), encoding="utf-8")
    assert read_scene(path).inclusion[0].surface == str(tmp_path / "tumour.stl")
