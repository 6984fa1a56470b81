import shutil

import numpy as np
import pytest

from geometry.common.cached_arrays import CACHE_VARIABLE, find_cache_folder
from geometry.tetra import cache as mesh_cache
from geometry.tetra.sizing import COARSE_FINENESS, FINE_FINENESS
from geometry.tetra.tet_mesh import TetMesh, build_quadratic
from tests.support.scenes import block_scene as scene


@pytest.fixture
def made(monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    calls = []

    def mesh_layout(layout, fineness):
        calls.append(fineness)
        nodes, elements, _ = build_quadratic(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
        return TetMesh(nodes, elements, np.array([len(calls)]), np.array([False]), np.array([0]), layout.half), None

    monkeypatch.setattr(mesh_cache, "mesh_layout", mesh_layout)
    return calls


def files():
    return list(find_cache_folder("meshes").iterdir())


def test_a_mesh_is_made_once(made):
    first, second = (mesh_cache.read_or_make_mesh(scene(), half=True) for _ in range(2))
    assert len(made) == 1
    assert second.half
    for name in ("nodes", "elements", "body", "beyond", "layer"):
        assert (getattr(first, name) == getattr(second, name)).all()


def test_other_bodies_and_sizes_are_other_meshes(made):
    mesh_cache.read_or_make_mesh(scene())
    mesh_cache.read_or_make_mesh(scene(), FINE_FINENESS)
    mesh_cache.read_or_make_mesh(scene(), half=True)
    mesh_cache.read_or_make_mesh(scene(), reference_radius=0.02)
    mesh_cache.read_or_make_mesh(scene(placement={"x": "1 um"}))
    assert len(made) == len(files()) == 5


def test_what_the_mesh_does_not_depend_on_makes_no_other(made):
    mesh_cache.read_or_make_mesh(scene())
    mesh_cache.read_or_make_mesh(scene(load={"force": "2 N"}), COARSE_FINENESS)
    assert len(made) == 1


def test_who_meshes_the_same_at_the_same_time_uses_the_mesh_of_the_first(made, monkeypatch):
    """While one meshes another begins and ends; both go on with the mesh that the next one will read."""
    mesh_layout, quick = mesh_cache.mesh_layout, []

    def overtaken(layout, fineness):
        mesh = mesh_layout(layout, fineness)
        if len(made) == 1:
            quick.append(mesh_cache.read_or_make_mesh(scene()))
        return mesh

    monkeypatch.setattr(mesh_cache, "mesh_layout", overtaken)
    slow, later = mesh_cache.read_or_make_mesh(scene()), mesh_cache.read_or_make_mesh(scene())
    assert [mesh.body[0] for mesh in (quick[0], slow, later)] == [2, 2, 2]
    assert len(made) == 2


@pytest.fixture
def package(monkeypatch, tmp_path):
    """A copy of the package's sources in their place."""
    copy = shutil.copytree(mesh_cache.SOURCE_FOLDER, tmp_path / "tetra", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(mesh_cache, "SOURCE_FOLDER", copy)
    yield copy
    mesh_cache.compute_source_digest.cache_clear()


def digest():
    mesh_cache.compute_source_digest.cache_clear()
    return mesh_cache.compute_source_digest()


def test_a_change_of_any_source_makes_other_meshes(package):
    known = {digest()}
    (package / "body_layout.py").rename(package / "moved.py")
    known.add(digest())
    for path in sorted(package.iterdir()):
        path.write_bytes(path.read_bytes() + b"#")
        known.add(digest())
    assert len(known) == 2 + len(list(package.iterdir())) > 10


def test_meshes_of_other_sources_are_not_taken(made, package):
    digest()
    mesh_cache.read_or_make_mesh(scene())
    (package / "smoothing.py").unlink()
    mesh_cache.read_or_make_mesh(scene())
    assert len(made) == 1  # read once a process: what runs is what was imported
    digest()
    mesh_cache.read_or_make_mesh(scene())
    assert len(made) == len(files()) == 2


@pytest.mark.parametrize("damage", [lambda c: c[:-7], lambda c: b"", lambda c: c[:100] + b"!" + c[101:]])
def test_a_damaged_file_is_made_again(made, damage):
    mesh_cache.read_or_make_mesh(scene())
    (file,) = files()
    file.write_bytes(damage(file.read_bytes()))
    assert mesh_cache.read_or_make_mesh(scene()).body[0] == 2
    assert mesh_cache.read_or_make_mesh(scene()).body[0] == 2


def test_a_folder_that_cannot_be_written_costs_time_only(made, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    assert mesh_cache.read_or_make_mesh(scene()).body[0] == 1
    assert mesh_cache.read_or_make_mesh(scene()).body[0] == 2
