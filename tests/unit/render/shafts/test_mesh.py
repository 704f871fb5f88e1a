import math
from pathlib import Path

import pytest
import torch

from render.errors import MissingExtraError, SceneError
from render.shafts.mesh import Mesh, check_extra_installed, make_mesh, place_mesh, read_obj
from tests.support.shared_data import shared_file

CORNERS = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])


def test_triangles_of_no_area_are_left_out() -> None:
    mesh = make_mesh(CORNERS, torch.tensor([[0, 1, 2], [0, 1, 3], [0, 0, 2]]))
    assert mesh.triangles.tolist() == [[0, 1, 2]]
    with pytest.raises(SceneError, match="area above 0"):
        make_mesh(CORNERS, torch.tensor([[0, 1, 3]]))


@pytest.mark.parametrize(
    ("vertices", "triangles", "words"),
    [
        (CORNERS, [[0, 1, 4]], "names vertex 4 of 4"),
        (CORNERS, [[0, 1, -1]], "names vertex -1"),
        (CORNERS * math.nan, [[0, 1, 2]], "finite vertices"),
        (CORNERS[:, :2], [[0, 1, 2]], "expected vertices"),
    ],
)
def test_what_is_no_mesh_is_refused(vertices: torch.Tensor, triangles: list[list[int]], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Mesh(vertices, torch.tensor(triangles), name="thing")


def test_a_mesh_turns_as_the_azimuth_does() -> None:
    mesh = make_mesh(torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), torch.tensor([[0, 1, 2]]))
    placed = place_mesh(mesh, scale=2.0, turn=math.pi / 2.0, offset=(10.0, 0.0, 0.0))
    # North turns to east by a quarter clockwise.
    torch.testing.assert_close(placed.vertices[0], torch.tensor([12.0, 0.0, 0.0]), atol=1e-6, rtol=0.0)
    with pytest.raises(SceneError, match="positive scale"):
        place_mesh(mesh, scale=0.0, offset=(0.0, 0.0, 0.0))


def test_an_obj_file_is_read_with_its_y_axis_up(tmp_path: Path) -> None:
    path = tmp_path / "triangle.obj"
    path.write_text("v 1 2 3\nv 4 5 6\nv 7 8 10\nv 0 0 1\nf 1 2 3\nf 1 2 3 4\n")
    mesh = read_obj(path)
    assert len(mesh.triangles) == 3
    assert [1.0, -3.0, 2.0] in mesh.vertices.tolist()
    assert [1.0, 2.0, 3.0] in read_obj(path, y_up=False).vertices.tolist()


@pytest.mark.parametrize("text", ["", "not an obj", "v 1 2 3\n", "v 1 2 3\nf 1 2 3\n"])
def test_a_file_without_triangles_is_an_error_with_its_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.obj"
    path.write_text(text)
    with pytest.raises(SceneError, match=r"broken\.obj"):
        read_obj(path)
    with pytest.raises(SceneError, match=r"gone\.obj: no such file"):
        read_obj(tmp_path / "gone.obj")


def test_a_mesh_with_holes_is_read() -> None:
    mesh = read_obj(shared_file("meshes/mountain.obj"))
    assert len(mesh.triangles) > 50_000
    assert float(mesh.vertices[:, 2].min()) > 0.0


def test_a_missing_module_is_told_with_its_extra() -> None:
    check_extra_installed("torch")
    with pytest.raises(MissingExtraError, match=r"pip install .*cloudfit\[shafts\]"):
        check_extra_installed("no_such_module")
