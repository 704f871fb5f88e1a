"""The procedural cumulus: one shape per seed, a flat base, billows, and nothing at the border."""

import cv2
import numpy as np
import pytest
import torch

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.procedural_cloud import build_cumulus


@pytest.fixture(scope="module")
def cloud() -> DensityGrid:
    return build_cumulus(64, seed=3)


def side_view(grid: DensityGrid, blur: float = 40.0) -> torch.Tensor:
    """Optical length along y, blurred [m] onto one raster of points of the world for every resolution `(24, 32)`."""

    def gaussian_weights(axis: int, points: torch.Tensor) -> torch.Tensor:
        count = grid.density.shape[2 - axis]
        centres = grid.lower[axis] + (torch.arange(count) + 0.5) * grid.voxel_size[axis]
        weights = torch.exp(-0.5 * ((points[:, None] - centres) / blur).square())
        return weights * grid.voxel_size[axis] / (blur * (2.0 * torch.pi) ** 0.5)

    length = grid.density.sum(1) * grid.voxel_size[1]
    across, up = torch.linspace(-550.0, 550.0, 32), torch.linspace(-400.0, 400.0, 24)
    return gaussian_weights(2, up) @ length @ gaussian_weights(0, across).T


def correlation(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(torch.corrcoef(torch.stack([first.flatten(), second.flatten()]))[0, 1])


def outline_excess(silhouette: np.ndarray) -> float:
    """Length of the outline over that of its convex hull: 1 for a disc, larger for a cauliflower."""
    contours, _ = cv2.findContours(silhouette.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)
    return cv2.arcLength(outline, True) / cv2.arcLength(cv2.convexHull(outline), True)


def lowest_and_highest(density: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Lowest and highest dense voxel of the columns in the middle of the cloud, in voxels."""
    dense = density > 0.25
    columns = dense.any(0) & (dense.sum(0) > 0.3 * dense.shape[0])
    lowest = dense.int().argmax(0)[columns].double()
    highest = dense.shape[0] - 1 - dense.flip(0).int().argmax(0)[columns].double()
    return lowest, highest


def test_a_seed_gives_one_cloud_and_another_seed_another(cloud: DensityGrid) -> None:
    assert torch.equal(build_cumulus(64, seed=3).density, cloud.density)
    other = build_cumulus(64, seed=4).density
    assert other.shape != cloud.density.shape or not torch.equal(other, cloud.density)


def test_the_global_random_stream_is_left_alone() -> None:
    before = torch.get_rng_state()
    build_cumulus(8, seed=1)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("resolution", [8, 9, 33, 64])
def test_density_is_a_fraction_with_an_empty_border(resolution: int) -> None:
    density = build_cumulus(resolution, seed=5).density
    assert max(density.shape) == resolution
    assert float(density.min()) == 0.0
    assert 0.5 < float(density.max()) <= 1.0
    for axis in range(3):
        assert float(density.select(axis, 0).max()) == 0.0
        assert float(density.select(axis, -1).max()) == 0.0


def test_a_cloud_is_about_one_kilometre_wide_around_the_origin(cloud: DensityGrid) -> None:
    torch.testing.assert_close(cloud.centre, torch.zeros(3))
    torch.testing.assert_close(cloud.voxel_size, cloud.voxel_size[:1].expand(3))
    occupied = torch.nonzero((cloud.density > 0.1).any(0).any(0))
    width = float((occupied.max() - occupied.min() + 1) * cloud.voxel_size[0])
    assert 900.0 < width < 1100.0


def test_width_scales_the_box_alone(cloud: DensityGrid) -> None:
    wide = build_cumulus(64, seed=3, width=2000.0)
    assert torch.equal(wide.density, cloud.density)
    torch.testing.assert_close(wide.upper, 2.0 * cloud.upper)


def test_towering_clouds_are_taller() -> None:
    low, tall = (build_cumulus(32, seed=3, towering=towering) for towering in (0.3, 1.2))
    assert float(tall.upper[2] / tall.upper[0]) > 1.5 * float(low.upper[2] / low.upper[0])


def test_soft_clouds_have_thick_rims() -> None:
    def rim_fraction(softness: float) -> float:
        density = build_cumulus(64, seed=3, softness=softness).density
        return float(((density > 0.02) & (density < 0.4)).sum() / (density >= 0.4).sum())

    assert rim_fraction(0.08) > 1.5 * rim_fraction(0.01)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_the_base_is_flat_and_the_top_is_not(seed: int) -> None:
    density = build_cumulus(64, seed=seed).density
    lowest, highest = lowest_and_highest(density)
    assert float(lowest.std()) < 1.5
    assert float(highest.std()) > 4.0
    upside_down, _ = lowest_and_highest(density.flip(0))
    assert float(upside_down.std()) > 4.0


@pytest.mark.parametrize("seed", [1, 3])
def test_the_outline_billows(seed: int) -> None:
    silhouette = (build_cumulus(96, seed=seed).density.sum(1) > 0.5).numpy()
    assert outline_excess(silhouette) > 1.15
    z, x = np.mgrid[-40:40, -40:40]
    assert outline_excess(z**2 + x**2 < 35**2) < 1.1


def test_every_resolution_shows_the_same_cloud() -> None:
    reference = side_view(build_cumulus(96, seed=3))
    for resolution, least in ((64, 0.9999), (32, 0.999)):
        view = side_view(build_cumulus(resolution, seed=3))
        assert correlation(view, reference) > least
        assert float(view.sum() / reference.sum()) == pytest.approx(1.0, abs=0.01)
    assert correlation(side_view(build_cumulus(64, seed=4)), reference) < 0.95


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"resolution": 7}, "resolution"),
        ({"resolution": 1025}, "resolution"),
        ({"resolution": 16, "seed": -1}, "seed"),
        ({"resolution": 16, "width": 0.0}, "width"),
        ({"resolution": 16, "width": float("nan")}, "width"),
        ({"resolution": 16, "towering": 0.0}, "towering"),
        ({"resolution": 16, "towering": float("nan")}, "towering"),
        ({"resolution": 16, "softness": 0.3}, "softness"),
    ],
)
def test_arguments_outside_their_domain_are_refused(arguments: dict[str, float], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        build_cumulus(**arguments)  # type: ignore[arg-type]
