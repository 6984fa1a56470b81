"""`probe-design tissue`: tables that a scene takes as they are, each number with its source."""

from __future__ import annotations

import json
import tomllib

import pytest

from geometry.scenes.scene_file import scene_from_dict
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

NAMES = ("breast", "forearm", "phantom", "breast-ex-vivo")


def test_the_list_names_all() -> None:
    assert list(json.loads(run("tissue", "list", "--json").stdout)["tissues"]) == list(NAMES)
    assert [line.split()[0] for line in run("tissue", "list").stdout.splitlines()] == list(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_shown_is_a_scene_s_tissue(name: str) -> None:
    shown, output = tomllib.loads(run("tissue", "show", name).stdout), json.loads(run("tissue", "show", name, "--json").stdout)
    assert shown["tissue"].get("layer", []) == output["tissue"]["layer"]
    scene = scene_from_dict(tomllib.loads((EXAMPLES / "scene.toml").read_text()) | shown)
    assert len(scene.tissue.layer) == len(output["tissue"]["layer"])
    assert set(output["sources"]) == {
        *(f"tissue.{key}" for key in output["tissue"] if key not in ("shape", "layer")),
        *(f"tissue.layer[{k}].{key}" for k, layer in enumerate(output["tissue"]["layer"]) for key in layer),
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_number_is_published_with_its_scatter_or_said_to_be_assumed(name: str) -> None:
    for source in json.loads(run("tissue", "show", name, "--json").stdout)["sources"].values():
        published = "+-" in source or "one volunteer" in source or "converted" in source or "end of the second range" in source
        assert published or source.startswith("assumed: ")


def test_the_breast_is_the_one_of_the_example() -> None:
    shown, example = tomllib.loads(run("tissue", "show", "breast").stdout), tomllib.loads((EXAMPLES / "skin.toml").read_text())
    assert shown["tissue"]["layer"] == example["tissue"]["layer"]
    assert shown["tissue"]["youngs_modulus"] == example["tissue"]["youngs_modulus"]


def test_the_stiffening_breast_has_the_published_moduli_in_both_ranges() -> None:
    """Teixeira et al.: 3.2 to 8.8 kPa over 3.75 to 11.5 % of compression, 43.0 to 117.6 kPa over 22.5 to 30 %."""
    tissue = json.loads(run("tissue", "show", "breast-ex-vivo", "--json").stdout)["tissue"]
    shear = 1e3 * float(tissue["youngs_modulus"].removesuffix(" kPa")) / 3

    def nominal(strain: float) -> float:
        s = 1 - strain
        return shear * (s - s**-2) * (1 + 2 * tissue["c2_over_c1"] * (s**2 + 2 / s - 3))

    for low, high, ends in ((0.0375, 0.115, (3.2e3, 8.8e3)), (0.225, 0.30, (43.0e3, 117.6e3))):
        modulus = (nominal(low) - nominal(high)) / (high - low)
        assert modulus == pytest.approx((ends[0] * ends[1]) ** 0.5, rel=0.01)
    s = 1 + tissue["law_strain"]
    assert s**2 + 2 / s == pytest.approx(0.7**2 + 2 / 0.7, rel=1e-3)


@pytest.mark.parametrize("words", [("show", "liver"), ("frob",)])
def test_what_is_not_there_is_refused(words: tuple[str, ...]) -> None:
    assert ": allowed: " in refused("tissue", *words)
