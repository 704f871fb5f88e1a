"""The fused look-up is the one in torch: on every shape of table, outside, at its samples, and in any number of threads."""

import pytest
import torch

pytest.importorskip("numba")

from render import fused_trilinear
from render.fused import torch_loops_only
from render.fused_trilinear import look_up_trilinear
from render.trilinear import TrilinearTable
from tests.support.volumes import noise_box

SHAPES = [(4, 3, 5), (1, 1, 1), (1, 3, 4), (3, 1, 4), (3, 4, 1), (1, 1, 2), (2, 2, 2), (1, 50, 1)]


def table_of(shape: tuple[int, int, int]) -> TrilinearTable:
    return TrilinearTable(torch.rand(shape, generator=torch.Generator().manual_seed(0)))


def points(shape: tuple[int, int, int], count: int = 2000, margin: float = 2.0) -> torch.Tensor:
    """Coordinates x, y, z `(3, point)`, inside and outside; a third of them whole numbers."""
    last = torch.tensor([n - 1.0 for n in reversed(shape)])[:, None]
    at = torch.rand(3, count, generator=torch.Generator().manual_seed(1)) * (last + 2.0 * margin) - margin
    at[:, ::3] = at[:, ::3].round()
    return at


def by_torch(table: TrilinearTable, at: torch.Tensor) -> torch.Tensor:
    with torch_loops_only():
        return table.look_up(*at)


@pytest.mark.parametrize("shape", SHAPES)
def test_it_finds_what_torch_finds(shape: tuple[int, int, int]) -> None:
    table, at = table_of(shape), points(shape)
    found = look_up_trilinear(table.padded, *at)
    torch.testing.assert_close(found, by_torch(table, at), rtol=1e-6, atol=1e-6)
    if max(shape) > 1:
        assert not torch.allclose(found, by_torch(table, at + 0.3), atol=1e-3)


@pytest.mark.parametrize("edge", [torch.inf, -torch.inf, 1e30, -1e30, torch.finfo(torch.float32).max])
def test_whatever_lies_far_outside_is_held(edge: float) -> None:
    table, at = table_of((4, 3, 5)), torch.full((3, 2), edge)
    corner = table.values[-1, -1, -1] if edge > 0 else table.values[0, 0, 0]
    assert torch.equal(look_up_trilinear(table.padded, *at), corner.expand(2))
    assert torch.equal(by_torch(table, at), corner.expand(2))


def test_no_number_is_held_at_the_first_sample() -> None:
    table = table_of((4, 3, 5))
    assert look_up_trilinear(table.padded, *torch.full((3, 1), torch.nan)).item() == table.values[0, 0, 0]


def test_empty_volumes_and_no_points_are_nothing() -> None:
    zeros = TrilinearTable(torch.zeros(3, 3, 3))
    assert not look_up_trilinear(zeros.padded, *points((3, 3, 3))).any()
    assert look_up_trilinear(zeros.padded, *torch.zeros(3, 0)).shape == (0,)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("chunk", [1, 7, 1 << 20])
def test_threads_and_chunks_are_no_part_of_the_result(
    threads: int, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, at = noise_box().table, points((6, 6, 6), 500)
    expected = look_up_trilinear(table.padded, *at)
    monkeypatch.setattr(fused_trilinear, "CHUNK", chunk)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        assert torch.equal(look_up_trilinear(table.padded, *at), expected)
    finally:
        torch.set_num_threads(before)


def test_steps_between_coordinates_do_not_matter() -> None:
    table, at = table_of((4, 3, 5)), points((4, 3, 5))
    expected = look_up_trilinear(table.padded, *at)
    apart = at.T.contiguous().T
    assert not apart[0].is_contiguous()
    assert torch.equal(look_up_trilinear(table.padded, *apart), expected)
