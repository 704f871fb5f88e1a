from dataclasses import replace

import pytest
import torch

from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.media import ExponentialDecay, Uniform
from render.shafts.air import Air, Constituent
from render.shafts.fog_bank import FogBank
from render.shafts.rays import ViewRays

BLOCK = DensityGrid.from_voxel_size(torch.ones(2, 2, 2), 10.0)


def level_ray() -> ViewRays:
    return ViewRays(torch.tensor([[-15.0, 1.0, 5.0]]), torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([30.0]))


def test_depths_of_constituents_add_up_channel_by_channel() -> None:
    air = Air((Constituent(Uniform(0.01, 100.0), (1.0, 2.0, 0.0)), Constituent(Uniform(0.03, 100.0))))
    depth = air.compute_depth(torch.tensor([10.0]), torch.tensor([0.0]), torch.tensor([50.0]))
    torch.testing.assert_close(depth, torch.tensor([[2.0, 2.5, 1.5]]))
    assert not torch.allclose(depth, air.compute_depth(torch.tensor([10.0]), torch.tensor([0.0]), torch.tensor([49.0])))


def test_no_air_has_no_depth_and_no_albedo() -> None:
    height, slope = torch.tensor([1.0, 2.0]), torch.tensor([0.0, 0.5])
    assert torch.equal(Air().compute_depth(height, slope, 10.0), torch.zeros(2, 3))
    assert torch.equal(Air().compute_ray_depths(level_ray())[1], torch.zeros(1, 3))
    assert Air().empty
    assert Air((Constituent(Uniform(0.0, 10.0)),)).empty
    assert not Air((Constituent(Uniform(1e-12, 10.0)),)).empty


def test_the_scattered_part_of_a_depth_is_that_of_the_albedos() -> None:
    air = Air((Constituent(Uniform(0.01, 100.0), albedo=1.0), Constituent(Uniform(0.03, 100.0), albedo=0.2)))
    whole, scattered = air.compute_ray_depths(level_ray())
    torch.testing.assert_close(whole, torch.full((1, 3), 1.2))
    torch.testing.assert_close(scattered, 0.4 * whole)
    with_bank, more = replace(air, banks=(FogBank(BLOCK, 0.1, albedo=0.5),)).compute_ray_depths(level_ray())
    torch.testing.assert_close(with_bank - whole, torch.full((1, 3), 2.0))
    torch.testing.assert_close(more - scattered, torch.full((1, 3), 1.0))


def test_air_that_is_only_a_bank_is_not_empty() -> None:
    assert not Air(banks=(FogBank(BLOCK, 0.1),)).empty
    assert Air(banks=(FogBank(BLOCK, 0.0),)).empty
    assert Air(banks=(FogBank(BLOCK, 0.1),)).at_time(3.0).banks[0].time == 3.0


def test_what_is_no_constituent_is_refused() -> None:
    fog = ExponentialDecay(0.1, 10.0)
    for wrong in ({"albedo": 1.1}, {"colour": (1.0, -1.0, 1.0)}, {"phase": "mie"}, {"asymmetry": 1.0}):
        with pytest.raises(ParameterError):
            Constituent(fog, **wrong)
