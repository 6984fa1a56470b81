"""Materials by name: numbers from the published values, names that stay and that go."""

from __future__ import annotations

import math
from typing import Any

import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_from_dict, scene_from_toml, scene_to_toml

SOFT = {"youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
PUBLISHED = {  # kPa: Marechal et al. 2020, tension; Dawood et al., compression
    "dragon-skin-30": 668.0,
    "ecoflex-00-30": math.sqrt(97.3 * 48.0),
    "ecoflex-00-10": math.sqrt(54.2 * 24.0),
}


def named(**inner: Any) -> dict[str, Any]:
    """Tables of a scene with a name wherever there may be one."""
    return {
        "probe": {
            "inner_radius": "4 mm", "area_ratio": 1.2, "gap": "0.1 mm", "height": "3 mm",
            "inner": {"material": "Dragon Skin 30", **inner}, "outer": {"material": "ecoflex-00-30"},
            "base": {"rigid": True, "material": "aluminium-6061-t6"},
        },
        "tissue": {
            "shape": "half-space", "material": "ecoflex-00-10", "layer": [{"thickness": "2 mm", "material": "ecoflex-00-30"}],
        },
        "inclusion": [{"diameter": "8 mm", "depth": "9 mm", "material": "sylgard-184 20:1"}],
        "load": {"force": "10 mN"},
    }  # fmt: skip


def test_a_name_stands_for_the_published_numbers_wherever_a_material_is() -> None:
    scene = scene_from_dict(named())
    bodies = (scene.probe.inner, scene.probe.outer, scene.tissue, scene.tissue.layer[0], scene.inclusion[0])
    names = ["dragon-skin-30", "ecoflex-00-30", "ecoflex-00-10", "ecoflex-00-30", "sylgard-184 20:1"]
    assert [body.material for body in bodies] == names
    for body in bodies[:4]:
        assert body.youngs_modulus == pytest.approx(1e3 * PUBLISHED[str(body.material)], rel=5e-4)  # four digits
    assert scene.inclusion[0].youngs_modulus == 1e6  # 20 MPa / 20: J. Appl. Polym. Sci. 2014, 131, 41050
    assert (scene.probe.base.material, scene.probe.base.youngs_modulus) == ("aluminium-6061-t6", None)  # rigid all the same


def test_a_base_by_its_name_gives_way() -> None:
    tables = named()
    tables["probe"]["base"] = {"material": "aluminium-6061-t6"}
    assert scene_from_dict(tables).probe.base.youngs_modulus == 68.9e9


def test_a_scene_written_back_keeps_names_and_measured_numbers() -> None:
    scene = scene_from_dict(named(youngs_modulus="610 kPa"))
    read_scene_again = scene_from_toml(scene_to_toml(scene))
    assert read_scene_again == scene
    assert read_scene_again.probe.inner.material == "dragon-skin-30"
    assert read_scene_again.probe.inner.youngs_modulus == 610e3


@pytest.mark.parametrize(
    ("inner", "key"),
    [
        ({"youngs_modulus": "68 kPa"}, "probe.inner.youngs_modulus"),
        ({"youngs_modulus": "68 MPa"}, "probe.inner.youngs_modulus"),
        ({"poisson_ratio": 0.3}, "probe.inner.poisson_ratio"),
        ({"material": "dragon-skin-31"}, "probe.inner.material"),
        ({"material": "pvdf-28um"}, "probe.inner.material"),
        ({"material": 30}, "probe.inner.material"),
        ({"youngs_modulus": "610"}, "probe.inner.youngs_modulus"),
    ],
)
def test_a_contradiction_is_refused(inner: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as refusal:
        scene_from_dict(named(**inner))
    assert refusal.value.key == key


def test_a_varied_material_loses_its_name_and_no_other_does() -> None:
    scene = scene_from_dict(named())
    varied = scene.replace({"probe.inner.youngs_modulus": 500e3, "probe.outer.youngs_modulus": scene.probe.outer.youngs_modulus})
    assert (varied.probe.inner.material, varied.probe.inner.youngs_modulus) == (None, 500e3)
    assert varied.probe.outer.material == "ecoflex-00-30"
    stretched = scene.replace({"tissue.poisson_ratio": 0.3, "probe.gap": 0.2e-3})
    assert (stretched.tissue.material, stretched.probe.inner.material) == (None, "dragon-skin-30")


def test_numbers_alone_have_no_name() -> None:
    tables = named()
    tables["tissue"] = {"shape": "half-space", **SOFT}
    scene: Scene = scene_from_dict(tables)
    assert scene.tissue.material is None
    assert "material" not in scene_to_toml(scene).partition("[tissue]")[2].partition("[[")[0]
