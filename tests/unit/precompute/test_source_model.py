"""The model of the source: what its features are, and that noise averages out in it."""

import math

import pytest
import torch

from precompute import source_model
from precompute.source_model import DIRECTIONS, FEATURES, POINTS_PER_FEATURE, SourceModel, measure_surroundings
from render.density_grid import DensityGrid
from tests.support.volumes import noise_box, towards, view_north

SUN = towards(60.0, 40.0)
ENOUGH = POINTS_PER_FEATURE * FEATURES


def block(density: float = 0.5) -> DensityGrid:
    return DensityGrid.from_voxel_size(torch.full((12, 12, 12), density), 1.0)


def places(count: int, seed: int = 0) -> torch.Tensor:
    return 8.0 * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) - 4.0


def test_directions_are_unit_vectors_all_around() -> None:
    torch.testing.assert_close(DIRECTIONS.norm(dim=1), torch.ones(14))
    torch.testing.assert_close(DIRECTIONS.sum(0), torch.zeros(3), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(DIRECTIONS.T @ DIRECTIONS, 14.0 / 3.0 * torch.eye(3), atol=1e-5, rtol=0.0)


def test_optical_lengths_reach_to_the_border() -> None:
    grid, position = block(), torch.tensor([[1.0, -2.0, 3.0], [0.0, 0.0, 0.0]])
    found = measure_surroundings(grid, view_north(8, 6, 30.0), torch.tensor([0.0, 0.0, 1.0]), position)
    torch.testing.assert_close(found.sun, 0.5 * torch.tensor([3.0, 6.0]), rtol=1e-4, atol=0.0)
    # The camera looks north, so it stands in the south.
    assert float(found.camera[1]) == pytest.approx(3.0, rel=0.05)
    torch.testing.assert_close(found.around[1, :6], torch.full((6,), 3.0), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(found.around[1, 6:], torch.full((8,), 3.0 * math.sqrt(3.0)), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(
        found.around[0, :6], 0.5 * torch.tensor([5.0, 8.0, 3.0, 7.0, 4.0, 9.0]), rtol=1e-4, atol=0.0
    )
    torch.testing.assert_close(found.cosine, DIRECTIONS[:, 2])


@pytest.mark.parametrize("extinction", [0.0, 1e-9, 0.3, 1e6])
def test_features_are_finite_and_bounded(extinction: float) -> None:
    surroundings = measure_surroundings(noise_box(), view_north(8, 6, 30.0), SUN, places(ENOUGH))
    features = surroundings.features(extinction)
    assert features.shape == (ENOUGH, FEATURES)
    assert torch.isfinite(features).all()
    assert (features[:, 0] == 1.0).all()
    assert float(features.abs().max()) < 30.0
    expected = SourceModel(features, torch.full((ENOUGH,), 4)).expect(torch.ones(ENOUGH, 2))
    torch.testing.assert_close(expected, torch.ones(ENOUGH, 2), rtol=1e-3, atol=1e-3)


def test_few_points_have_a_mean_only() -> None:
    surroundings = measure_surroundings(noise_box(), view_north(8, 6, 30.0), SUN, places(ENOUGH - 1))
    assert surroundings.features(0.5).shape == (ENOUGH - 1, 1)
    source, paths = torch.tensor([[1.0], [4.0]]), torch.tensor([4, 8])
    model = SourceModel(torch.ones(2, 1), paths)
    torch.testing.assert_close(model.expect(source), torch.full((2, 1), 3.0))


def test_what_the_features_span_is_found_through_noise() -> None:
    surroundings = measure_surroundings(noise_box(), view_north(8, 6, 30.0), SUN, places(4 * ENOUGH))
    features = surroundings.features(0.4)
    generator = torch.Generator().manual_seed(3)
    truth = features @ torch.rand(FEATURES, 3, generator=generator)
    paths = 2 ** torch.randint(2, 8, (len(truth),), generator=generator)
    noise = truth.std() * torch.randn(truth.shape, generator=generator) * (8.0 / paths[:, None]).sqrt()
    error = SourceModel(features, paths).expect(truth + noise) - truth
    share = float((paths[:, None] * error.square()).mean() / (paths[:, None] * noise.square()).mean())
    # Least squares leave as much of the noise's power as there are features for each point; the ridge takes the nearly equal ones.
    assert 0.3 * FEATURES / len(truth) < share < 1.2 * FEATURES / len(truth)
    assert float((SourceModel(features, paths).expect(truth) - truth).abs().max()) < 1e-3 * float(truth.std())


def test_one_point_and_no_point() -> None:
    for count in (0, 1):
        found = measure_surroundings(block(), view_north(8, 6, 30.0), SUN, places(count))
        features = found.features(1.0)
        assert features.shape == (count, 1)
    assert torch.isfinite(found.place).all()
    assert source_model.SHARES[0] == 1.0


def test_a_feature_that_is_zero_everywhere_does_no_harm() -> None:
    features = torch.stack([torch.ones(50), torch.zeros(50), torch.linspace(-1.0, 1.0, 50)], dim=1)
    source = (2.0 + 3.0 * features[:, 2])[:, None]
    torch.testing.assert_close(SourceModel(features, torch.full((50,), 4)).expect(source), source, rtol=1e-5, atol=1e-5)
