import math

import pytest
import torch

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.epipolar import LightImage
from render.shafts.epipolar_sampling import EpipolarSampling, EpipolarSettings, build_epipolar_sampling
from tests.unit.render.shafts.test_epipolar import HEIGHT, LIGHTS, WIDTH, pixel_centres

FLAT = torch.full((HEIGHT, WIDTH), 50.0)


def sample(light: str, depth: torch.Tensor = FLAT, settings: EpipolarSettings | None = None) -> EpipolarSampling:
    return build_epipolar_sampling(LightImage(*LIGHTS[light], depth.shape[1], depth.shape[0]), depth, settings)


def slope(points: torch.Tensor) -> torch.Tensor:
    return torch.stack([1.0 + 0.3 * points[:, 0] - 0.2 * points[:, 1], points[:, 1]], dim=1)


def boxes(generator: torch.Generator) -> torch.Tensor:
    """Sky with boxes of several depths before it."""
    depth = torch.full((HEIGHT, WIDTH), math.inf)
    for near in (200.0, 60.0, 9.0):
        row, column = (int(torch.randint(0, size - 6, (1,), generator=generator)) for size in (HEIGHT, WIDTH))
        depth[row : row + 7, column : column + 9] = near
    return depth


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("stride", [1, 7])
def test_linear_functions_are_reproduced(light: str, stride: int) -> None:
    sampling = sample(light, settings=EpipolarSettings(line_gap=3.0, stride=stride))
    assert not len(sampling.own_pixels)
    values = slope(sampling.points[sampling.marched])
    image = sampling.interpolate(values, values[:0])
    assert torch.allclose(image, slope(pixel_centres().float()), atol=2e-4)
    assert not torch.allclose(sampling.interpolate(values.roll(1, 0), values[:0]), image, atol=1e-2)


def test_pixels_under_a_sample_have_its_value() -> None:
    """Lines along rows with a sample in the middle of each pixel: any picture comes back."""
    settings = EpipolarSettings(line_gap=0.5, stride=1)
    sampling = sample("at infinity along a row", settings=settings)
    picture = torch.rand(HEIGHT * WIDTH, 3, generator=child_generator(1))
    x, y = sampling.points[sampling.marched].unbind(1)
    under = y.floor().long().clamp(0, HEIGHT - 1) * WIDTH + x.floor().long()
    assert torch.allclose(sampling.interpolate(picture[under], picture[:0]), picture, atol=1e-5)


@pytest.mark.parametrize("light", LIGHTS)
def test_edges_of_depth_are_not_crossed(light: str) -> None:
    """What is constant on each surface comes back as it was, at every pixel."""
    depth = boxes(child_generator(2))
    sampling = sample(light, depth, EpipolarSettings(stride=7))
    value = torch.atan(depth.reshape(-1, 1) / 50.0)
    marched = torch.atan(sampling.depth[sampling.marched][:, None] / 50.0)
    image = sampling.interpolate(marched, value[sampling.own_pixels])
    assert torch.allclose(image, value, atol=1e-6)
    blind = sample(light, depth, EpipolarSettings(stride=7, depth_tolerance=1e6))
    marched = torch.atan(blind.depth[blind.marched][:, None] / 50.0)
    assert not torch.allclose(blind.interpolate(marched, value[blind.own_pixels]), value, atol=0.1)


def test_samples_are_marched_at_edges_only() -> None:
    flat, edged = sample("off the frame"), sample("off the frame", boxes(child_generator(2)))
    assert len(edged.points) == len(flat.points)
    assert len(flat.marched) < len(edged.marched) < 0.5 * len(edged.points)
    assert bool(edged.refined[flat.marched].all())


def test_depth_drifts_less_than_the_tolerance_between_marched_samples() -> None:
    rows = torch.arange(1.0, HEIGHT + 1.0)[:, None]
    sampling = sample("in the middle", (2000.0 / rows).expand(-1, WIDTH), EpipolarSettings(stride=1000))
    low, high = sampling.marched[sampling.neighbours.long()].unbind(1)
    ratio = (sampling.depth[low] / sampling.depth[high]).log().abs()[~sampling.refined]
    assert len(ratio)
    assert float(ratio.max()) <= math.log(1.1) + 1e-6
    loose = sample(
        "in the middle", (2000.0 / rows).expand(-1, WIDTH), EpipolarSettings(stride=1000, depth_tolerance=10.0)
    )
    low, high = loose.marched[loose.neighbours.long()].unbind(1)
    assert float((loose.depth[low] / loose.depth[high]).log().abs().max()) > math.log(1.1)


def test_a_pixel_unlike_its_neighbours_is_marched_by_itself() -> None:
    depth = FLAT.clone()
    depth[11, 17] = 3.0
    sampling = sample("off the frame", depth, EpipolarSettings(line_gap=4.0, sample_gap=4.0))
    assert sampling.own_pixels.tolist() == [11 * WIDTH + 17]
    marched = torch.zeros(len(sampling.marched), 1)
    image = sampling.interpolate(marched, torch.full((1, 1), 7.0))
    assert image[11 * WIDTH + 17].item() == 7.0
    assert float(image.sum()) == 7.0
    with pytest.raises(ParameterError, match="1 pixels"):
        sampling.interpolate(marched, torch.zeros(2, 1))


def test_one_pixel_is_a_frame() -> None:
    for light in (LightImage(0.5, 0.5, 1.0, 1, 1), LightImage(9.0, 0.5, 1.0, 1, 1), LightImage(1.0, 2.0, 0.0, 1, 1)):
        sampling = build_epipolar_sampling(light, torch.ones(1, 1))
        values = slope(sampling.points[sampling.marched])
        assert torch.allclose(sampling.interpolate(values, values[:0]), slope(torch.tensor([[0.5, 0.5]])), atol=1e-6)


def test_a_smooth_function_converges_with_the_density() -> None:
    def error(settings: EpipolarSettings) -> float:
        sampling = sample("beyond a corner", settings=settings)
        smooth = [
            torch.sin(0.2 * p[:, :1]) * torch.cos(0.15 * p[:, 1:])
            for p in (sampling.points[sampling.marched], pixel_centres())
        ]
        return float((sampling.interpolate(smooth[0], smooth[0][:0]) - smooth[1]).abs().max())

    coarse, middle, fine = (error(EpipolarSettings(line_gap=gap, sample_gap=gap, stride=1)) for gap in (8.0, 4.0, 2.0))
    assert coarse > 2.5 * middle > 6.0 * fine


def test_frames_and_depths_must_fit() -> None:
    with pytest.raises(ParameterError, match="shape"):
        build_epipolar_sampling(LightImage(1.0, 1.0, 1.0, 4, 4), torch.ones(4, 5))
    with pytest.raises(ParameterError, match="negative"):
        sample("off the frame", -FLAT)
    with pytest.raises(ParameterError, match="positive"):
        EpipolarSettings(stride=0)
