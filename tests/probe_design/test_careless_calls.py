"""What users of Python get wrong is refused in one sentence, which names the argument and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import probe_design
from geometry.common.errors import InputError
from geometry.common.percent import format_minimum_percent, format_percent
from probe_design.notebook import format_record
from probe_design.sweeps.file import sweep_from_dict
from probe_design.terminal.result_tables import build_curve_table
from tests.support.program import refused

SCENE = str(Path(__file__).parents[2] / "examples" / "scene.toml")
SPHERE = [[[0.0, 0.0, 1e-2, 8e-3, 3e4]]]
pd: Any = probe_design  # calls are wrong on purpose


def _read() -> Any:
    return pd.Scene.from_file(SCENE)


CALLS: dict[str, tuple[Callable[[], object], str]] = {
    "no tables": (lambda: pd.Scene(), r"probe = missing: allowed: a table, \[probe\]"),
    "a file": (lambda: pd.Scene(SCENE), "scene = '.*Scene.from_file reads a file"),
    "a wrong table": (lambda: pd.Scene(probes={}), r"probes = \{\}: allowed: one of probe, .*did you mean 'probe'"),
    "nothing to read": (lambda: pd.Scene.from_file(), r"path = missing: allowed: a value, as in Scene.from_file\(path\)"),
    "a key as keyword": (lambda: _read().replace(probe_gap=1), r"probe_gap = 1: allowed: Scene.replace\(changes\)"),
    "plotted to": (lambda: _read().plot("section.png"), r"argument 1 = 'section.png': allowed: Scene.plot\(\)"),
    "no scene": (lambda: pd.evaluate(), r"scene = missing: allowed: a value, as in evaluate\(scene, evaluator=, .*loads="),
    "tables": (lambda: pd.evaluate({"probe": {}}), "scene = .*allowed: a Scene, or the name of a scene file"),
    "misspelt": (lambda: pd.evaluate(SCENE, evaluater="solid"), "evaluater = 'solid': .*did you mean 'evaluator'"),
    "twice": (lambda: pd.evaluate(SCENE, scene=SCENE), "scene = '.*: allowed: given once"),
    "a text for a flag": (lambda: pd.evaluate(SCENE, linear="no"), "linear = 'no': allowed: True or False"),
    "an array": (lambda: pd.evaluate(SCENE, accuracy=np.ones(2)), "accuracy = array.*a number above 0 and below 1"),
    "a length": (lambda: pd.evaluate(SCENE, frequency="5 mm"), "frequency = '5 mm': allowed: a frequency with its unit"),
    "no moduli": (lambda: pd.curve(SCENE), r"moduli = missing: allowed: a value, as in curve\(scene, moduli, "),
    "no load": (lambda: pd.press(SCENE), "load = missing: allowed: the largest load: either force"),
    "two loads": (lambda: pd.press(SCENE, force=1, indentation=1), "load = both force and indentation: allowed"),
    "no force": (lambda: pd.press(SCENE, force=0), "force = 0.0: allowed: the largest load, above 0"),
    "half a point": (lambda: pd.press(SCENE, force="1 mN", points=2.5), "points = 2.5: allowed: a whole number"),
    "by its place": (lambda: pd.press(SCENE, 0.01), r"argument 2 = 0.01: allowed: press\(scene, \*, force=, .*by its name"),
    "no scenes": (lambda: pd.evaluate_many(3), "scenes = 3: allowed: several scenes"),
    "words": (lambda: pd.scan(SCENE, positions=["left"]), "positions = 'left': allowed: a position with its unit"),
    "None": (lambda: pd.scan(SCENE, positions=[None]), r"positions = \[None\]: allowed: lengths, m, or texts"),
    "depths": (lambda: pd.detectability(SCENE, depths=["9 kPa"]), "depths = '9 kPa': allowed: a position with its unit"),
    "no readings": (lambda: pd.locate(SCENE), r"readings = missing: allowed: a value, as in locate\(design, \*, readings,"),
    "no sweep": (lambda: pd.sweep(3, 4), "specification = 3: allowed: the name of a sweep file"),
    "no terminal": (lambda: pd.calibrate(SCENE, device="usb"), r"device = without a terminal: allowed: .*\(wait=SECONDS\)"),
    "no places": (lambda: pd.predict_readings(SCENE, SPHERE, 4), r"positions = an array of shape \(\): allowed: finite x and y"),
    "no numbers": (lambda: pd.predict_readings(SCENE, [["a"]], 4), "tumours = .*: allowed: numbers in SI units"),
    "nothing to plot": (lambda: pd.plot(3), "result = an object of type int: allowed: a result of"),
    "no design": (lambda: pd.Locator(), r"design = missing: allowed: a value, as in Locator\(design, "),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_careless_call_is_refused_in_one_sentence(name: str) -> None:
    call, sentence = CALLS[name]
    with pytest.raises(InputError, match=f"^{sentence}") as refused:
        call()
    assert "\n" not in str(refused.value)


def test_a_wrong_call_is_a_type_error_too() -> None:
    """As Python's own refusal of a call is, so that programs that expect it go on."""
    with pytest.raises(TypeError):
        pd.evaluate()


def test_texts_with_units_are_read_like_numbers() -> None:
    """As moduli and loads are; positions and frequencies ended in Python's own messages."""
    by_text, by_number = (pd.scan(SCENE, positions=x, accuracy=0.1) for x in (["-5 mm", "5 mm"], [-5e-3, 5e-3]))
    assert by_text.ratio == by_number.ratio
    assert pd.evaluate(SCENE, "closed-form", "10 %", frequency="5 Hz").frequency == 5.0


def test_moduli_are_shown_in_kilopascals() -> None:
    """On a terminal, in Python and in a notebook; the numbers themselves are in Pa."""
    curve = pd.curve(SCENE, ["30 kPa"], accuracy=0.1)
    assert curve.youngs_modulus == (3e4,)
    for text in (str(curve), format_record(curve), build_curve_table(curve).to_csv()):
        assert "youngs_modulus, kPa" in text
        assert "30000" not in text
    assert re.search(r"^ +30 ", str(curve), re.M)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, np.uint8])
def test_numbers_of_numpy_are_numbers(kind: type[Any]) -> None:
    """Also those that are no float or int of Python: entries of arrays of such kinds."""
    force, modulus, ratio = kind(1), kind(200), kind(1)
    scene = _read().replace({"load.force": force, "tissue.youngs_modulus": modulus, "probe.area_ratio": ratio})
    assert (scene.load.force, scene.tissue.youngs_modulus, scene.probe.area_ratio) == (1.0, 200.0, 1.0)
    assert pd.Scene(**scene.model_dump(exclude_unset=True) | {"load": {"force": force}}) == scene
    design = {"scene": scene, "variables": {"tissue.youngs_modulus": [kind(100), modulus]}}
    assert [values for _, values in sweep_from_dict(design).list_designs()] == [(100.0,), (200.0,)]


def test_tables_build_the_scene_that_its_file_has() -> None:
    scene = _read()
    assert pd.Scene(probe=scene.probe, tissue=scene.tissue, inclusion=scene.inclusion, load=scene.load) == scene


@pytest.mark.parametrize(
    ("fraction", "digits", "text"),
    [(0.0123, 2, "1.2 %"), (1.234, 2, "120 %"), (0.07, 6, "7 %"), (1e-5, 2, "0.001 %"), (0.0, 2, "0 %"), (0.999, 1, "100 %")],
)
def test_fractions_are_written_in_percent(fraction: float, digits: int, text: str) -> None:
    assert format_percent(fraction, digits) == text


def test_a_lower_limit_in_percent_is_rounded_up() -> None:
    """In decimals: 100 * 0.07 is 7.000000000000001 in floats, and 7.1 rounded up."""
    assert (format_minimum_percent(0.07, 2), format_minimum_percent(0.01001, 2)) == ("7 %", "1.1 %")


def test_fractions_may_be_given_in_percent() -> None:
    by_text, by_number = (_read().replace({"reading.accuracy": value}) for value in ("2 %", 0.02))
    assert by_text == by_number
    by_text, by_number = (refused("material", "show", "ecoflex-00-30", "--thinner", value) for value in ("30 %", "0.3"))
    assert by_text == by_number
    assert "thinner = 30 %: allowed: a share of thinner from 0 % to 25 %, as measured" in by_text
