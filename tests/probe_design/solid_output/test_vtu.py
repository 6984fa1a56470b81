"""What ``solid`` writes and draws, of the small meshes of tests/solver/solid/test_elements.py."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import pyvista
from matplotlib.image import imread

from geometry.common.errors import InputError, MissingLibrary
from geometry.tetra.tet_mesh import MeshBody, TetMesh
from probe_design.solid_output import render as solid_space
from probe_design.solid_output.faces import Faces, cut_section, extract_skin, name_region
from probe_design.solid_output.figure import draw_solid
from probe_design.solid_output.stress_panel import deform_section
from probe_design.solid_output.vtu import write_vtu
from solver.materials.linear import Isotropic
from solver.solid.base_states import SolidFields, SolidStates, compute_fields, solve_states
from solver.solid.problem import Problem, Solid
from solver.solid.regions import Region
from tests.support.meshes import body_volumes, stored_mesh
from tests.support.paths import ROOT

DOWN = np.array([1e-5, 1e-5, 0.0])


def material(modulus: float, ratio: float = 0.45) -> Isotropic:
    return Isotropic(modulus, ratio)


MATERIALS = {
    MeshBody.INNER: material(1e6),
    MeshBody.OUTER: material(8e4),
    MeshBody.TISSUE: material(6e3),
    MeshBody.FIRST_INCLUSION: material(6e4),
}  # a groove cut out


def half() -> TetMesh:
    return stored_mesh("probe")


def whole() -> TetMesh:
    """The half and its mirror image; their nodes on the plane stay two, which a picture does not mind."""
    mesh = half()
    mirrored = mesh.elements[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]] + len(mesh.nodes)
    nodes, elements = np.vstack([mesh.nodes, mesh.nodes * (1, -1, 1)]), np.vstack([mesh.elements, mirrored])
    return TetMesh(nodes, elements, np.tile(mesh.body, 2), np.tile(mesh.beyond, 2), np.tile(mesh.layer, 2), half=False)


@cache
def states(frictionless: bool = False) -> SolidStates:
    return solve_states(Problem.assemble(Solid.from_mesh(half(), frictionless), MATERIALS))


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> pyvista.UnstructuredGrid:
    path = write_vtu(tmp_path_factory.mktemp("vtu") / "new folder" / "probe.vtu", states(), DOWN)
    assert [path_found.name for path_found in path.parent.iterdir()] == ["probe.vtu"]
    return pyvista.read(path)


class TestFile:
    def test_bodies_keep_their_volumes_and_names(self, grid: pyvista.UnstructuredGrid) -> None:
        """To rounding; VTK, which takes quadratic tetrahedra as eight flat ones, misses up to 3 % of a sphere this coarse."""
        assert set(grid.celltypes) == {pyvista.CellType.QUADRATIC_TETRA}
        names = dict(zip(grid.field_data["body_number"].tolist(), grid.field_data["body_name"], strict=True))
        assert names == {
            MeshBody.INNER: "inner",
            MeshBody.OUTER: "outer",
            MeshBody.TISSUE: "tissue",
            MeshBody.FIRST_INCLUSION: "inclusion[0]",
        }
        nodes, elements = np.asarray(grid.points), grid.cells.reshape(-1, 11)[:, 1:]
        zeros = np.zeros(len(elements), dtype=np.int64)
        read = TetMesh(nodes, elements, np.asarray(grid["body"]), zeros.astype(bool), zeros, half=True)
        expected = {body: volume for body, volume in body_volumes(half()).items() if body in MATERIALS}
        assert body_volumes(read) == pytest.approx(expected, rel=1e-12)
        vtks = np.abs(grid.compute_cell_sizes(length=False, area=False)["Volume"])
        assert {b: vtks[read.body == b].sum() for b in MATERIALS} == pytest.approx(expected, rel=0.03)

    def test_displacements(self, grid: pyvista.UnstructuredGrid) -> None:
        """Of the tops the motion, of the bottom none, of the plane of symmetry none across it."""
        u, (_, y, z) = grid["displacement"], grid.points.T
        top = z > 0.003 - 1e-9
        assert u[top] == pytest.approx(np.tile([0, 0, -1e-5], (top.sum(), 1)), abs=1e-18)
        assert np.abs(u[z < -0.016 + 1e-9]).max() == 0
        assert np.abs(u[np.abs(y) < 1e-9, 1]).max() == 0

    def test_stresses(self, grid: pyvista.UnstructuredGrid) -> None:
        """Pressure is positive and about the film's; von Mises stress follows from the tensor in VTK's order."""
        inner = grid["body"] == MeshBody.INNER
        volume = np.abs(grid.compute_cell_sizes(length=False, area=False)["Volume"])
        force = grid.field_data["film_forces"][0]
        assert force == pytest.approx(states().forces[0].sum() * 1e-5)
        assert np.average(grid["pressure"][inner], weights=volume[inner]) == pytest.approx(force / (np.pi * 16e-6), rel=0.1)
        assert grid["pressure"] == pytest.approx(-grid["stress"][:, 2])
        tensor = grid["stress"][:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
        deviator = tensor - np.trace(tensor, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        assert grid["von_mises"] == pytest.approx(np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))))
        array = grid.GetCellData().GetAbstractArray("stress")
        assert [array.GetComponentName(i) for i in range(6)] == ["XX", "YY", "ZZ", "XY", "YZ", "XZ"]

    def test_shear_stands_where_vtk_expects_it(self, grid: pyvista.UnstructuredGrid) -> None:
        """About the axis of a probe on the axis xz shear goes with x, yz with y; xy with neither but their product."""
        centre = grid.cell_centers().points
        deep = (grid["body"] == MeshBody.TISSUE) & (np.hypot(*centre[:, :2].T) < 0.008) & (centre[:, 2] > -0.003)
        xz, yz = grid["stress"][deep, 5], grid["stress"][deep, 4]
        assert np.corrcoef(xz, centre[deep, 0])[0, 1] > 0.3
        assert abs(np.corrcoef(yz, centre[deep, 0])[0, 1]) < 0.3

    def test_says_that_it_is_a_half(self, grid: pyvista.UnstructuredGrid) -> None:
        assert grid.field_data["symmetry"][0].startswith("the half y >= 0")
        assert grid.field_data["motion"].tolist() == DOWN.tolist()

    def test_vtks_own_reader(self, tmp_path: Path) -> None:
        from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(write_vtu(tmp_path / "probe.vtu", states(frictionless=True), DOWN)))
        reader.Update()
        assert reader.GetErrorCode() == 0
        assert reader.GetOutput().GetNumberOfCells() == np.isin(half().body, list(MATERIALS)).sum()
        assert reader.GetOutput().GetPointData().HasArray("displacement")


def area(faces: Faces, chosen: np.ndarray) -> float:
    corners = faces.points[faces.triangles[chosen]]
    return float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2)


class TestCut:
    @pytest.mark.parametrize("mesh", [half, whole])
    def test_section(self, mesh: object) -> None:
        """Areas in the plane y = 0; the fields there, the motion at the tops."""
        problem = states().problem if mesh is half else Problem.assemble(Solid.from_mesh(whole()), MATERIALS)
        field_values = compute_fields(states(), DOWN)
        if mesh is not half:
            field_values = replace(
                field_values, displacement=np.tile(field_values.displacement, (2, 1)), stress=np.tile(field_values.stress, (2, 1))
            )
        cut = cut_section(problem, field_values)
        assert np.abs(cut.points[:, 1]).max() < 2e-7
        assert area(cut, cut.body == MeshBody.INNER) == pytest.approx(24e-6, rel=1e-3)
        assert area(cut, cut.body == MeshBody.OUTER) == pytest.approx(2 * 1.9e-3 * 3e-3 - 1.9e-6, rel=1e-3)
        assert area(cut, cut.body == MeshBody.FIRST_INCLUSION) == pytest.approx(np.pi * 2.5e-3**2, rel=0.02)  # a polygon
        top = cut.points[:, 2] > 0.003 - 1e-9
        assert cut.values["displacement"][top, 2] == pytest.approx(-1e-5 * np.ones(top.sum()))
        inner = np.unique(cut.triangles[cut.body == MeshBody.INNER])
        assert 0 < np.median(cut.values["pressure"][inner]) < cut.values["pressure"].max()
        assert cut.lines.max() < len(cut.points)

    def test_a_body_beside_the_plane_is_not_in_the_section(self) -> None:
        mesh = replace(whole(), nodes=whole().nodes + np.array([0, 0.003, 0]))
        still = SolidFields(np.zeros(mesh.nodes.shape), np.zeros((len(mesh.elements), 6)))
        cut = cut_section(Problem.assemble(Solid.from_mesh(mesh), MATERIALS), still)
        assert set(cut.body.tolist()) == {MeshBody.INNER, MeshBody.OUTER, MeshBody.TISSUE}
        assert area(cut, cut.body == MeshBody.INNER) == pytest.approx(3e-3 * 2 * 7**0.5 * 1e-3, rel=0.01)

    def test_skin_closes(self) -> None:
        """The skin's normals add up to nothing, and each side has two triangles."""
        faces = extract_skin(states().problem)
        sides = np.sort(faces.triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
        assert set(np.unique(sides, axis=0, return_counts=True)[1].tolist()) <= {2, 4}
        corners = faces.points[faces.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.abs(normals.sum(axis=0)).max() < 1e-12 * np.abs(normals).sum()

    def test_names(self) -> None:
        bodies = (MeshBody.GROOVE, MeshBody.BEYOND, MeshBody.FIRST_INCLUSION + 1, -1 - MeshBody.FIRST_INCLUSION)
        assert [name_region(body) for body in bodies] == [
            "groove", "tissue beyond", "inclusion[1]", "inclusion[0] beyond",
        ]  # fmt: skip
        layered = [
            Region(MeshBody.TISSUE, 1),
            Region(MeshBody.BEYOND, 2),
            Region(MeshBody.FIRST_INCLUSION, 1),
            Region(MeshBody.FIRST_INCLUSION, 2, True),
        ]
        assert [name_region(region.number) for region in layered] == [
            "tissue.layer[0]", "tissue.layer[1] beyond",
            "inclusion[0] in tissue.layer[0]", "inclusion[0] in tissue.layer[1] beyond",
        ]  # fmt: skip

    @pytest.mark.parametrize(("amount", "factor"), [(1e-6, 200.0), (1e-3, 1.0), (0.0, 1.0)])
    def test_exaggeration(self, amount: float, factor: float) -> None:
        cut = cut_section(states().problem, compute_fields(states(), DOWN * amount / 1e-5))
        shape = deform_section(cut, 4e-4, (-0.01, 0.01, -0.01, 0.004))
        assert shape.factor == factor
        low, high = shape.find_colour_limits(cut.values["pressure"])
        assert cut.values["pressure"].min() <= low <= high <= cut.values["pressure"].max()


def test_importing_loads_nothing_heavy() -> None:
    modules = "probe_design.solid_output.vtu, probe_design.solid_output.evaluate_with_files"
    program = f"import sys, {modules}; print({{'pyvista', 'vtkmodules', 'matplotlib', 'cadquery'}} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "set()"


def drawn(path: Path, given: SolidStates, motion: np.ndarray) -> np.ndarray:
    try:
        return np.asarray(imread(draw_solid(path, given, motion)))
    except MissingLibrary as fault:
        pytest.skip(str(fault))


class TestPicture:
    @pytest.mark.slow
    def test_png(self, tmp_path: Path) -> None:
        """Of its size, with the blocks' colours in the upper left and both colour scales below."""
        picture = drawn(tmp_path / "probe.png", states(), DOWN)
        assert picture.shape == (1344, 1750, 4)
        upper, lower = picture[80:640, :900, :3], picture[760:, :, :3]
        orange = (upper[..., 0] > 1.5 * upper[..., 2]) & (upper[..., 0] > 1.25 * upper[..., 1])
        blue = upper[..., 2] > 1.4 * upper[..., 0]
        assert min(orange.mean(), blue.mean()) > 0.005
        assert (lower.max(axis=-1) < 0.999).mean() > 0.4
        assert len(np.unique((255 * lower).astype(int).reshape(-1, 3), axis=0)) > 1000

    @pytest.mark.slow
    def test_a_whole_that_does_not_move(self, tmp_path: Path) -> None:
        """Cut open at y = 0; nothing to exaggerate, no stress to scale colours by."""
        problem = Problem.assemble(Solid.from_mesh(whole()), MATERIALS)
        still = SolidStates(problem, np.zeros((problem.supports.unknowns, 3)), states().energies)
        picture = drawn(tmp_path / "probe.png", still, np.zeros(3))
        assert picture[..., :3].std() > 0.1

    def test_other_names(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="png"):
            draw_solid(tmp_path / "probe.jpg", states(), DOWN)

    def test_without_opengl(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A renderer that crashes, as VTK does, is an error that names the remedy, and leaves no file."""
        crash = tmp_path / "crash.py"
        crash.write_text("import os, sys\nprint('no libOSMesa. Install it.', file=sys.stderr, flush=True)\nos.abort()\n")
        monkeypatch.setattr(solid_space, "RENDER_PROGRAM", crash)
        with pytest.raises(MissingLibrary, match=r"cannot render \(no libOSMesa\): install OpenGL.*libegl1"):
            draw_solid(tmp_path / "out" / "probe.png", states(), DOWN)
        assert not (tmp_path / "out").exists()
