"""Interpolation: exact for what is linear in each axis, held at the border, differentiable."""

import pytest
import torch

from render.atmosphere import table_interpolation
from render.atmosphere.table_interpolation import interpolate_table, nearest_nodes
from tests.support.atmospheres import tensor

SIZES = (3, 4, 2, 5)


def multilinear(*places: torch.Tensor) -> torch.Tensor:
    a, b, c, d = places
    return torch.stack([1.0 + a * b - 2.0 * c * d, a * b * c * d, d - a], -1)


def table() -> torch.Tensor:
    return multilinear(*torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in SIZES), indexing="ij"))


def points(count: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    return [torch.rand(count, generator=generator, dtype=torch.float64) * (n - 1) for n in SIZES]


def test_multilinear_functions_are_reproduced(monkeypatch: pytest.MonkeyPatch) -> None:
    places = points(100)
    found = interpolate_table(table(), places)
    torch.testing.assert_close(found, multilinear(*places))
    assert not torch.allclose(interpolate_table(table(), [places[0], places[1], places[2], 0.9 * places[3]]), found)
    monkeypatch.setattr(table_interpolation, "POINTS_AT_ONCE", 7)
    assert torch.equal(interpolate_table(table(), places), found)


def test_nodes_are_met_exactly_and_borders_held() -> None:
    values = table()
    corners = [tensor(0.0, n - 1.0, -3.0, n + 5.0) for n in SIZES]
    found = interpolate_table(values, corners)
    first, last = values[0, 0, 0, 0], values[-1, -1, -1, -1]
    assert torch.equal(found, torch.stack([first, last, first, last]))


def test_places_broadcast() -> None:
    places = [tensor(0.5, 1.5)[:, None], tensor(0.2, 0.4, 2.5), tensor(0.5), tensor(3.25)]
    found = interpolate_table(table(), places)
    assert found.shape == (2, 3, 3)
    torch.testing.assert_close(found, multilinear(*torch.broadcast_tensors(*places)))
    assert interpolate_table(table(), [torch.zeros(0, dtype=torch.float64)] * 4).shape == (0, 3)


def test_gradients_are_those_of_the_function() -> None:
    places = [place.requires_grad_() for place in points(5)]
    values = table().requires_grad_()
    interpolate_table(values, places)[:, 0].sum().backward()
    torch.testing.assert_close(places[0].grad, places[1].detach())
    assert values.grad is not None
    assert float(values.grad.sum()) == pytest.approx(5.0)


def test_neighbours_and_weights() -> None:
    lower, above = nearest_nodes(tensor(-1.0, 0.0, 1.25, 3.0, 9.0), 4)
    assert lower.tolist() == [0, 0, 1, 2, 2]
    torch.testing.assert_close(above, tensor(0.0, 0.0, 0.25, 1.0, 1.0))


def test_float32_tables_give_float32_values() -> None:
    found = interpolate_table(table().float(), points(3))
    assert found.dtype == torch.float32
