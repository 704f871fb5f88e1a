"""L-BFGS: its product with the inverse Hessian against the dense formula, its convergence against steepest descent."""

import pytest
import torch
from torch import Tensor

from cloudfit.optimisers.base import Budget, StopReason
from cloudfit.optimisers.gradient_descent import GradientMinimiser
from cloudfit.optimisers.lbfgs import Lbfgs, multiply_inverse_hessian, remember_pairs
from render.errors import ParameterError


def random_pairs(seed: int) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(4, 4, generator=generator, dtype=torch.float64)
    steps = torch.randn(2, 3, 4, generator=generator, dtype=torch.float64)
    return torch.randn(2, 4, generator=generator, dtype=torch.float64), steps, steps @ (root @ root.T + torch.eye(4))


def test_the_two_loops_are_the_dense_update() -> None:
    gradient, steps, changes = random_pairs(1)
    expected = []
    for g, row_steps, row_changes in zip(gradient, steps, changes, strict=True):
        s, y = row_steps[-1], row_changes[-1]
        inverse = (s @ y) / (y @ y) * torch.eye(4, dtype=torch.float64)
        for s, y in zip(row_steps, row_changes, strict=True):
            left = torch.eye(4, dtype=torch.float64) - torch.outer(s, y) / (s @ y)
            inverse = left @ inverse @ left.T + torch.outer(s, s) / (s @ y)
        expected.append(inverse @ g)
    product = multiply_inverse_hessian(gradient, steps, changes)
    torch.testing.assert_close(product, torch.stack(expected))
    assert not torch.allclose(multiply_inverse_hessian(gradient, steps.flip(1), changes.flip(1)), product)


def test_empty_places_of_the_memory_do_nothing() -> None:
    gradient, steps, changes = random_pairs(2)
    none = torch.zeros(2, 2, 4, dtype=torch.float64)
    longer = multiply_inverse_hessian(gradient, torch.cat([none, steps], dim=1), torch.cat([none, changes], dim=1))
    torch.testing.assert_close(longer, multiply_inverse_hessian(gradient, steps, changes))
    assert torch.equal(multiply_inverse_hessian(gradient, none, none), gradient)


def test_only_pairs_of_positive_curvature_are_kept() -> None:
    memory = torch.arange(12.0).reshape(3, 2, 2)
    step = torch.tensor([[1.0, 0.0]] * 3)
    change = torch.tensor([[2.0, 1.0], [-2.0, 1.0], [2.0, 1.0]])
    steps, changes = remember_pairs(memory, memory, step, change, torch.tensor([True, True, False]))
    assert steps[0].tolist() == [[2.0, 3.0], [1.0, 0.0]]
    assert changes[0].tolist() == [[2.0, 3.0], [2.0, 1.0]]
    assert torch.equal(steps[1:], memory[1:])


class Canyon:
    """An ill-conditioned rotated quadratic whose minimum is at 0.4, or outside where it is moved."""

    def __init__(self, centre: float = 0.4) -> None:
        self.centre = centre
        rotation = torch.linalg.qr(torch.randn(5, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64))[
            0
        ]
        self.hessian = rotation @ torch.diag(torch.logspace(0, 3, 5, dtype=torch.float64)) @ rotation.T

    def __call__(self, population: Tensor) -> Tensor:
        return self.with_gradient(population)[0]

    def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        offset = population.double() - self.centre
        return 0.5 * ((offset @ self.hessian) * offset).sum(dim=1), offset @ self.hessian


def test_a_canyon_takes_tens_of_batches() -> None:
    result = GradientMinimiser(Lbfgs(), starts=4).minimise(Canyon(), 5, Budget(), 1)
    assert result.stop_reason is StopReason.CONVERGED
    assert result.iterations < 80
    torch.testing.assert_close(result.best, torch.full((5,), 0.4), rtol=0, atol=1e-3)
    # Without a memory of the curvature to speak of it takes far longer.
    forgetful = GradientMinimiser(Lbfgs(memory=1), starts=4).minimise(Canyon(), 5, Budget(), 1)
    assert forgetful.iterations > 1.5 * result.iterations


def test_descents_that_have_converged_cost_nothing() -> None:
    sizes: list[int] = []

    class Counted(Canyon):
        def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
            sizes.append(len(population))
            return super().with_gradient(population)

    GradientMinimiser(Lbfgs(), starts=8).minimise(Counted(), 5, Budget(), 1)
    assert sizes[0] == 8
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 8


def test_minima_outside_are_met_at_the_bounds() -> None:
    class Shifted(Canyon):
        def with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
            offset = population.double() - torch.tensor([-0.5, 0.3, 1.5])
            return (offset**2).sum(dim=1), 2.0 * offset

    result = GradientMinimiser(Lbfgs(), starts=4).minimise(Shifted(), 3, Budget(), 1)
    torch.testing.assert_close(result.best, torch.tensor([0.0, 0.3, 1.0]), rtol=0, atol=1e-4)


def test_batches_are_limited_and_numbers_checked() -> None:
    result = GradientMinimiser(Lbfgs(largest_iterations=3)).minimise(Canyon(), 5, Budget(), 1)
    assert (result.stop_reason, result.iterations) == (StopReason.ITERATIONS, 3)
    for keywords in ({"memory": 0}, {"first_step": 0.0}, {"tolerance": 0.0}, {"largest_iterations": 0}):
        with pytest.raises(ParameterError, match="expected a memory"):
            Lbfgs(**keywords)  # type: ignore[arg-type]
