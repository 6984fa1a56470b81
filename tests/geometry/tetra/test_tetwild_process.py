import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from geometry import SolveError
from geometry.common.cached_arrays import CACHE_VARIABLE
from geometry.mesh_programs.tetwild import tetrahedralize
from geometry.processes import child as child_process
from geometry.processes.child import Failure, TooLong
from geometry.tetra import mesher as volume_mesh
from geometry.tetra.layout import build_layout
from geometry.tetra.sizing import ROUGH_FINENESS
from tests.support.paths import ROOT
from tests.support.scenes import block_scene as scene

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([part for a, b, c, d in SIDES for part in ((a, b, c), (a, c, d))], dtype=np.int32)
POSIX = pytest.mark.skipif(os.name == "nt", reason="signals end processes on POSIX systems only")


def cube(size=0.3):
    return {"vertices": CUBE, "faces": TRIANGLES, "edge_length_abs": np.array(size), "epsilon": np.array(1e-3)}


def volume(points, tetrahedra):
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() / 6


@pytest.fixture
def children(monkeypatch):
    """The processes started, as they start."""
    pids = []

    class Popen(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            pids.append(self)

    monkeypatch.setattr(child_process.subprocess, "Popen", Popen)
    return pids


def end(children, number):
    """End the first process there is, once it runs."""

    def wait():
        while not children:
            time.sleep(0.01)
        time.sleep(0.5)
        children[0].send_signal(number)

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.mark.slow
def test_two_threads_mesh_at_the_same_time():
    with ThreadPoolExecutor(2) as pool:
        for points, tetrahedra in pool.map(lambda size: tetrahedralize(cube(size), 600), (0.3, 0.4)):
            assert volume(points, tetrahedra) == pytest.approx(1, abs=0.01)


def test_what_pytetwild_refuses_is_said():
    with pytest.raises(Failure, match="must all be given"):
        tetrahedralize({**cube(), "bg_vertices": CUBE}, 600)


def test_a_process_that_takes_too_long_is_ended(children):
    with pytest.raises(TooLong, match=r"longer than 0\.3 s"):
        tetrahedralize(cube(0.005), 0.3)
    assert children[0].poll() is not None


def test_a_process_that_cannot_start_is_a_failure(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/none/python")
    with pytest.raises(Failure, match="no process can be started"):
        tetrahedralize(cube(), 600)


@POSIX
def test_a_killed_process_is_a_solve_error(children, monkeypatch):
    monkeypatch.setattr(volume_mesh, "_MAX_TRIALS", 1)
    layout = replace(build_layout(scene(), True, 0.1, None), hole=4.005e-3)  # a gap that is left to pytetwild
    thread = end(children, signal.SIGKILL)
    with pytest.raises(SolveError, match="SIGKILL"):
        volume_mesh.mesh_layout(layout, ROUGH_FINENESS)
    thread.join()


@POSIX
def test_ctrl_c_in_the_child_alone_ends_it_without_a_word(children):
    thread = end(children, signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        tetrahedralize(cube(0.005), 600)
    thread.join()


SCRIPT = """
import sys
from pathlib import Path
from geometry import scene_from_toml
from geometry.tetra.cache import read_or_make_mesh
from geometry.processes import child as child_process
start = child_process.subprocess.Popen.__init__
def started(self, *args, **options):
    start(self, *args, **options)
    print(self.pid, flush=True)
child_process.subprocess.Popen.__init__ = started
try:
    read_or_make_mesh(scene_from_toml(Path(sys.argv[1]).read_text()))
except KeyboardInterrupt:
    sys.exit(42)
"""


@POSIX
def test_ctrl_c_ends_meshing_at_once_and_leaves_nothing(tmp_path):
    from geometry import scene_to_toml

    (tmp_path / "scene.toml").write_text(scene_to_toml(scene()))
    (tmp_path / "script.py").write_text(SCRIPT)
    cache = tmp_path / "cache"
    path = os.pathsep.join([str(ROOT), *sys.path])
    environment = {**os.environ, CACHE_VARIABLE: str(cache), "PYTHONPATH": path}
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "scene.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment) as parent:
        child = int(parent.stdout.readline())
        time.sleep(0.7)
        parent.send_signal(signal.SIGINT)
        _, said = parent.communicate(timeout=100)
    assert (parent.returncode, said) == (42, "")
    assert not cache.exists() or not list(cache.iterdir())
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
