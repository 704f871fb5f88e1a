"""What every loss of the registry must keep, whichever kind it is."""

import math

import pytest
import torch
from torch import Tensor

from cloudfit.losses import LOSSES, AnyLoss, Loss, PhotographValues, PixelLoss, find_loss
from render.errors import ParameterError

BINS = 256

HISTOGRAM_NAMES = [name for name, loss in LOSSES.items() if isinstance(loss, Loss)]
PIXEL_NAMES = [name for name, loss in LOSSES.items() if isinstance(loss, PixelLoss)]

OPPOSITE = {
    "l1": 2.0,
    # Two single bins out of n correlate with r = -1 / (n - 1).
    "correlation": 1.0 + 1.0 / (BINS - 1),
    "chi_square": 1.0,
    "chi_square_symmetric": 4.0,
    "intersection": 1.0,
    "bhattacharyya": 1.0,
    "wasserstein": 255.0,
    "squared_difference": 1.0,
    "soft_l1": 2.0,
    "sorted_wasserstein": 255.0,
}
"""Loss of a white image before a black one, by hand."""


def random_histograms(*leading: int, seed: int = 0) -> Tensor:
    values = torch.rand(*leading, BINS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) ** 4
    return values / values.sum(dim=-1, keepdim=True)


def random_values(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def single_level(level: int) -> Tensor:
    return torch.nn.functional.one_hot(torch.tensor(level), BINS).double()


def target_of(loss: PixelLoss, image: Tensor) -> Tensor:
    """Target of a photograph that shows the image `(channel, pixel)` and nothing else."""
    return loss.prepare(PhotographValues(image, image))


def pixel_loss(name: str) -> PixelLoss:
    loss = LOSSES[name]
    assert isinstance(loss, PixelLoss)
    return loss


def test_every_kind_of_loss_that_is_promised_is_there() -> None:
    assert list(LOSSES) == list(OPPOSITE)
    assert {name for name, loss in LOSSES.items() if loss.is_differentiable} == set(PIXEL_NAMES)
    assert [name for name in PIXEL_NAMES if pixel_loss(name).is_paired] == ["squared_difference"]


@pytest.mark.parametrize("name", HISTOGRAM_NAMES)
def test_histogram_losses_are_smallest_at_equality_and_only_there(name: str) -> None:
    loss = LOSSES[name]
    first, second = random_histograms(5, 3, seed=1), random_histograms(5, 3, seed=2)
    values = loss(first, second)
    assert loss.name == name
    assert values.dtype == torch.float64
    assert values.shape == (5, 3)
    # The optimum is exact, also of spiky, flat and empty histograms.
    flat = torch.full((BINS,), 0.1 / BINS)
    for histogram in (first, single_level(0), single_level(255), flat, torch.zeros(BINS)):
        assert bool((loss(histogram, histogram) == loss.optimum).all())
    assert bool((values > loss.optimum).all())
    assert bool((values <= loss.worst).all())
    assert float(loss(single_level(0), single_level(255))) == pytest.approx(OPPOSITE[name], rel=1e-12)
    torch.testing.assert_close(loss(first, second[0]), torch.stack([loss(row, second[0]) for row in first]))
    assert bool(loss(torch.full((BINS,), math.nan), second[0, 0]).isnan())
    one_nan = second[0, 0].clone()
    one_nan[7] = math.nan
    assert bool(loss(one_nan, single_level(3)).isnan())


@pytest.mark.parametrize("name", HISTOGRAM_NAMES)
def test_all_but_chi_square_take_either_side_for_the_photograph(name: str) -> None:
    first, second = random_histograms(5, seed=1), random_histograms(5, seed=2)
    there, back = LOSSES[name](first, second), LOSSES[name](second, first)
    assert torch.allclose(there, back, rtol=1e-12) is (name != "chi_square")


@pytest.mark.parametrize("name", HISTOGRAM_NAMES)
def test_only_the_earth_mover_sees_which_levels_are_neighbours(name: str) -> None:
    first, second = random_histograms(seed=1), random_histograms(seed=2)
    shuffle = torch.randperm(BINS, generator=torch.Generator().manual_seed(3))
    alike = torch.allclose(LOSSES[name](first, second), LOSSES[name](first[shuffle], second[shuffle]), rtol=1e-9)
    assert alike is (name != "wasserstein")


@pytest.mark.parametrize("name", PIXEL_NAMES)
def test_pixel_losses_are_smallest_at_equality_and_only_there(name: str) -> None:
    loss = pixel_loss(name)
    image, other = random_values(3, 500, seed=1), random_values(3, 500, seed=2)
    target = target_of(loss, image)
    batch = torch.stack([image, other, torch.zeros_like(image), torch.ones_like(image)])
    values = loss(batch, target)
    assert loss.name == name
    assert values.dtype == torch.float64
    assert values.shape == (4, 3)
    assert bool((values[0] == loss.optimum).all())
    assert bool((values[1:] > loss.optimum).all())
    assert bool((values <= loss.worst).all())
    torch.testing.assert_close(values, torch.stack([loss(row, target) for row in batch]))
    white = target_of(loss, torch.ones_like(image))
    assert loss(torch.zeros_like(image), white).tolist() == pytest.approx([OPPOSITE[name]] * 3, rel=1e-12)
    batch[1, 2, 7] = math.nan
    assert loss(batch, target).isnan().nonzero().tolist() == [[1, 2]]
    # In float32 as in float64, but for rounding.
    torch.testing.assert_close(loss(batch[0].float(), target.float()), values[0], rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", PIXEL_NAMES)
def test_the_order_of_pixels_matters_to_paired_losses_alone(name: str) -> None:
    loss = pixel_loss(name)
    image, other = random_values(3, 500, seed=1), random_values(3, 500, seed=2)
    shuffled = other[:, torch.randperm(500, generator=torch.Generator().manual_seed(3))]
    alike = torch.allclose(loss(other, target_of(loss, image)), loss(shuffled, target_of(loss, image)), rtol=1e-9)
    assert alike is not loss.is_paired


@pytest.mark.parametrize("name", PIXEL_NAMES)
def test_gradients_are_those_of_central_differences(name: str) -> None:
    loss = pixel_loss(name)
    image = random_values(2, 40, seed=1).requires_grad_()
    target = target_of(loss, random_values(2, 40, seed=2))
    (gradient,) = torch.autograd.grad(loss(image, target).sum(), image)
    step = 1e-7  # no kink that near: the values are random
    steps = step * torch.eye(80, dtype=torch.float64).reshape(80, 2, 40)
    with torch.no_grad():
        expected = (loss(image + steps, target) - loss(image - steps, target)).sum(-1).reshape(2, 40) / (2 * step)
    torch.testing.assert_close(gradient, expected, rtol=1e-6, atol=1e-6)
    assert float(gradient.abs().max()) > 1e-3
    assert not torch.allclose(gradient, -expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", HISTOGRAM_NAMES)
def test_shape_errors_show_both_shapes(name: str) -> None:
    for shape in ((3, 255), (2, BINS), (1,), ()):
        with pytest.raises(ParameterError, match=r"\(3, 256\)"):
            LOSSES[name](torch.zeros(3, BINS), torch.zeros(shape))


@pytest.mark.parametrize("name", PIXEL_NAMES)
def test_shape_errors_of_pixel_losses_show_both_shapes(name: str) -> None:
    loss = pixel_loss(name)
    target = target_of(loss, torch.zeros(3, 9))
    for shape in ((2, 9), (9,), (3, 0), (5, 4, 9)):
        with pytest.raises(ParameterError, match=f"{name}: expected.*9|{name}: expected.*256"):
            loss(torch.zeros(shape), target)


def test_a_loss_is_found_by_its_name_or_the_names_are_told() -> None:
    found: AnyLoss = find_loss("soft_l1")
    assert found is LOSSES["soft_l1"]
    with pytest.raises(ParameterError, match="no loss is called 'l2'; there are l1, correlation"):
        find_loss("l2")


def test_registry_is_frozen() -> None:
    with pytest.raises(TypeError):
        LOSSES["l2"] = LOSSES["l1"]  # type: ignore[index]
