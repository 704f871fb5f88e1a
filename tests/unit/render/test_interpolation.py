"""Cubic weights: cubics exact, smooth, local, and held at the border."""

import pytest
import torch

from render.errors import ParameterError
from render.interpolation import cubic_weights, interpolate_limited, interpolate_limited_each, limited_slopes

NODES = torch.tensor([-1.0, 0.0, 0.3, 2.0, 2.5, 7.0], dtype=torch.float64)
INSIDE = torch.linspace(-1.0, 7.0, 401, dtype=torch.float64)


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_rows_sum_to_one(count: int) -> None:
    weights = cubic_weights(NODES[:count], torch.linspace(-3.0, 9.0, 100, dtype=torch.float64))
    assert weights.shape == (100, count)
    torch.testing.assert_close(weights.sum(1), torch.ones(100, dtype=torch.float64))


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_nodes_are_reproduced(count: int) -> None:
    torch.testing.assert_close(cubic_weights(NODES[:count], NODES[:count]), torch.eye(count, dtype=torch.float64))


@pytest.mark.parametrize("count", [4, 5, 6])
def test_cubics_are_exact_and_higher_powers_are_not(count: int) -> None:
    nodes = NODES[:count]
    values = INSIDE[nodes[-1] >= INSIDE]
    weights = cubic_weights(nodes, values)

    def cubic(x: torch.Tensor) -> torch.Tensor:
        return 2.0 - 3.0 * x + 0.5 * x * x - 0.1 * x**3

    torch.testing.assert_close(weights @ cubic(nodes), cubic(values))
    assert not torch.allclose(weights @ nodes**4, values**4)


def test_parabolas_are_exact_with_three_nodes() -> None:
    values = INSIDE[NODES[2] >= INSIDE]
    torch.testing.assert_close(cubic_weights(NODES[:3], values) @ NODES[:3] ** 2, values**2)


def test_halving_the_distances_divides_the_error_by_sixteen() -> None:
    values = torch.linspace(0.2, 5.8, 500, dtype=torch.float64)
    errors = []
    for count in (13, 25, 49):
        nodes = torch.linspace(0.0, 6.0, count, dtype=torch.float64)
        errors.append(float((cubic_weights(nodes, values) @ nodes.sin() - values.sin()).abs().max()))
    assert errors[0] / errors[1] > 13.0
    assert errors[1] / errors[2] > 13.0


def test_two_nodes_are_joined_by_a_line_and_one_is_a_constant() -> None:
    nodes = torch.tensor([1.0, 3.0])
    torch.testing.assert_close(cubic_weights(nodes, torch.tensor([1.5])), torch.tensor([[0.75, 0.25]]))
    assert cubic_weights(nodes[:1], torch.tensor([-5.0, 1.0, 9.0])).tolist() == [[1.0], [1.0], [1.0]]


def test_values_outside_are_held() -> None:
    weights = cubic_weights(NODES, torch.tensor([-9.0, 99.0], dtype=torch.float64))
    torch.testing.assert_close(weights, torch.eye(6, dtype=torch.float64)[[0, -1]])


def test_value_and_derivative_are_continuous() -> None:
    samples = torch.tensor([1.0, -2.0, 0.5, 3.0, -1.0, 2.0], dtype=torch.float64)

    def value_and_slope(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = x.clone().requires_grad_()
        value = cubic_weights(NODES, x) @ samples
        return value.detach(), torch.autograd.grad(value.sum(), x)[0]

    samples[2] += 1.0  # a kink of the second derivative, not a parabola by chance
    inner = NODES[1:-1]
    below, above = value_and_slope(inner - 1e-9), value_and_slope(inner + 1e-9)
    torch.testing.assert_close(below[0], above[0], atol=1e-7, rtol=0.0)
    torch.testing.assert_close(below[1], above[1], atol=1e-6, rtol=0.0)
    assert value_and_slope(inner - 0.05)[1].sub(above[1]).abs().min() > 1e-2


def test_gradients_are_those_of_central_differences() -> None:
    x = torch.tensor([-0.99, -0.5, 0.1, 0.31, 2.2, 6.99], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: cubic_weights(NODES, v), x)


def test_at_most_six_nodes_matter() -> None:
    nodes = torch.linspace(0.0, 9.0, 10, dtype=torch.float64)
    touched = cubic_weights(nodes, torch.linspace(0.0, 9.0, 300, dtype=torch.float64)) != 0.0
    assert int(touched.sum(1).max()) == 6
    assert not touched[:30, 5:].any()


@pytest.mark.parametrize("nodes", [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0, 1.0], [0.0, float("nan")]])
def test_nodes_that_do_not_rise_are_refused(nodes: list[float]) -> None:
    with pytest.raises(ParameterError, match="rise"):
        cubic_weights(torch.tensor(nodes), torch.tensor([0.5]))


def test_precision_is_that_of_the_values() -> None:
    assert cubic_weights(NODES, torch.tensor([0.5])).dtype == torch.float32
    assert cubic_weights(NODES.float(), torch.tensor([0.5], dtype=torch.float64)).dtype == torch.float64


def limited(samples: torch.Tensor, values: torch.Tensor, nodes: torch.Tensor = NODES) -> torch.Tensor:
    """Values `(population, row)` of samples `(row, node)`."""
    return interpolate_limited(nodes, samples, limited_slopes(nodes, samples), values)


def test_smooth_samples_are_interpolated_as_without_limits() -> None:
    even = torch.linspace(0.0, 6.0, 13, dtype=torch.float64)
    samples = torch.stack([2.0 + 3.0 * even, (even + 1.0) ** 2, 1.0 - even])
    values = torch.linspace(-1.0, 7.0, 300, dtype=torch.float64)
    expected = cubic_weights(even, values) @ samples.T
    torch.testing.assert_close(limited(samples, values, even), expected)
    bent = torch.where(even > 3.0, 100.0, samples)
    assert not torch.allclose(limited(bent, values, even), cubic_weights(even, values) @ bent.T)


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_limited_curves_meet_their_samples_and_are_held_at_the_border(count: int) -> None:
    nodes, samples = (
        NODES[:count],
        torch.randn(4, count, dtype=torch.float64, generator=torch.Generator().manual_seed(0)),
    )
    torch.testing.assert_close(limited(samples, nodes, nodes), samples.T)
    ends = limited(samples, torch.tensor([-1e9, 1e9], dtype=torch.float64), nodes)
    torch.testing.assert_close(ends, samples[:, [0, -1]].T)
    assert limited(samples, nodes[:0], nodes).shape == (0, 4)


def test_beside_a_cliff_nothing_leaves_the_range_of_its_two_samples() -> None:
    samples = torch.tensor([[-85.0, -85.0, -85.0, -3.0, -2.5, -2.4]], dtype=torch.float64)
    inside = INSIDE[NODES[-2] >= INSIDE]  # the slope at the last node may point back, by three last secants at most
    found = limited(samples, inside)[:, 0]
    cell = (torch.searchsorted(NODES, inside, right=True) - 1).clamp(0, len(NODES) - 2)
    low, high = samples[0, cell], samples[0, cell + 1]
    assert (found >= torch.minimum(low, high) - 1e-9).all()
    assert (found <= torch.maximum(low, high) + 1e-9).all()
    assert (found.diff() >= -1e-9).all()
    assert float((limited(samples, INSIDE) - samples[0, -1]).max()) < 0.5 * float(samples[0, -1] - samples[0, -2])
    plain = cubic_weights(NODES, inside) @ samples[0]
    assert float((plain - torch.maximum(low, high)).max()) > 0.4


def test_limited_interpolation_is_differentiable() -> None:
    samples = torch.randn(2, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    values = torch.tensor([-0.9, 0.1, 1.7, 6.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: limited(samples, v), (values,))


def limited_each(samples: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Values `(population, row)` where every value has the same samples `(row, node)`."""
    return interpolate_limited_each(NODES, samples.expand(len(values), -1, -1), values)


def test_each_value_has_samples_of_its_own() -> None:
    samples = torch.randn(5, 3, len(NODES), dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    values = torch.tensor([-9.0, 0.1, 1.7, 2.5, 9.0], dtype=torch.float64)
    rows = [interpolate_limited_each(NODES, samples[n : n + 1], values[n : n + 1]) for n in range(5)]
    torch.testing.assert_close(interpolate_limited_each(NODES, samples, values), torch.cat(rows))
    assert interpolate_limited_each(NODES[:1], samples[..., :1], values).shape == (5, 3)


def test_smooth_samples_of_each_are_interpolated_as_without_limits() -> None:
    samples = torch.stack([(0.2 * NODES).exp(), 3.0 - NODES])
    torch.testing.assert_close(limited_each(samples, INSIDE), cubic_weights(NODES, INSIDE) @ samples.T)


def test_a_cliff_does_not_bend_the_samples_of_each_beside_it() -> None:
    samples = torch.tensor([[3.0, -25.0, -85.0, 240.0, 90.0, 80.0]], dtype=torch.float64)
    found = limited_each(samples, INSIDE)[:, 0]
    assert float(found.max()) < 300.0
    assert (
        float((cubic_weights(NODES, INSIDE) @ samples[0]).max()) > 300.0
        or float((cubic_weights(NODES, INSIDE) @ samples[0]).min()) < float(found.min()) - 1.0
    )


def test_interpolation_of_each_is_differentiable() -> None:
    samples = torch.randn(2, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    values = torch.tensor([-0.9, 0.1, 1.7, 6.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: limited_each(samples, v), (values,))


def test_slopes_need_rising_nodes() -> None:
    with pytest.raises(ParameterError, match="rise"):
        limited_slopes(torch.tensor([0.0, 0.0, 1.0]), torch.zeros(1, 3))
