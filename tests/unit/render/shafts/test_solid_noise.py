import pytest
import torch

from render.errors import ParameterError
from render.random_streams import child_generator
from render.shafts.solid_noise import PERIOD, SolidNoise

POINTS = 100.0 * torch.rand(20_000, 3, generator=child_generator(1)) - 50.0


def test_noise_belongs_to_its_seed() -> None:
    assert torch.equal(SolidNoise(3).look_up(POINTS), SolidNoise(3).look_up(POINTS))
    assert not torch.allclose(SolidNoise(3).look_up(POINTS), SolidNoise(4).look_up(POINTS), atol=0.1)


def test_noise_has_mean_zero_and_stays_within_bounds() -> None:
    values = SolidNoise(3).look_up(POINTS)
    assert abs(float(values.mean())) < 0.02
    assert 0.15 < float(values.std()) < 0.5
    assert float(values.abs().max()) <= 1.05


def test_noise_is_continuous_and_smooth_across_lattice_points_and_the_period() -> None:
    noise = SolidNoise(5)
    for place in (3.0, 0.0, float(PERIOD), -1.5):
        row = torch.tensor([[place + step, 0.3, 0.7] for step in (-2e-3, -1e-3, 0.0, 1e-3, 2e-3)], dtype=torch.float64)
        values = noise.look_up(row.to(torch.float32))
        slopes = values.diff() / 1e-3
        assert float(slopes.abs().max()) < 6.0
        assert float(slopes.diff().abs().max()) < 0.2


def test_noise_repeats_after_its_period_only() -> None:
    noise = SolidNoise(5)
    values = noise.look_up(POINTS)
    assert torch.allclose(noise.look_up(POINTS + PERIOD), values, atol=1e-3)
    assert not torch.allclose(noise.look_up(POINTS + PERIOD / 4), values, atol=0.1)


def test_octaves_add_detail() -> None:
    def roughness(octaves: int) -> float:
        noise = SolidNoise(5, octaves)
        values = noise.look_up(POINTS)
        return float((noise.look_up(POINTS + torch.tensor([0.05, 0.0, 0.0])) - values).std() / values.std())

    assert roughness(4) > 1.2 * roughness(1)
    with pytest.raises(ParameterError, match="octave"):
        SolidNoise(1, 0)
