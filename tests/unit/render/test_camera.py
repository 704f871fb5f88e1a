"""Rays of both cameras, the compass, and frames around a volume."""

import math

import pytest
import torch

from render.camera import (
    MAXIMUM_PIXELS,
    OrthographicCamera,
    PinholeCamera,
    direction_from_angles,
    frame_volume,
    unit_direction,
)
from render.density_grid import DensityGrid
from render.errors import CameraError, ParameterError
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from tests.support.volumes import uniform_box

ORIGIN, NORTH = (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
RIGHT_ANGLE = math.radians(90.0)
Camera = PinholeCamera | OrthographicCamera


def looking_north(width: int, height: int) -> list[Camera]:
    return [
        PinholeCamera(ORIGIN, NORTH, RIGHT_ANGLE, width, height),
        OrthographicCamera(ORIGIN, NORTH, 2.0, width, height),
    ]


def image_positions(camera: Camera) -> torch.Tensor:
    """Where the rays of a camera at the origin that looks north cross the plane y = 1, `(height, width, 2)` as x, z."""
    origin, direction = camera.rays()
    crossing = origin + direction * ((1.0 - origin[:, 1]) / direction[:, 1])[:, None]
    return crossing[:, ::2].reshape(camera.height, camera.width, 2)


@pytest.mark.parametrize(
    ("azimuth_deg", "elevation_deg", "expected"),
    [
        (0.0, 0.0, (0.0, 1.0, 0.0)),
        (90.0, 0.0, (1.0, 0.0, 0.0)),
        (180.0, 0.0, (0.0, -1.0, 0.0)),
        (270.0, 0.0, (-1.0, 0.0, 0.0)),
        (33.0, 90.0, (0.0, 0.0, 1.0)),
        (45.0, -30.0, (math.sqrt(0.375), math.sqrt(0.375), -0.5)),
    ],
)
def test_azimuth_runs_clockwise_from_north(
    azimuth_deg: float, elevation_deg: float, expected: tuple[float, float, float]
) -> None:
    found = direction_from_angles(math.radians(azimuth_deg), math.radians(elevation_deg))
    assert found == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("camera", looking_north(4, 2))
def test_pixel_centres_with_row_0_on_top_and_east_on_the_right(camera: Camera) -> None:
    across = torch.tensor([-1.5, -0.5, 0.5, 1.5]).expand(2, 4)
    up = torch.tensor([[0.5], [-0.5]]).expand(2, 4)
    torch.testing.assert_close(image_positions(camera), torch.stack([across, up], dim=-1))
    assert not torch.allclose(image_positions(camera).flip(0), torch.stack([across, up], dim=-1))


@pytest.mark.parametrize("camera", looking_north(1, 1))
def test_one_pixel_looks_straight_ahead(camera: Camera) -> None:
    origin, direction = camera.rays()
    assert origin.tolist() == [[0.0, 0.0, 0.0]]
    torch.testing.assert_close(direction, torch.tensor([NORTH]))


@pytest.mark.parametrize("camera", looking_north(5, 3))
def test_directions_are_unit_vectors_of_single_precision(camera: Camera) -> None:
    origin, direction = camera.rays()
    assert origin.shape == direction.shape == (15, 3)
    assert origin.dtype == direction.dtype == torch.float32
    torch.testing.assert_close(torch.linalg.vector_norm(direction, dim=-1), torch.ones(15))


@pytest.mark.parametrize("camera", looking_north(7, 5))
def test_directions_at_points_are_those_of_the_rays(camera: Camera) -> None:
    origin, direction = camera.rays()
    torch.testing.assert_close(camera.directions_at(origin + 7.0 * direction), direction)
    assert not torch.allclose(camera.directions_at(origin - 7.0 * direction + 1e-3), direction) or isinstance(
        camera, OrthographicCamera
    )


def test_the_eye_itself_looks_ahead() -> None:
    camera = PinholeCamera((1.0, 2.0, 3.0), (1.0, 2.0, 5.0), 1.0, 2, 2)
    assert camera.directions_at(torch.tensor([[1.0, 2.0, 3.0]])).tolist() == [[0.0, 0.0, 1.0]]


@pytest.mark.parametrize("camera", looking_north(4, 2))
def test_resized_cameras_keep_the_view(camera: Camera) -> None:
    larger = camera.resized(8, 4)
    assert (larger.width, larger.height) == (8, 4)
    averaged = image_positions(larger).reshape(2, 2, 4, 2, 2).mean(dim=(1, 3))
    torch.testing.assert_close(averaged, image_positions(camera))


@pytest.mark.parametrize("target", [(0.0, 0.0, 5.0), (0.0, 0.0, -5.0)])
def test_vertical_views_have_north_up(target: tuple[float, float, float]) -> None:
    origin, _ = OrthographicCamera(ORIGIN, target, 2.0, 1, 2).rays()
    torch.testing.assert_close(origin, torch.tensor([[0.0, 0.5, 0.0], [0.0, -0.5, 0.0]]))


def test_a_view_along_its_own_upward_direction_has_another_one() -> None:
    north_up = PinholeCamera(ORIGIN, NORTH, 1.0, 2, 2, up=NORTH).rays()[1]
    assert torch.equal(north_up, PinholeCamera(ORIGIN, NORTH, 1.0, 2, 2).rays()[1])
    assert torch.equal(north_up, PinholeCamera(ORIGIN, NORTH, 1.0, 2, 2, up=ORIGIN).rays()[1])


def test_a_rolled_camera() -> None:
    camera = OrthographicCamera(ORIGIN, NORTH, 2.0, 1, 2, up=(1.0, 0.0, 0.0))
    torch.testing.assert_close(camera.rays()[0], torch.tensor([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]]))


def padded_cloud() -> DensityGrid:
    """A cumulus off the middle of a larger, empty box."""
    cloud = build_cumulus(24, seed=1)
    density = torch.nn.functional.pad(cloud.density, (0, 20, 10, 0, 0, 5))
    return DensityGrid.from_voxel_size(density, float(cloud.voxel_size[0]))


FRAMES = [
    (40, 30, 0.0, 10.0, 40.0),
    (20, 60, 70.0, -35.0, 60.0),
    (90, 20, 200.0, 89.9, 20.0),
    (33, 33, 10.0, 90.0, 40.0),
]


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("width", "height", "azimuth_deg", "elevation_deg", "opening_deg"), FRAMES)
def test_frames_take_in_the_cloud_and_little_else(
    width: int, height: int, azimuth_deg: float, elevation_deg: float, opening_deg: float, orthographic: bool
) -> None:
    grid = padded_cloud()
    camera = frame_volume(
        grid,
        width=width,
        height=height,
        azimuth=math.radians(azimuth_deg),
        elevation=math.radians(elevation_deg),
        field_of_view=math.radians(opening_deg),
        orthographic=orthographic,
    )
    across, up = picture_coordinates(camera, grid.visible_points.double())
    largest = max(float(across.abs().max()), float(up.abs().max()))
    assert 0.9 < largest < 1.0
    _, direction = camera.rays()
    expected = torch.tensor(direction_from_angles(math.radians(azimuth_deg), math.radians(elevation_deg)))
    middle = torch.nn.functional.normalize(direction.mean(0), dim=0)
    torch.testing.assert_close(middle, expected, atol=1e-5, rtol=0.0)


def picture_coordinates(camera: Camera, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Position of points in the image, -1..1 from left to right and from bottom to top, from the camera's corner rays alone."""
    origin, direction = (part.double().reshape(camera.height, camera.width, 3) for part in camera.rays())
    ahead = torch.nn.functional.normalize(direction.mean((0, 1)), dim=0)
    if isinstance(camera, PinholeCamera):
        plane = direction / (direction @ ahead)[..., None]
        offset = points - torch.tensor(camera.position, dtype=torch.float64)
        offset = offset / (offset @ ahead)[:, None]
    else:
        plane, offset = origin, points
    middle = plane.mean((0, 1))
    right = (plane[:, -1] - plane[:, 0]).mean(0) / 2.0 * camera.width / (camera.width - 1)
    up = (plane[0] - plane[-1]).mean(0) / 2.0 * camera.height / (camera.height - 1)
    return (offset - middle) @ right / (right @ right), (offset - middle) @ up / (up @ up)


def test_a_frame_sees_all_of_the_cloud() -> None:
    grid = padded_cloud()
    for elevation in (0.0, 0.4):
        close = frame_volume(grid, width=30, height=30, elevation=elevation, orthographic=True)
        assert isinstance(close, OrthographicCamera)
        far = OrthographicCamera(close.position, close.target, 2.0 * close.view_height, 60, 60)
        cropped = compute_optical_length(grid, *close.rays()).sum()
        whole = compute_optical_length(grid, *far.rays()).sum()
        torch.testing.assert_close(cropped, whole, rtol=2e-3, atol=0.0)
        narrow = OrthographicCamera(close.position, close.target, 0.7 * close.view_height, 21, 21)
        assert compute_optical_length(grid, *narrow.rays()).sum() < 0.99 * whole


def test_orthographic_frames_stand_outside() -> None:
    grid = padded_cloud()
    for azimuth in (0.0, 1.0, 4.0):
        origin, direction = frame_volume(grid, width=9, height=9, azimuth=azimuth, orthographic=True).rays()
        near, far = grid.intersect(origin, direction)
        assert (near[far > near] > 0.0).all()


def test_empty_volumes_are_framed_by_their_box() -> None:
    grid = DensityGrid.from_voxel_size(torch.zeros(4, 4, 4), 10.0)
    for orthographic in (False, True):
        camera = frame_volume(grid, width=8, height=8, orthographic=orthographic)
        across, up = picture_coordinates(camera, torch.stack([grid.lower, grid.upper]).double())
        assert 0.5 < float(torch.stack([across, up]).abs().max()) < 1.0


def test_a_given_distance_is_kept_even_inside_the_volume() -> None:
    grid = uniform_box()
    camera = frame_volume(grid, width=4, height=4, elevation=0.0, distance=1.0)
    torch.testing.assert_close(torch.tensor(camera.position), torch.tensor([0.0, -1.0, 0.0]))
    near, far = grid.intersect(*camera.rays())
    assert torch.equal(near, torch.zeros(16))
    assert (far > 3.0).all()


@pytest.mark.parametrize("opening", [0.0, -1.0, math.pi, 4.0, math.nan, math.inf])
def test_impossible_opening_angles_are_refused(opening: float) -> None:
    with pytest.raises(CameraError, match="field of view"):
        PinholeCamera(ORIGIN, NORTH, opening, 2, 2)
    with pytest.raises(CameraError, match="field of view"):
        frame_volume(uniform_box(), width=2, height=2, field_of_view=opening)
    with pytest.raises(CameraError, match="view height"):
        OrthographicCamera(ORIGIN, NORTH, opening if opening <= 0.0 else math.inf, 2, 2)


@pytest.mark.parametrize(
    ("position", "target", "width", "height", "complaint"),
    [
        ((math.nan, 0.0, 0.0), NORTH, 2, 2, "finite"),
        (ORIGIN, (0.0, math.inf, 0.0), 2, 2, "finite"),
        (NORTH, NORTH, 2, 2, "same point"),
        (ORIGIN, NORTH, 0, 2, "one pixel"),
        (ORIGIN, NORTH, 2, -1, "one pixel"),
        (ORIGIN, NORTH, MAXIMUM_PIXELS + 1, 1, "limit"),
        (ORIGIN, NORTH, 1 << 20, 1 << 20, "limit"),
    ],
)
def test_numbers_that_are_no_view_are_refused(
    position: tuple[float, float, float], target: tuple[float, float, float], width: int, height: int, complaint: str
) -> None:
    with pytest.raises(CameraError, match=complaint):
        PinholeCamera(position, target, 1.0, width, height)
    with pytest.raises(CameraError, match=complaint):
        OrthographicCamera(position, target, 1.0, width, height)


def test_an_upward_direction_must_be_finite() -> None:
    with pytest.raises(CameraError, match="upward"):
        PinholeCamera(ORIGIN, NORTH, 1.0, 2, 2, up=(0.0, math.nan, 1.0))


@pytest.mark.parametrize(("width", "height"), [(0, 5), (5, 0), (-1, 5), (1 << 20, 1 << 20)])
def test_frames_need_a_possible_number_of_pixels(width: int, height: int) -> None:
    with pytest.raises(CameraError):
        frame_volume(uniform_box(), width=width, height=height)
    with pytest.raises(CameraError):
        frame_volume(uniform_box(), width=4, height=4).resized(width, height)


def test_directions_are_brought_to_unit_length() -> None:
    torch.testing.assert_close(unit_direction(torch.tensor([0.0, -3.0, 4.0])), torch.tensor([0.0, -0.6, 0.8]))
    torch.testing.assert_close(unit_direction(torch.tensor([0.0, 0.0, 1e-30])), torch.tensor([0.0, 0.0, 1.0]))
    for bad in ([0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [math.inf, 0.0, 0.0], [1.0, 0.0], [[1.0, 0.0, 0.0]]):
        with pytest.raises(ParameterError, match="direction"):
            unit_direction(torch.tensor(bad))


@pytest.mark.parametrize(
    "camera",
    [
        PinholeCamera((1.0, 2.0, 3.0), (4.0, 9.0, 2.0), 0.7, 6, 4),
        OrthographicCamera((1.0, 2.0, 3.0), (4.0, 9.0, 2.0), 5.0, 6, 4),
    ],
)
def test_rays_through_points_go_where_they_are_projected_from(camera: PinholeCamera | OrthographicCamera) -> None:
    x, y = torch.meshgrid(torch.arange(6) + 0.5, torch.arange(4) + 0.5, indexing="xy")
    centres = torch.stack([x.flatten(), y.flatten()], dim=1)
    origin, direction = camera.rays_through(centres)
    torch.testing.assert_close(torch.cat(camera.rays()), torch.cat([origin, direction]))
    for point, ray_origin, ray in zip(centres, origin, direction, strict=True):
        a, b, w = camera.project(tuple((ray_origin + 7.0 * ray).tolist()))
        torch.testing.assert_close(torch.tensor([a / w, b / w]), point, atol=1e-4, rtol=0.0)
        assert w > 0.0


def test_a_direction_behind_the_camera_has_a_negative_weight() -> None:
    camera = PinholeCamera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.7, 6, 4)
    assert camera.project((0.3, 1.0, 0.0), at_infinity=True)[2] > 0.0 > camera.project((0.3, -1.0, 0.0), True)[2]
    flat = OrthographicCamera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 2.0, 6, 4)
    x, y, w = flat.project((1.0, 1.0, 1.0), at_infinity=True)
    assert (x > 0.0, y < 0.0, w) == (True, True, 0.0)
