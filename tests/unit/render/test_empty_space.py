"""Clearances are the Chebyshev distances of cells to the nearest that holds anything."""

import pytest
import torch
from torch import Tensor

from render.empty_space import FARTHEST, measure_clearance


def filled_cells(values: Tensor) -> Tensor:
    """Numbers of the cells with a corner above zero `(cell, 3)`."""
    corners = torch.cartesian_prod(*(torch.arange(n - 1) for n in values.shape))
    return torch.stack(
        [c for c in corners if bool((values[c[0] : c[0] + 2, c[1] : c[1] + 2, c[2] : c[2] + 2] > 0).any())]
    )


@pytest.mark.parametrize("filled", [1, 3, 40])
def test_distance_is_the_smallest_to_any_cell(filled: int) -> None:
    values = torch.zeros(9, 7, 11)
    generator = torch.Generator().manual_seed(filled)
    values.view(-1)[torch.randperm(values.numel(), generator=generator)[:filled]] = 0.5
    clearance = measure_clearance(values)
    cells, full = torch.cartesian_prod(*(torch.arange(n - 1) for n in values.shape)), filled_cells(values)
    expected = (cells[:, None] - full[None]).abs().amax(-1).amin(-1)
    assert clearance.flatten().tolist() == expected.tolist()


def test_nothing_is_as_far_as_a_byte_holds() -> None:
    assert bool((measure_clearance(torch.zeros(3, 2, 4)) == FARTHEST).all())
    far = torch.zeros(2, 2, 400)
    far[0, 0, 0] = 1.0
    assert measure_clearance(far)[0, 0, [0, 1, 200, 398]].tolist() == [0, 1, 200, FARTHEST]


def test_a_full_table_has_no_clearance() -> None:
    assert int(measure_clearance(torch.ones(4, 3, 2)).sum()) == 0
