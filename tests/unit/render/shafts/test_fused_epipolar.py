"""The fused loops lay the samples and weights of those in torch."""

import pytest
import torch

pytest.importorskip("numba")

from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts import fused_epipolar
from render.shafts.epipolar import LightImage
from render.shafts.epipolar_sampling import EpipolarSampling, EpipolarSettings, build_epipolar_sampling
from tests.unit.render.shafts.test_epipolar import HEIGHT, LIGHTS, WIDTH
from tests.unit.render.shafts.test_epipolar_sampling import boxes

FIELDS = ("points", "line", "depth", "marched", "neighbours", "share", "own_pixels")


def both(
    light: tuple[float, float, float], depth: torch.Tensor, settings: EpipolarSettings
) -> tuple[EpipolarSampling, EpipolarSampling]:
    image = LightImage(*light, depth.shape[1], depth.shape[0])
    fused = build_epipolar_sampling(image, depth, settings)
    with torch_loops_only():
        return fused, build_epipolar_sampling(image, depth, settings)


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())
@pytest.mark.parametrize("stride", [1, 7])
def test_they_lay_what_torch_lays(
    light: tuple[float, float, float], stride: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fused_epipolar, "ROWS", 5)
    monkeypatch.setattr(fused_epipolar, "PIXELS", 101)
    settings = EpipolarSettings(line_gap=2.5, stride=stride)
    fused, plain = both(light, boxes(child_generator(2)), settings)
    for field in FIELDS:
        torch.testing.assert_close(getattr(fused, field), getattr(plain, field), rtol=1e-6, atol=1e-6)
    values = torch.rand(len(plain.marched), 3, generator=child_generator(3))
    own = torch.rand(len(plain.own_pixels), 3, generator=child_generator(4))
    with torch_loops_only():
        expected = plain.interpolate(values, own)
        torch.testing.assert_close(fused.interpolate(values, own), expected, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(fused.interpolate(values, own), expected, rtol=1e-5, atol=1e-5)
    assert not torch.allclose(fused.interpolate(values.flip(0), own), expected, atol=1e-2)


def test_one_pixel_is_a_frame() -> None:
    for light in ((0.5, 0.5, 1.0), (9.0, 0.5, 1.0), (1.0, 2.0, 0.0)):
        fused, plain = both(light, torch.ones(1, 1), EpipolarSettings())
        torch.testing.assert_close(fused.points, plain.points)
        assert fused.interpolate(torch.full((len(fused.marched), 1), 3.0), torch.zeros(0, 1)).item() == pytest.approx(
            3.0
        )


def test_double_precision_stays_with_torch() -> None:
    fused, _ = both(LIGHTS["off the frame"], torch.full((HEIGHT, WIDTH), 5.0), EpipolarSettings())
    values = torch.ones(len(fused.marched), 1, dtype=torch.float64)
    assert fused.interpolate(values, values[:0]).dtype == torch.float64
