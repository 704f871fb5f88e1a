import pytest
import torch

from cloudfit.losses.soft_histogram import soft_histogram, soft_l1_distance


def test_a_value_between_two_levels_is_shared_by_them() -> None:
    values = torch.tensor([[100.25, 100.25, 7.0, 255.0]], dtype=torch.float64) / 255.0
    histogram = soft_histogram(values)[0]
    expected = torch.zeros(256, dtype=torch.float64)
    expected[100], expected[101], expected[7], expected[255] = 0.375, 0.125, 0.25, 0.25
    torch.testing.assert_close(histogram, expected, rtol=0, atol=1e-12)


def test_whole_levels_give_the_ordinary_histogram() -> None:
    levels = torch.randint(0, 256, (3, 4000), generator=torch.Generator().manual_seed(0))
    counted = torch.stack([torch.bincount(row, minlength=256) for row in levels]).double() / 4000
    torch.testing.assert_close(soft_histogram(levels.double() / 255.0), counted, rtol=0, atol=1e-12)
    # float32 values are off their level by rounding alone.
    torch.testing.assert_close(soft_histogram(levels.float() / 255.0), counted, rtol=0, atol=1e-5)


def test_values_beyond_the_display_count_at_its_ends_and_have_no_gradient() -> None:
    values = torch.tensor([[-0.5, 1.5, 0.4999]], dtype=torch.float64, requires_grad=True)
    histogram = soft_histogram(values)
    assert histogram[0, [0, 255]].tolist() == pytest.approx([1 / 3, 1 / 3])
    (gradient,) = torch.autograd.grad((histogram * torch.arange(256.0) ** 2).sum(), values)
    assert gradient[0, :2].tolist() == [0.0, 0.0]
    # The slope of b^2 between levels 127 and 128, over three pixels.
    assert float(gradient[0, 2]) == pytest.approx(255.0 * (128**2 - 127**2) / 3)


def test_a_quarter_of_a_level_moves_a_quarter_of_the_mass() -> None:
    values = torch.full((1, 10), 100.0 / 255.0, dtype=torch.float64)
    target = soft_histogram(values)
    assert float(soft_l1_distance(values + 0.25 / 255.0, target)) == pytest.approx(0.5)
    assert float(soft_l1_distance(values + 3.0 / 255.0, target)) == pytest.approx(2.0)
