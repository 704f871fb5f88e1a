import math

import pytest
import torch

from render.errors import SceneError
from render.shafts.casters import (
    join_meshes,
    make_box,
    make_columns,
    make_ground,
    make_height_field,
    make_ridge,
    make_sphere,
    make_window,
)
from render.shafts.mesh import Mesh
from render.shafts.ray_casting import RayCaster


def enclosed_volume(mesh: Mesh) -> float:
    """By the divergence theorem; the sign tells which way the triangles face."""
    a, b, c = mesh.vertices.double()[mesh.triangles].unbind(1)
    return float((a * torch.linalg.cross(b, c)).sum() / 6.0)


def test_volumes_are_those_of_the_shapes() -> None:
    assert abs(enclosed_volume(make_box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)))) == pytest.approx(6.0, rel=1e-6)
    assert abs(enclosed_volume(make_sphere((1.0, 2.0, 3.0), 2.0, 96))) == pytest.approx(
        4.0 / 3.0 * math.pi * 8.0, rel=2e-3
    )
    assert abs(enclosed_volume(make_sphere((0.0, 0.0, 0.0), 2.0, 6))) < 0.95 * 4.0 / 3.0 * math.pi * 8.0


def test_light_passes_the_panes_of_a_window_and_nothing_else() -> None:
    window = make_window(2.0, 1.0, (2, 1), 0.1, (1.0, 0.5, 0.5), 0.2)
    caster = RayCaster((window,))
    x = torch.tensor([0.0, 0.5, -0.5, 1.5, 0.5, 0.5])
    z = torch.tensor([1.0, 1.0, 1.0, 1.0, 0.2, 1.8])
    origin = torch.stack([x, torch.full_like(x, -5.0), z], dim=1)
    north = torch.tensor([0.0, 1.0, 0.0]).expand_as(origin)
    through = torch.isinf(caster.find_distance(origin, north))
    assert through.tolist() == [False, True, True, False, False, False]


def test_columns_stand_in_a_row_about_the_origin() -> None:
    columns = make_columns(3, 4.0, 0.5, 6.0)
    caster = RayCaster((columns,))
    x = torch.tensor([-4.0, -2.0, 0.0, 2.0, 4.0, 8.0])
    origin = torch.stack([x, torch.full_like(x, -9.0), torch.full_like(x, 3.0)], dim=1)
    found = caster.find_distance(origin, torch.tensor([0.0, 1.0, 0.0]).expand_as(origin))
    assert torch.isinf(found).tolist() == [False, True, False, True, False, True]
    assert float(found[0]) == pytest.approx(8.5, abs=0.01)


def test_terrain_has_its_heights_at_its_places() -> None:
    heights = torch.tensor([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    field = make_height_field(heights, (10.0, 20.0), 2.0)
    caster = RayCaster((field,))
    origin = torch.tensor([[11.999, 21.999, 50.0], [13.999, 20.001, 50.0]])
    found = 50.0 - caster.find_distance(origin, torch.tensor([0.0, 0.0, -1.0]).expand_as(origin))
    torch.testing.assert_close(found, torch.tensor([4.0, 2.0]), atol=0.01, rtol=0.0)


def test_a_ridge_is_as_high_as_asked_and_its_own_for_each_seed() -> None:
    ridge = make_ridge(1000.0, 400.0, 120.0, samples=64)
    assert 60.0 < float(ridge.vertices[:, 2].max()) <= 120.0
    assert float(ridge.vertices[:, 2].min()) == 0.0
    assert torch.equal(ridge.vertices, make_ridge(1000.0, 400.0, 120.0, samples=64).vertices)
    assert not torch.equal(ridge.vertices, make_ridge(1000.0, 400.0, 120.0, samples=64, seed=4).vertices)


def test_sizes_without_meaning_are_refused() -> None:
    with pytest.raises(SceneError):
        make_box((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(SceneError):
        make_sphere((0.0, 0.0, 0.0), -1.0)
    with pytest.raises(SceneError):
        make_columns(0, 1.0, 1.0, 1.0)
    with pytest.raises(SceneError, match="no opening"):
        make_window(1.0, 1.0, (11, 1), 0.1, (1.0, 1.0, 1.0), 0.1)
    with pytest.raises(SceneError):
        make_ground(0.0)
    with pytest.raises(SceneError):
        make_height_field(torch.zeros(1, 3), (0.0, 0.0), 1.0)
    with pytest.raises(SceneError):
        make_ridge(1.0, -1.0, 1.0)
    with pytest.raises(SceneError):
        join_meshes([], "nothing")
