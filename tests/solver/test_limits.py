"""Scenes that ran for minutes or took 17 GB are refused before there is a mesh, with the limit and the option that raises it."""

import json
import tracemalloc

import numpy as np
import pytest

from geometry import InputError, read_scene, scene_to_toml
from geometry.common.resources import LimitReached, Limits, start_clock, use_limits
from geometry.tetra import mesher
from solver import automatic, evaluate, evaluators
from solver.axisymmetric import converged_forces
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.refinement import SampleErrors
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.linalg.workspace import Workspace, measure_bytes
from solver.multiple_scattering import boundary_samples, solve
from solver.multiple_scattering.boundary_samples import ModeSamples
from solver.results.warnings import Note, select_notes
from solver.solid import film_forces
from tests.support.paths import REFERENCE, SCENE
from tests.support.program import run


def flat(**film):
    """A flat ellipsoid on the probe's axis."""
    scene = read_scene(SCENE).model_dump(exclude_unset=True)
    body = {"diameters": ("16 mm", "16 mm", "1 mm"), "depth": "8 mm", "youngs_modulus": "600 kPa", "poisson_ratio": 0.45}
    return scene | {"inclusion": [body | {"target": True}], "probe": scene["probe"] | film, "load": {"force": "10 uN"}}


def beside_a_needle():
    needle = {"diameters": ("10.9 mm", "0.36 mm", "0.8 mm"), "depth": "0.45 mm", "x": "9 mm"}
    scene = flat()
    body = needle | {"youngs_modulus": "30 kPa", "poisson_ratio": 0.45}
    return scene | {"inclusion": [*scene["inclusion"], body]}


FILMS = {"film": {"thickness": "22 um", "youngs_modulus": "1 MPa"}}


@pytest.mark.parametrize(
    "scene", [pytest.param(beside_a_needle(), id="needle"), pytest.param(flat(**FILMS), id="films", marks=pytest.mark.slow)]
)
def test_a_mesh_too_large_is_refused_before_it_is_made(scene, monkeypatch):
    for name in ("mesh_regular_layout", "_try_mesher"):
        monkeypatch.setattr(mesher, name, lambda *_: pytest.fail("it was meshed"))
    scene = type(read_scene(SCENE)).model_validate(scene)
    with pytest.raises(LimitReached, match=r"memory = 2 GB: allowed: \d.*unknowns \(--memory"):
        evaluate(scene)
    with pytest.raises(LimitReached, match=r"time = 0\.01 s.*--time"):
        evaluate(scene, limits=Limits(memory=1e12, seconds=0.01))


def test_a_missing_surface_is_noticed_before_anything_is_computed(monkeypatch):
    scene = read_scene(SCENE)
    body = scene.inclusion[0].model_copy(update={"diameter": None, "surface": "none.stl"})
    for module, name in ((evaluators, "evaluator"), (automatic, "evaluator"), (automatic, "build_allowed_plan")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("work began"))
    for name in ("auto", "solid"):
        with pytest.raises(InputError, match=r"inclusion\[0\].surface.*exists"):
            evaluate(scene.model_copy(update={"inclusion": (body,)}), name)


def test_the_command_line_raises_and_lowers_the_limits(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(scene_to_toml(read_scene(SCENE)))
    refused = run("evaluate", path, "--memory", "100 MB")
    assert (refused.returncode, refused.stderr.count("memory = 0.1 GB: allowed:")) == (2, 1)
    assert json.loads(run("evaluate", path, "--memory", "3 GB", "--time", "5 min", "--json").stdout)["ratio"] > 0
    wrong = run("evaluate", path, "--time", "5")
    assert (wrong.returncode, "time = '5'" in wrong.stderr) == (2, True)


@pytest.mark.slow
def test_a_finer_mesh_that_the_limits_forbid_leaves_the_answer_of_two(monkeypatch):
    scene = read_scene(REFERENCE / "solid" / "groove-on-axis.toml")
    said = []

    def forbidden(domain, fineness):
        if fineness is film_forces.FINE_FINENESS:
            raise LimitReached("memory", "2 GB", "more")

    monkeypatch.setattr(film_forces, "is_meshed", lambda *_: False)
    monkeypatch.setattr(film_forces, "check_mesh", forbidden)
    monkeypatch.setattr(film_forces, "_may_improve", lambda *_: True)
    two = evaluate(scene, "solid", 0.01, said.append)
    assert two.error_estimate < 0.02
    assert any("no finer mesh: memory = " in note for note in two.warnings)
    assert "meshing more finely" not in said


def lattice(side):
    """The example's scene over a lattice of small spheres."""
    scene = read_scene(SCENE)
    offsets = 4e-3 * (np.arange(side) - (side - 1) / 2)
    bodies = [
        scene.inclusion[0].model_copy(update={"diameter": 1.5e-3, "x": x, "y": y, "depth": z})
        for x in offsets.tolist()
        for y in offsets.tolist()
        for z in (offsets + 3e-3 - offsets[0]).tolist()
    ]
    return scene.model_copy(update={"inclusion": tuple(bodies)})


def held(work):
    """The most bytes that Python and numpy hold at once."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_the_closed_form_of_many_spheres_holds_what_a_few_hold():
    """Every sphere's moments beside all others' were 2 GB for 343."""
    small, large = lattice(2), lattice(4)
    closed_form = evaluators.evaluator("closed-form")
    closed_form.evaluate(small, 0.01)  # what is imported and kept
    assert held(lambda: closed_form.evaluate(large, 0.01)) < 1.5 * held(lambda: closed_form.evaluate(small, 0.01))


def reflections(scene, limits=None):
    """Read the scene's tumours with all that comes back to them."""
    with use_limits(limits), start_clock():
        return compute_readings(EquivalentInclusion().prepare(scene, 0.01), Tumours.from_scene(scene), reflect=True)


def test_reflections_of_many_tumours_are_refused_before_they_begin(monkeypatch):
    monkeypatch.setattr(boundary_samples, "Table", lambda *_: pytest.fail("they began"))
    with pytest.raises(LimitReached, match=r"memory = 0\.4 GB: allowed: .* reflections of 125 tumours \(fewer .*--memory"):
        reflections(lattice(5), Limits(memory=0.4e9))


def test_what_reflections_will_hold_is_known(monkeypatch):
    kept, texts = [], []
    monkeypatch.setattr(boundary_samples, "check_memory", lambda _, text: texts.append(text))
    works = ModeSamples.compute_works

    def seen(self, weights):
        done = works(self, weights)
        kept.append(measure_bytes([[sampler.table for sampler in samplers] for samplers in self._samplers]))
        return done

    monkeypatch.setattr(ModeSamples, "compute_works", seen)
    reflections(lattice(2))
    assert texts[0] == pytest.approx(max(kept), rel=0.2)


def test_the_time_that_tumours_answer_each_other_is_known_from_the_first_few(monkeypatch):
    clock = iter(range(0, 10**6, 100))
    monkeypatch.setattr(solve, "perf_counter", lambda: next(clock))
    with pytest.raises(LimitReached, match=r"time = 120 s: .* reflections of 27 tumours \(fewer .* takes 2[0-9]* s more"):
        reflections(lattice(3), Limits())


@pytest.mark.slow
def test_what_a_limit_stopped_says_so_and_is_answered_anew_within_another():
    scene = read_scene(SCENE).model_copy(update={"inclusion": ()})
    evaluator = EquivalentInclusion(workspace=Workspace(1e9))
    with use_limits(Limits(memory=0.5e9)):
        rough = evaluator.evaluate(scene, 2e-5)
    assert rough.error_estimate > 2e-5
    assert [note.kind for note in rough.warnings if note.kind != "sensitivity"] == ["limit", "accuracy"]
    fine = evaluator.evaluate(scene, 2e-5)  # in the same workspace, which keeps the rough answer's probe
    assert fine.error_estimate < 2e-5
    assert abs(fine.ratio / rough.ratio - 1) <= fine.error_estimate + rough.error_estimate
    assert not select_notes(fine.warnings, "limit")


def test_a_rough_log_sensitivity_names_the_limit_too(monkeypatch):
    scene = read_scene(SCENE)
    fine = evaluate(scene, "axisymmetric", 1e-2)
    rough = np.array([5e-3 * abs(fine.log_sensitivity) * 20])
    stopped = Note("limit", "memory = 0.5 GB")

    def refined(solve, *_, **__):
        sample = solve(converged_forces.MESH_LEVELS[1])
        return sample, SampleErrors(1e-6 * np.abs(sample.totals), rough[:, None]), stopped

    monkeypatch.setattr(converged_forces, "refine", refined)
    result = Axisymmetric(workspace=Workspace(1e9)).evaluate(scene, 1e-2)
    assert result.error_estimate < 1e-2
    assert [note.kind for note in result.warnings][:2] == ["limit", "sensitivity"]
