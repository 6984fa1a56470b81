import math
import os
from dataclasses import replace

import numpy as np
import pytest
import pyvista

from geometry import InputError, Refusal, SolveError
from geometry.common.resources import LimitReached, Limits, start_clock, use_limits
from geometry.processes.child import Failure, TooLong
from geometry.tetra import surface_files
from geometry.tetra.layout import build_layout
from geometry.tetra.mesh_check import check_mesh, compute_errors, find_max_file_error
from geometry.tetra.mesher import mesh_layout
from geometry.tetra.sizing import ROUGH_FINENESS
from geometry.tetra.surface_files import Sheet, read_surface
from geometry.tetra.tet_mesh import MeshBody, TetMesh, build_quadratic
from tests.support.meshes import body_volumes
from tests.support.scenes import block_scene as scene
from tests.support.slow import slow_unless

CENTRE = np.array([0.002, 0.0, -0.009])


def ball(radius=3.0, centre=(0.0, 0.0, 0.0)):
    return pyvista.Icosphere(radius=radius, center=centre, nsub=2)


def saved(tmp_path, mesh, name="tumour.stl"):
    mesh.save(tmp_path / name)
    return str(tmp_path / name)


SOFT = {"youngs_modulus": "60 kPa", "poisson_ratio": 0.45}


def mesh_with(volume):
    """A mesh of one tetrahedron, which is all that there is of the inclusion."""
    corners = np.vstack([np.zeros(3), np.eye(3) * (6 * volume) ** (1 / 3)])
    nodes, elements, _ = build_quadratic(corners, np.array([[0, 1, 2, 3]]))
    return TetMesh(nodes, elements, np.array([MeshBody.FIRST_INCLUSION]), np.array([False]), np.array([1]), False)


def with_file(path, *others, depth="9 mm", x="2 mm"):
    return scene(inclusion=[*others, {"surface": path, "depth": depth, "x": x, **SOFT}])


def test_a_files_coordinates_are_millimetres_from_the_inclusions_centre(tmp_path):
    sheet = read_surface(saved(tmp_path, ball()), "inclusion[0].surface", CENTRE)
    assert sheet.is_closed
    assert sheet.points.mean(axis=0) == pytest.approx(CENTRE, abs=1e-5)
    assert sheet.volume == pytest.approx(4 / 3 * math.pi * 0.003**3, rel=0.05)
    assert sheet.is_inside(CENTRE + np.array([[0, 0, 0.0029], [0, 0, 0.0031]]) * 0.98).tolist() == [True, False]


@pytest.mark.slow
def test_a_step_file_says_its_unit(tmp_path):
    from geometry.cad.solids import load_cadquery

    cq = load_cadquery()
    name = str(tmp_path / "box.step")
    cq.exporters.export(cq.Workplane().box(4, 5, 6), name)
    sheet = read_surface(name, "inclusion[0].surface", CENTRE)
    assert sheet.volume == pytest.approx(120e-9)
    assert sheet.is_closed


@pytest.mark.slow
def test_a_surface_of_very_many_triangles_is_meshed_by_fewer_and_else_as_it_is(tmp_path, monkeypatch):
    """pytetwild takes minutes for 80 000 triangles, and no longer for 10 000 than for a thousand."""
    scanned = with_file(saved(tmp_path, pyvista.Icosphere(radius=3.0, nsub=5)), depth="9 mm")
    given = {}

    def noted(arrays, patience):
        given.update(arrays)
        raise Failure("enough")

    monkeypatch.setattr("geometry.tetra.irregular_mesh.tetrahedralize", noted)
    layout = build_layout(scanned, False, 0.02, None)
    with pytest.raises(SolveError, match="enough"):
        mesh_layout(layout, ROUGH_FINENESS)
    (sheet,) = layout.inclusions
    assert len(sheet.triangles) == 20_480  # which labels, nodes and checks go by
    assert len(sheet.fewer.triangles) == 10_000
    assert 10_000 < len(given["faces"]) < 30_000
    points = sheet.centre + np.random.default_rng(0).uniform(-0.0035, 0.0035, (400, 3))
    clear = np.abs(np.linalg.norm(points - sheet.centre, axis=1) - 0.003) > 2 * sheet.decimation_error
    assert (sheet.fewer.is_inside(points) == (np.linalg.norm(points - sheet.centre, axis=1) < 0.003))[clear].all()


def test_where_time_is_over_an_uneven_surface_of_very_many_triangles_is_named(tmp_path, monkeypatch):
    def late(arrays, patience):
        raise TooLong("it took longer")

    monkeypatch.setattr("geometry.tetra.irregular_mesh.tetrahedralize", late)
    layout = build_layout(with_file(saved(tmp_path, ball())), False, 0.02, None)
    (sheet,) = layout.inclusions
    uneven = replace(sheet, triangles=np.tile(sheet.triangles, (70, 1)))
    with (
        use_limits(Limits(seconds=1e-6)),
        start_clock(),
        pytest.raises(LimitReached, match=r"22400 triangles too uneven.*a smoother one"),
    ):
        mesh_layout(replace(layout, inclusions=(uneven,)), ROUGH_FINENESS)


@pytest.mark.slow
def test_distances_to_a_ball_of_very_many_triangles_are_nearly_right(tmp_path):
    sheet = read_surface(saved(tmp_path, pyvista.Icosphere(radius=3.0, nsub=6)), "inclusion[0].surface", CENTRE)
    points = CENTRE + np.random.default_rng(0).normal(0.0, 0.003, (5000, 3))
    right = np.abs(np.linalg.norm(points - CENTRE, axis=1) - 0.003)
    assert (sheet.estimate_distance(points) <= 1.1 * right + 5e-5).all()
    assert (sheet.estimate_distance(points) >= right - 1e-5).all()


def test_what_the_volume_of_a_body_from_a_file_is_off_is_known(tmp_path):
    layout = build_layout(with_file(saved(tmp_path, ball())), False, 0.02, None)
    (sheet,) = layout.inclusions
    assert [find_max_file_error(mesh_with(share * sheet.volume), layout) for share in (1.0, 0.9)] == pytest.approx(
        [0.0, 0.1], abs=1e-9
    )
    assert find_max_file_error(mesh_with(1e-9), build_layout(scene(), False, 0.02, None)) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["inverted and crossing", "hole"])
def test_dirty_surfaces_are_meshed(tmp_path, fault):
    whole = ball()
    if fault == "hole":
        dirty = whole.remove_cells([5])
    else:
        merged = whole.merge(ball(2.0, (2.5, 0.0, 0.0)), merge_points=False).extract_surface(algorithm="dataset_surface")
        dirty = merged.flip_faces()
    layout = build_layout(with_file(saved(tmp_path, dirty)), False, 0.02, None)
    mesh, _ = mesh_layout(layout, ROUGH_FINENESS)
    volume = body_volumes(mesh)[MeshBody.FIRST_INCLUSION]
    min_volume = whole.volume * 1e-9
    assert min_volume * 0.97 < volume < (1.02 if fault == "hole" else 1.5) * min_volume
    assert max(abs(e) for name, e in compute_errors(mesh, layout).items() if "inclusion" not in name) < 0.01
    leaking = replace(mesh, body=np.where(mesh.body == MeshBody.FIRST_INCLUSION, MeshBody.TISSUE, mesh.body))
    with pytest.raises(SolveError, match=r"inclusion\[0\]'s volume.* it is open" if fault == "hole" else r"triangles may cross"):
        check_mesh(leaking, layout)


def test_what_has_no_inside_is_refused(tmp_path):
    half = ball().clip("z").extract_surface(algorithm="dataset_surface").triangulate()
    with pytest.raises(InputError, match="open"):
        read_surface(saved(tmp_path, half), "inclusion[0].surface", CENTRE)


@pytest.mark.parametrize(
    ("name", "content"),
    slow_unless(
        lambda case: case[0] != "bad.step",
        [("none.stl", None), ("tumour.obj", "v"), ("bad.stl", "nonsense"), ("bad.step", "x")],
    ),
)
def test_files_that_cannot_be_read_are_refused(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=r"inclusion\[0\].surface"):
        read_surface(str(tmp_path / name), "inclusion[0].surface", CENTRE)


@pytest.mark.skipif(os.name == "nt", reason="signals end processes on POSIX systems only")
@pytest.mark.parametrize(
    ("body", "message"), [("os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"), ("time.sleep(1000)", r"longer than 0\.5 s")]
)
def test_a_file_that_kills_its_reader_or_is_read_without_an_end_is_refused(tmp_path, monkeypatch, body, message):
    """As OpenCASCADE does over some damaged STEP files."""
    reader = tmp_path / "reader.py"
    reader.write_text(f"import os, signal, time\ndef run(arguments):\n    {body}\n")
    monkeypatch.setattr(surface_files, "_READER_PROGRAM", reader)
    monkeypatch.setattr(surface_files, "_READ_TIME_LIMIT_S", 0.5 if "sleep" in body else 60.0)
    (tmp_path / "body.step").write_text(body)  # no file that was read before
    with pytest.raises(InputError, match=rf"inclusion\[0\]\.surface.*that can be read.*{message}"):
        read_surface(str(tmp_path / "body.step"), "inclusion[0].surface", CENTRE)


@pytest.mark.parametrize(
    ("depth", "x", "left"), [("2 mm", "0 mm", "top"), ("38 mm", "0 mm", "bottom"), ("9 mm", "28 mm", "side")]
)
def test_a_file_that_leaves_the_tissue_is_refused(tmp_path, depth, x, left):
    with pytest.raises(Refusal, match=rf"inclusion\[0\]\.surface.*leaves its {left}"):
        build_layout(with_file(saved(tmp_path, ball()), depth=depth, x=x), False, 0.1, None)


@pytest.mark.parametrize(
    ("ellipsoid", "is_separate"),
    [
        ({"diameter": "4 mm", "x": "6.9 mm"}, False),
        ({"diameter": "4 mm", "x": "7.1 mm"}, True),
        ({"diameter": "1 mm", "x": "2 mm"}, False),
        ({"diameters": ["40 mm", "1 mm", "1 mm"], "x": "0 mm"}, False),
        ({"diameters": ["6 mm", "1 mm", "1 mm"], "x": "8.1 mm"}, True),
    ],
)
def test_a_file_that_overlaps_an_ellipsoid_is_refused(tmp_path, ellipsoid, is_separate):
    scanned = with_file(saved(tmp_path, ball()), {"depth": "9 mm", **SOFT, **ellipsoid})
    if is_separate:
        assert len(build_layout(scanned, False, 0.1, None).inclusions) == 2
    else:
        with pytest.raises(Refusal, match=r"inclusion\[1\]\.surface.*overlaps or touches inclusion\[0\]"):
            build_layout(scanned, False, 0.1, None)


@pytest.mark.parametrize(("radius", "x", "is_separate"), [(2.0, 4.8, False), (2.0, 5.2, True), (1.0, 0.0, False)])
def test_files_that_overlap_are_refused(tmp_path, radius, x, is_separate):
    second = {"surface": saved(tmp_path, ball(radius), "other.stl"), "depth": "9 mm", "x": f"{2 + x} mm", **SOFT}
    scanned = with_file(saved(tmp_path, ball()), second)
    if is_separate:
        assert len(build_layout(scanned, False, 0.1, None).inclusions) == 2
    else:
        with pytest.raises(Refusal, match=r"inclusion\[1\]\.surface.*inclusion\[0\]"):
            build_layout(scanned, False, 0.1, None)


def test_distances_to_triangles_are_those_of_many_points_on_them():
    corners = np.random.default_rng(3).normal(size=(50, 3, 3)) + np.array([0.3, 0, 0])
    a, b = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 150), np.linspace(0, 1, 150)))
    share = np.column_stack([a, b, 1 - a - b])[a + b <= 1]
    sampled = np.linalg.norm(np.einsum("sk,tkj->tsj", share, corners), axis=2).min(axis=1)
    sheets = [Sheet(triangle, np.array([[0, 1, 2]]), np.zeros(3)) for triangle in corners]
    distances = np.array([np.linalg.norm(sheet.find_nearest(np.zeros((1, 3)))) for sheet in sheets])
    assert distances == pytest.approx(sampled, abs=0.02)
    assert (distances <= sampled + 1e-12).all()
