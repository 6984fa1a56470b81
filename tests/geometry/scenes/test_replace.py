"""Values of a scene replaced under the keys of its file: against scenes read from texts that have these values."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.common.errors import InputError
from geometry.provenance.block import compute_scene_digest
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene, scene_from_toml, scene_to_toml
from geometry.scenes.variables import list_law_constants

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.toml"


def test_a_text_with_a_unit_and_an_si_number_give_the_scene_that_a_file_with_that_value_gives() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    gap = next(line for line in text.splitlines() if line.startswith("gap = "))
    expected = scene_from_toml(text.replace(gap, 'gap = "0.2 mm"'))
    scene = read_scene(EXAMPLE)
    assert scene.replace({"probe.gap": "0.2 mm"}) == scene.replace({"probe.gap": 2e-4}) == expected
    assert scene.probe.gap == read_scene(EXAMPLE).probe.gap  # the scene itself stays
    assert scene.replace({}) == scene


def test_every_number_that_a_scene_file_holds_can_be_replaced() -> None:
    layered = read_scene(EXAMPLE).model_dump(exclude_unset=True)
    layered["tissue"]["layer"] = [{"thickness": 2e-3, "youngs_modulus": 5e3, "poisson_ratio": 0.48}]
    scene = read_scene(EXAMPLE).from_tables(layered)
    changes = {
        "tissue.layer[0].thickness": "1.5 mm",
        "inclusion[0].depth": "11 mm",
        "contact.edge_radius": "0.05 mm",
        "placement.tilt": "1 deg",
        "load.force": "3 mN",
        "probe.base.thickness": "2 mm",
    }
    moved = scene.replace(changes)
    assert moved.tissue.layer[0].thickness == 1.5e-3
    assert (moved.inclusion[0].depth, moved.contact.edge_radius, moved.load.force) == (11e-3, 0.05e-3, 3e-3)
    assert moved.placement.tilt == pytest.approx(0.017453292519943295, rel=1e-15)
    assert scene_from_toml(scene_to_toml(moved)) == moved


def test_a_key_that_excludes_a_new_one_goes() -> None:
    scene = read_scene(EXAMPLE)
    pressed = scene.replace({"load.indentation": "0.1 mm"})
    assert (pressed.load.force, pressed.load.indentation) == (None, 1e-4)
    assert scene.replace({"probe.outer_radius": "6 mm"}).probe.area_ratio is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"probe.gapp": 1e-4}, "did you mean 'gap'"),
        ({"inclusion[3].depth": "9 mm"}, "below 1, as many as the scene has"),
        ({"probe": 1.0}, "a key with one value, not a table"),
        ({"probe.gap": "0.2 N"}, "no unit that converts to m"),
        ({"probe.gap": 0.4}, "did you mean 0.0004"),  # 0.4 m: a number that has lost its millimetres
        ({"probe.gap": float("nan")}, "finite"),
        ({"inclusion.depth": "1 m"}, "leaves the tissue's bottom"),
    ],
)
def test_what_is_no_key_or_no_scene_is_refused(changes: dict[str, float | str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_scene(EXAMPLE).replace(changes)


def test_laws_at_finite_strain_are_replaced_by_path_and_written_back() -> None:
    scene = read_scene(EXAMPLE).replace({"tissue.law": "yeoh", "tissue.c2_over_c1": 0.4, "inclusion.law": "yeoh"})
    assert list_law_constants(scene) == {
        "tissue.c2_over_c1": 0.4, "tissue.c3_over_c1": 0.0, "inclusion.c2_over_c1": 0.0, "inclusion.c3_over_c1": 0.0
    }  # fmt: skip
    assert scene_from_toml(scene_to_toml(scene)) == scene
    stiffer = scene.replace({"tissue.c2_over_c1": 0.5})
    assert compute_scene_digest(stiffer) != compute_scene_digest(scene) != compute_scene_digest(read_scene(EXAMPLE))


def test_the_default_law_leaves_files_and_digests_as_they_were() -> None:
    scene = read_scene(EXAMPLE)
    stated = scene.replace({"tissue.law": "neo-hookean", "tissue.c2_over_c1": 0.0})
    assert compute_scene_digest(stated) == compute_scene_digest(scene)
    assert "law" not in scene_to_toml(scene)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tissue.c2_over_c1": 0.3}, r"tissue\.c2_over_c1 = 0\.3: allowed: 0, or any number beside law = 'yeoh'"),
        ({"tissue.law": "ogden"}, "'neo-hookean'.*'yeoh'"),
        ({"tissue.law": "yeoh", "tissue.c3_over_c1": float("inf")}, "finite"),
    ],
)
def test_laws_and_constants_that_do_not_fit_are_refused(changes: dict[str, float | str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_scene(EXAMPLE).replace(changes)


def test_a_bond_of_another_name_has_the_numbers_of_that_name() -> None:
    """A number beside the new name is a measured one, as in a file."""

    def read(bond: str) -> Scene:
        film = f"[probe.film]\n[probe.film.bond_to_base]\n{bond}\n\n[tissue]"
        return scene_from_toml(EXAMPLE.read_text(encoding="utf-8").replace("[tissue]", film, 1))

    taped = read('name = "tape-50um"')
    key = "probe.film.bond_to_base"
    assert taped.replace({f"{key}.name": "epoxy-20um"}) == read('name = "epoxy-20um"')
    assert taped.replace({f"{key}.name": "rigid"}) == read('name = "rigid"')
    measured = read('name = "epoxy-20um"\nyoungs_modulus = "2 GPa"')
    assert taped.replace({f"{key}.name": "epoxy-20um", f"{key}.youngs_modulus": "2 GPa"}) == measured
    assert measured.replace({f"{key}.name": "tape-50um"}) == taped
