import math

import pytest
import torch

from render.errors import ParameterError
from render.media import ExponentialDecay, Uniform
from render.shafts.air import PHASE_FUNCTIONS, Air, Constituent


def test_depths_of_constituents_add_up_channel_by_channel() -> None:
    air = Air((Constituent(Uniform(0.01, 100.0), (1.0, 2.0, 0.0)), Constituent(Uniform(0.03, 100.0))))
    depth = air.compute_depth(torch.tensor([10.0]), torch.tensor([0.0]), torch.tensor([50.0]))
    torch.testing.assert_close(depth, torch.tensor([[2.0, 2.5, 1.5]]))
    assert not torch.allclose(depth, air.compute_depth(torch.tensor([10.0]), torch.tensor([0.0]), torch.tensor([49.0])))


def test_no_air_has_no_depth_and_no_albedo() -> None:
    height, slope = torch.tensor([1.0, 2.0]), torch.tensor([0.0, 0.5])
    assert torch.equal(Air().compute_depth(height, slope, 10.0), torch.zeros(2, 3))
    assert torch.equal(Air().mean_albedo(height, slope, torch.tensor([5.0, 5.0])), torch.zeros(2, 3))
    assert Air().empty
    assert Air((Constituent(Uniform(0.0, 10.0)),)).empty
    assert not Air((Constituent(Uniform(1e-12, 10.0)),)).empty


def test_the_mean_albedo_is_weighted_by_depth() -> None:
    air = Air((Constituent(Uniform(0.01, 100.0), albedo=1.0), Constituent(Uniform(0.03, 100.0), albedo=0.2)))
    albedo = air.mean_albedo(torch.tensor([5.0]), torch.tensor([0.1]), torch.tensor([30.0]))
    torch.testing.assert_close(albedo, torch.full((1, 3), 0.4))


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_phase_functions_integrate_to_one(name: str) -> None:
    part = Constituent(Uniform(1.0, 1.0), phase=name, asymmetry=0.6)
    cosine = (torch.arange(20000, dtype=torch.float64) + 0.5) / 10000 - 1.0
    total = 2.0 * math.pi * part.evaluate_phase(cosine).mean() * 2.0
    assert float(total) == pytest.approx(1.0, abs=1e-6)


def test_what_is_no_constituent_is_refused() -> None:
    fog = ExponentialDecay(0.1, 10.0)
    for wrong in ({"albedo": 1.1}, {"colour": (1.0, -1.0, 1.0)}, {"phase": "mie"}, {"asymmetry": 1.0}):
        with pytest.raises(ParameterError):
            Constituent(fog, **wrong)
