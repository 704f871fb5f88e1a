"""Cubic weights: parabolas exact, smooth, local, and held at the border."""

import pytest
import torch

from render.errors import ParameterError
from render.interpolation import cubic_weights

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


@pytest.mark.parametrize("count", [3, 4, 6])
def test_parabolas_are_exact_and_cubics_are_not(count: int) -> None:
    nodes = NODES[:count]
    values = INSIDE[nodes[-1] >= INSIDE]
    weights = cubic_weights(nodes, values)

    def parabola(x: torch.Tensor) -> torch.Tensor:
        return 2.0 - 3.0 * x + 0.5 * x * x

    torch.testing.assert_close(weights @ parabola(nodes), parabola(values))
    assert not torch.allclose(weights @ nodes**3, values**3)


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

    inner = NODES[1:-1]
    below, above = value_and_slope(inner - 1e-9), value_and_slope(inner + 1e-9)
    torch.testing.assert_close(below[0], above[0], atol=1e-7, rtol=0.0)
    torch.testing.assert_close(below[1], above[1], atol=1e-6, rtol=0.0)
    assert value_and_slope(inner - 0.05)[1].sub(above[1]).abs().min() > 1e-2


def test_gradients_are_those_of_central_differences() -> None:
    x = torch.tensor([-0.99, -0.5, 0.1, 0.31, 2.2, 6.99], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: cubic_weights(NODES, v), x)


def test_at_most_four_nodes_matter() -> None:
    touched = cubic_weights(NODES, INSIDE) != 0.0
    assert int(touched.sum(1).max()) == 4
    assert not touched[INSIDE < 0.0][:, 3:].any()


@pytest.mark.parametrize("nodes", [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0, 1.0], [0.0, float("nan")]])
def test_nodes_that_do_not_rise_are_refused(nodes: list[float]) -> None:
    with pytest.raises(ParameterError, match="rise"):
        cubic_weights(torch.tensor(nodes), torch.tensor([0.5]))


def test_precision_is_that_of_the_values() -> None:
    assert cubic_weights(NODES, torch.tensor([0.5])).dtype == torch.float32
    assert cubic_weights(NODES.float(), torch.tensor([0.5], dtype=torch.float64)).dtype == torch.float64
