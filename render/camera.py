"""Pinhole and orthographic cameras, and the directions of the compass.

World axes: x east, y north, z up, right-handed. Azimuth runs clockwise from north, elevation upwards from the horizon.
Row 0 is the top of the image and pixel centres lie at +0.5.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from render.density_grid import DensityGrid
from render.errors import CameraError, ParameterError

Vector = tuple[float, float, float]

MAXIMUM_PIXELS = 1 << 26
"""Refuse larger images before anything is allocated: 67 megapixels are beyond any use of this package."""


class Camera(Protocol):
    """What every image needs of a camera: its size and one ray per pixel."""

    @property
    def width(self) -> int:
        """Pixels in a row."""

    @property
    def height(self) -> int:
        """Rows of the image."""

    def rays(self) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(pixel, 3)`, row by row."""

    def directions_at(self, points: Tensor) -> Tensor:
        """Unit direction of travel of the camera ray through each point `(point, 3)` [m]."""

    def resized(self, width: int, height: int) -> "Camera":
        """The same view with other pixel counts."""

    def rays_through(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(point, 3)`, through points of the image `(point, 2)`: x, y [pixel]."""

    def project(self, place: Vector, at_infinity: bool = False) -> Vector:
        """Image of a point [m], or of a direction: homogeneous x, y, w [pixel]; w > 0 before the camera, < 0 behind it."""


def direction_from_angles(azimuth: float, elevation: float) -> Vector:
    """Unit vector (x, y, z) of an azimuth [rad, clockwise from north] and an elevation [rad]."""
    horizontal = math.cos(elevation)
    x, y, z = math.sin(azimuth) * horizontal, math.cos(azimuth) * horizontal, math.sin(elevation)
    # The cosine of 90 degrees rounds to 6e-17, which would lead out of a face of the volume that the direction is parallel to.
    return (_exact_zero(x), _exact_zero(y), _exact_zero(z))


def _exact_zero(component: float) -> float:
    return 0.0 if abs(component) < 1e-15 else component


def unit_direction(direction: Tensor) -> Tensor:
    """Unit vector `(3,)`, float32, along a vector of any length.

    Raises:
        ParameterError: if the vector is not three finite numbers, or is zero.
    """
    vector = torch.as_tensor(direction, dtype=torch.float64)
    length = torch.linalg.vector_norm(vector)
    if vector.shape != (3,) or not bool(torch.isfinite(length) & (length > 0.0)):
        raise ParameterError(f"a direction needs three finite numbers that are not all zero, not {vector.tolist()}")
    return (vector / length).to(torch.float32)


@dataclass(frozen=True)
class PinholeCamera:
    """Perspective camera.

    Args:
        position: eye point [m].
        target: point in the middle of the image [m].
        field_of_view: vertical opening angle [rad], between 0 and pi.
        width, height: pixel counts.
        up: direction that points upwards in the image; replaced by north, or else the zenith, where the view is along it.

    Raises:
        CameraError: if the numbers do not describe a view.
    """

    position: Vector
    target: Vector
    field_of_view: float
    width: int
    height: int
    up: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _check_view(self.position, self.target, self.up, self.width, self.height)
        if not 0.0 < self.field_of_view < math.pi:
            raise CameraError(f"the field of view must lie between 0 and 180 degrees, not {self.field_of_view} rad")

    def rays(self) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(pixel, 3)`, row by row."""
        right, up, forward = _view_frame(self.position, self.target, self.up)
        half_height = math.tan(0.5 * self.field_of_view)
        across, upwards = _image_plane(self.width, self.height, half_height)
        direction = forward + across[:, None] * right + upwards[:, None] * up
        direction = direction / torch.linalg.vector_norm(direction, dim=-1, keepdim=True)
        origin = torch.tensor(self.position, dtype=torch.float64).expand_as(direction)
        return origin.to(torch.float32).contiguous(), direction.to(torch.float32)

    def directions_at(self, points: Tensor) -> Tensor:
        """Unit direction of travel of the camera ray through each point `(point, 3)` [m]; forward at the eye itself."""
        offset = points - torch.tensor(self.position, dtype=points.dtype)
        length = torch.linalg.vector_norm(offset, dim=-1, keepdim=True)
        forward = _view_frame(self.position, self.target, self.up)[2].to(points.dtype)
        return torch.where(length > 0, offset / length.clamp(min=1e-30), forward)

    def rays_through(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(point, 3)`, through points of the image `(point, 2)`: x, y [pixel]."""
        right, up, forward = _view_frame(self.position, self.target, self.up)
        across, upwards = _offsets(points, self.width, self.height, math.tan(0.5 * self.field_of_view))
        direction = forward + across[:, None] * right + upwards[:, None] * up
        direction = direction / torch.linalg.vector_norm(direction, dim=-1, keepdim=True)
        origin = torch.tensor(self.position, dtype=torch.float64).expand_as(direction)
        return origin.to(torch.float32).contiguous(), direction.to(torch.float32)

    def project(self, place: Vector, at_infinity: bool = False) -> Vector:
        """Image of a point [m], or of a direction: homogeneous x, y, w [pixel]; w > 0 before the camera, < 0 behind it."""
        right, up, forward = _view_frame(self.position, self.target, self.up)
        eye = torch.tensor(self.position, dtype=torch.float64)
        offset = torch.tensor(place, dtype=torch.float64) - (0.0 if at_infinity else eye)
        pixel = 2.0 * math.tan(0.5 * self.field_of_view) / self.height
        across, upwards, w = (float(offset @ axis) for axis in (right, up, forward))
        return (0.5 * self.width * w + across / pixel, 0.5 * self.height * w - upwards / pixel, w)

    def resized(self, width: int, height: int) -> "PinholeCamera":
        """The same eye and vertical opening angle with other pixel counts."""
        return PinholeCamera(self.position, self.target, self.field_of_view, width, height, self.up)


@dataclass(frozen=True)
class OrthographicCamera:
    """Parallel projection.

    Args:
        position: point of the image plane in the middle of the image [m].
        target: point that the plane faces [m].
        view_height: extent of the image along its vertical [m].
        width, height: pixel counts.
        up: direction that points upwards in the image; replaced by north, or else the zenith, where the view is along it.

    Raises:
        CameraError: if the numbers do not describe a view.
    """

    position: Vector
    target: Vector
    view_height: float
    width: int
    height: int
    up: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _check_view(self.position, self.target, self.up, self.width, self.height)
        if not (self.view_height > 0.0 and math.isfinite(self.view_height)):
            raise CameraError(f"the view height must be positive, not {self.view_height} m")

    def rays(self) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(pixel, 3)`, row by row."""
        right, up, forward = _view_frame(self.position, self.target, self.up)
        across, upwards = _image_plane(self.width, self.height, 0.5 * self.view_height)
        origin = torch.tensor(self.position, dtype=torch.float64) + across[:, None] * right + upwards[:, None] * up
        return origin.to(torch.float32), forward.expand_as(origin).to(torch.float32).contiguous()

    def directions_at(self, points: Tensor) -> Tensor:
        """Unit direction of travel of the camera ray through each point `(point, 3)` [m]: the same everywhere."""
        forward = _view_frame(self.position, self.target, self.up)[2]
        return forward.to(points.dtype).expand_as(points)

    def rays_through(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Origins [m] and unit directions, each `(point, 3)`, through points of the image `(point, 2)`: x, y [pixel]."""
        right, up, forward = _view_frame(self.position, self.target, self.up)
        across, upwards = _offsets(points, self.width, self.height, 0.5 * self.view_height)
        origin = torch.tensor(self.position, dtype=torch.float64) + across[:, None] * right + upwards[:, None] * up
        return origin.to(torch.float32), forward.expand_as(origin).to(torch.float32).contiguous()

    def project(self, place: Vector, at_infinity: bool = False) -> Vector:
        """Image of a point [m], or of a direction: homogeneous x, y, w [pixel]; a direction has w = 0."""
        right, up, _ = _view_frame(self.position, self.target, self.up)
        eye = torch.tensor(self.position, dtype=torch.float64)
        offset = torch.tensor(place, dtype=torch.float64) - (0.0 if at_infinity else eye)
        pixel, w = self.view_height / self.height, 0.0 if at_infinity else 1.0
        across, upwards = float(offset @ right), float(offset @ up)
        return (0.5 * self.width * w + across / pixel, 0.5 * self.height * w - upwards / pixel, w)

    def resized(self, width: int, height: int) -> "OrthographicCamera":
        """The same plane and vertical extent with other pixel counts."""
        return OrthographicCamera(self.position, self.target, self.view_height, width, height, self.up)


def frame_volume(
    grid: DensityGrid,
    *,
    width: int,
    height: int,
    azimuth: float = 0.0,
    elevation: float = math.radians(10.0),
    field_of_view: float = math.radians(40.0),
    distance: float | None = None,
    orthographic: bool = False,
) -> PinholeCamera | OrthographicCamera:
    """Camera that looks at the middle of a cloud and, without a distance, just takes all of it in.

    Args:
        grid: the volume.
        width, height: pixel counts.
        azimuth: direction in which the camera looks [rad, clockwise from north].
        elevation: how far it looks upwards [rad]; clouds are mostly seen from below.
        field_of_view: vertical opening angle [rad] of a pinhole camera.
        distance: from the middle of the cloud to the camera [m].
        orthographic: parallel instead of perspective projection.

    Returns:
        The camera; an orthographic one stands outside the volume.
    """
    if width <= 0 or height <= 0:
        raise CameraError(f"an image needs at least one pixel, not {width} x {height}")
    forward = torch.tensor(direction_from_angles(azimuth, elevation), dtype=torch.float64)
    points = grid.visible_points.double() if grid.maximum > 0.0 else torch.stack([grid.lower, grid.upper]).double()
    centre = 0.5 * (points.amin(0) + points.amax(0))
    right, up, ahead = _view_frame((0.0, 0.0, 0.0), _vector(forward), (0.0, 0.0, 1.0))
    offsets = points - centre
    margin = 0.5 * float(grid.voxel_size.max())
    vertical = torch.maximum((offsets @ up).abs() + margin, ((offsets @ right).abs() + margin) * (height / width))
    if orthographic:
        position = centre - forward * (distance if distance is not None else 2.0 * grid.radius)
        return OrthographicCamera(_vector(position), _vector(centre), 2.0 * float(vertical.max()), width, height)
    if not 0.0 < field_of_view < math.pi:
        raise CameraError(f"the field of view must lie between 0 and 180 degrees, not {field_of_view} rad")
    if distance is None:
        distance = float((vertical / math.tan(0.5 * field_of_view) - offsets @ ahead).max())
    return PinholeCamera(_vector(centre - forward * distance), _vector(centre), field_of_view, width, height)


def _vector(tensor: Tensor) -> Vector:
    x, y, z = tensor.tolist()
    return (x, y, z)


def _check_view(position: Vector, target: Vector, up: Vector, width: int, height: int) -> None:
    if not all(math.isfinite(v) for v in (*position, *target, *up)):
        raise CameraError(f"camera position {position}, target {target} and upward direction {up} must be finite")
    if math.dist(position, target) == 0.0:
        raise CameraError(f"camera position and target are the same point {position}; move one of them")
    if width < 1 or height < 1:
        raise CameraError(f"an image needs at least one pixel, not {width} x {height}")
    if width * height > MAXIMUM_PIXELS:
        raise CameraError(f"an image of {width} x {height} exceeds the limit of {MAXIMUM_PIXELS:,} pixels")


def _view_frame(position: Vector, target: Vector, up: Vector) -> tuple[Tensor, Tensor, Tensor]:
    """Orthonormal right, up and forward vectors, float64."""
    eye, middle = torch.tensor([position, target], dtype=torch.float64)
    forward = torch.nn.functional.normalize(middle - eye, dim=0)
    for upward in (up, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        right = torch.linalg.cross(forward, torch.tensor(upward, dtype=torch.float64))
        if torch.linalg.vector_norm(right) > 1e-9:
            break
    right = torch.nn.functional.normalize(right, dim=0)
    return right, torch.linalg.cross(right, forward), forward


def _offsets(points: Tensor, width: int, height: int, half_height: float) -> tuple[Tensor, Tensor]:
    """Offsets across and upwards of points `(point, 2)` [pixel] on a plane of the given half height, each `(point,)`."""
    pixel = 2.0 * half_height / height
    x, y = points.double().unbind(-1)
    return (x - 0.5 * width) * pixel, (0.5 * height - y) * pixel


def _image_plane(width: int, height: int, half_height: float) -> tuple[Tensor, Tensor]:
    """Offsets across and upwards of the pixel centres on a plane of the given half height, each `(pixel,)`."""
    pixel = 2.0 * half_height / height
    across = (torch.arange(width, dtype=torch.float64) + 0.5 - 0.5 * width) * pixel
    upwards = (0.5 * height - torch.arange(height, dtype=torch.float64) - 0.5) * pixel
    grid_up, grid_across = torch.meshgrid(upwards, across, indexing="ij")
    return grid_across.reshape(-1), grid_up.reshape(-1)
