"""The evaluators behind one interface: each by its name, their curves and accuracies, and warnings that carry their kind."""

from __future__ import annotations

import copy
import json
import pickle
import re

import numpy as np
import pytest

from geometry import Load, Refusal, Scene, read_scene
from solver import evaluate, evaluator
from solver.evaluators import EVALUATOR_NAMES
from solver.results.record import ERROR_FIELDS
from solver.results.warnings import Note, select_notes
from tests.support.imports import sources
from tests.support.paths import REFERENCE, SCENE
from tests.support.slow import slow_unless

MODULI = np.array([3e3, 3e4, 3e5])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return read_scene(SCENE)


def with_modulus(scene: Scene, modulus: float) -> Scene:
    return scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={"youngs_modulus": modulus}),)})


@pytest.mark.parametrize("name", EVALUATOR_NAMES)
def test_a_name_gives_an_evaluator_that_answers_to_it(name: str) -> None:
    named = evaluator(name)
    assert named.name == name
    assert named.summary
    assert all(callable(getattr(named, method)) for method in ("refusal", "evaluate", "evaluate_within", "curve"))


@pytest.mark.parametrize(("name", "rounding"), [("closed-form", 1e-12), ("equivalent-inclusion", 1e-6), ("axisymmetric", 0.01)])
def test_a_curve_goes_through_the_answers(scene: Scene, name: str, rounding: float) -> None:
    """The finite elements' curve comes from other solutions on perhaps another mesh: within the requested accuracy."""
    named = evaluator(name)
    curve = named.curve(scene, MODULI, 0.01)
    for k, modulus in enumerate(MODULI):
        alone = named.evaluate(with_modulus(scene, modulus), 0.01)
        assert curve.ratio[k] == pytest.approx(alone.ratio, rel=rounding)
        assert curve.log_sensitivity[k] == pytest.approx(alone.log_sensitivity, rel=5 * rounding)


@pytest.mark.parametrize(
    ("name", "reached", "missed"),
    slow_unless(lambda case: case[0] == "closed-form", [("closed-form", 0.5, 1e-4), ("axisymmetric", 0.02, 1e-12)]),
)
def test_an_accuracy_is_kept_or_refused(scene: Scene, name: str, reached: float, missed: float) -> None:
    estimate = evaluator(name).evaluate_within(scene, reached).error_estimate
    assert estimate is not None
    assert estimate <= reached
    with pytest.raises(Refusal, match="accuracy = "):
        evaluator(name).evaluate_within(scene, missed)


@pytest.mark.slow
def test_the_accuracy_that_a_refusal_names_is_reached() -> None:
    """Of a scene that reaches 0.0078, but 0.0095 where 0.0078 is requested."""
    path, accuracy = "solid/two-tumours-on-large-tumour.toml", 0.001
    scene = read_scene(REFERENCE / path).model_copy(update={"load": Load(force=0.0)})  # whose load refuses nothing
    with pytest.raises(Refusal, match=rf"^accuracy = {100 * accuracy:g} %: allowed: ") as fault:
        evaluate(scene, accuracy=accuracy)
    named = re.match("([0-9.e-]+) % or more", fault.value.allowed)
    assert named is not None
    allowed = float(named[1]) / 100
    estimate = evaluate(scene, accuracy=allowed).error_estimate
    assert estimate is not None
    assert estimate <= allowed


def test_no_text_calls_an_evaluator_planned_that_is_built() -> None:
    texts = [path.read_text(encoding="utf-8") for path in sources("solver")]
    assert {name for text in texts for name in re.findall(r"planned: ([a-z-]+)", text)}.isdisjoint(EVALUATOR_NAMES)


def test_the_papers_equations_refuse_what_needs_stresses(scene: Scene) -> None:
    with pytest.raises(Refusal, match="no film stresses"):
        evaluator("published").evaluate_within(scene, 0.5)
    with pytest.raises(Refusal, match="no film stresses"):
        evaluator("published").curve(scene, MODULI)


def test_a_warning_is_its_text_and_keeps_its_kind() -> None:
    note = Note("linear", "too much")
    assert note == "too much"
    assert json.dumps([note]) == '["too much"]'
    for copied in (copy.deepcopy(note), pickle.loads(pickle.dumps(note))):
        assert (type(copied), copied.kind, str(copied)) == (Note, "linear", "too much")
    assert select_notes([note, Note("null", "why")], "null") == ("why",)


@pytest.mark.parametrize(("name", "kinds"), [("published", {"null", "published"}), ("closed-form", {"accuracy"})])
def test_evaluators_say_of_what_kind_their_warnings_are(scene: Scene, name: str, kinds: set[str]) -> None:
    warnings = evaluator(name).evaluate(scene, 1e-3).warnings
    assert kinds <= {note.kind for note in warnings}
    assert all(
        isinstance(text, str) for text in json.loads(json.dumps(evaluator(name).evaluate(scene, 1e-3).as_dict()))["warnings"]
    )


@pytest.mark.parametrize(
    ("name", "kind"), [("closed-form", "95 %"), ("equivalent-inclusion", "bound"), ("axisymmetric", "bound")]
)
def test_results_state_the_errors_of_all_values_and_their_kind(scene: Scene, name: str, kind: str) -> None:
    result = evaluate(scene, name)
    assert result.error_kind == kind
    stated = [field for field in ERROR_FIELDS if not field.startswith("charge")]  # the scene has no film
    assert all(getattr(result, field) > 0 for field in stated)
    assert result.stress_inner_error == result.stress_outer_error == result.error_estimate  # shares of a given force
    raised = result.add_error(0.1)
    assert all(getattr(raised, field) == pytest.approx(1.1 * getattr(result, field) + 0.1) for field in stated)


def test_a_scene_states_the_accuracy_that_holds_where_a_command_names_none(scene: Scene) -> None:
    own = scene.model_copy(update={"reading": scene.reading.model_copy(update={"accuracy": 0.3})})
    results = evaluate(own), evaluate(own, accuracy=0.05), evaluate(scene)
    assert [result.provenance["accuracy"] for result in results if result.provenance] == [0.3, 0.05, 0.01]
