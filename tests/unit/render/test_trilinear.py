"""The look-up shared by every volume: exact where the table is trilinear, held outside, the same on both paths."""

import pytest
import torch

from render import trilinear
from render.errors import ParameterError
from render.fused import torch_loops_only
from render.trilinear import LOOK_UP_CHUNK, TrilinearTable

pytestmark = pytest.mark.usefixtures("loops")

COUNTS = (4, 3, 5)


def polynomial(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
    """Linear in each coordinate, different along each."""
    return 1.0 + 2.0 * x - 3.0 * y + 0.5 * z + x * y - 0.7 * y * z + 0.3 * x * z + 0.2 * x * y * z


def samples(dtype: torch.dtype = torch.float32) -> torch.Tensor:
    z, y, x = torch.meshgrid(*(torch.arange(n, dtype=dtype) for n in COUNTS), indexing="ij")
    return polynomial(x, y, z)


def points(count: int = 500, margin: float = 0.0) -> torch.Tensor:
    """Coordinates x, y, z `(3, point)` within the table and a margin around it."""
    last = torch.tensor([n - 1.0 for n in reversed(COUNTS)])[:, None]
    uniform = torch.rand(3, count, generator=torch.Generator().manual_seed(0))
    return uniform * (last + 2.0 * margin) - margin


def test_trilinear_functions_are_exact() -> None:
    x, y, z = points()
    found = TrilinearTable(samples()).look_up(x, y, z)
    torch.testing.assert_close(found, polynomial(x, y, z), rtol=1e-5, atol=1e-5)
    assert not torch.allclose(found, polynomial(z, y, x), atol=0.1)


def test_what_curves_is_interpolated_between_neighbours() -> None:
    table = TrilinearTable(torch.tensor([0.0, 1.0, 4.0, 9.0]).reshape(1, 1, 4))
    at = torch.tensor([0.0, 0.5, 1.0, 2.25, 3.0])
    torch.testing.assert_close(table.look_up(at, at * 0, at * 0), torch.tensor([0.0, 0.5, 1.0, 5.25, 9.0]))


def test_samples_are_returned_as_they_are() -> None:
    values = torch.rand(COUNTS, generator=torch.Generator().manual_seed(1))
    z, y, x = torch.meshgrid(*(torch.arange(float(n)) for n in COUNTS), indexing="ij")
    assert torch.equal(TrilinearTable(values).look_up(x, y, z), values)


def test_coordinates_outside_are_held_at_the_border() -> None:
    table = TrilinearTable(samples())
    x, y, z = points(margin=3.0)
    held = [c.clamp(0.0, n - 1.0) for c, n in zip((x, y, z), reversed(COUNTS), strict=True)]
    assert torch.equal(table.look_up(x, y, z), table.look_up(*held))
    torch.testing.assert_close(table.look_up(*torch.full((3, 1), 1e30)), samples()[-1:, -1, -1])
    torch.testing.assert_close(table.look_up(*torch.full((3, 1), -torch.inf)), samples()[:1, 0, 0])


@pytest.mark.parametrize("counts", [(1, 1, 1), (1, 3, 4), (3, 1, 4), (3, 4, 1), (1, 1, 2), (2, 2, 2)])
def test_axes_of_length_one_are_constant(counts: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    values = torch.rand(counts, generator=torch.Generator().manual_seed(2))
    x, y, z = points(margin=1.0)
    held = [c if n > 1 else c * 0 for c, n in zip((x, y, z), reversed(counts), strict=True)]
    found = TrilinearTable(values).look_up(x, y, z)
    assert torch.equal(found, TrilinearTable(values).look_up(*held))
    assert values.min() <= found.min() <= found.max() <= values.max()
    monkeypatch.setattr(trilinear, "CORNER_TABLE_VOXELS", 0)
    assert torch.equal(TrilinearTable(values).look_up(x, y, z), found)


def test_large_tables_are_gathered_to_the_same_values(monkeypatch: pytest.MonkeyPatch) -> None:
    with torch_loops_only():  # the fused loops store no corners
        compare_corner_tables(monkeypatch)


def compare_corner_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    values = torch.rand(COUNTS, generator=torch.Generator().manual_seed(3))
    x, y, z = points(margin=1.0)
    stored = TrilinearTable(values)
    expected = stored.look_up(x, y, z)
    monkeypatch.setattr(trilinear, "CORNER_TABLE_VOXELS", values.numel() - 1)
    gathered = TrilinearTable(values)
    assert torch.equal(gathered.look_up(x, y, z), expected)
    assert stored._corner_table is not None
    assert gathered._corner_table is None


def test_shapes_and_chunks_do_not_matter() -> None:
    table = TrilinearTable(samples())
    many = points(LOOK_UP_CHUNK + 10)
    found = table.look_up(*many)
    assert torch.equal(found[-12:], table.look_up(*many[:, -12:]))
    x, y, z = points(24).reshape(3, 2, 3, 4)
    assert torch.equal(table.look_up(x, y, z).flatten(), table.look_up(*points(24)))
    assert table.look_up(*torch.zeros(3, 0)).shape == (0,)


def test_double_precision_is_kept() -> None:
    x, y, z = points().double()
    found = TrilinearTable(samples(torch.float64)).look_up(x, y, z)
    torch.testing.assert_close(found, polynomial(x, y, z), rtol=1e-13, atol=1e-13)


def test_layout_in_memory_does_not_matter() -> None:
    values = samples().permute(2, 1, 0)
    x, y, z = points()
    torch.testing.assert_close(TrilinearTable(values).look_up(z, y, x), polynomial(x, y, z), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", [(3,), (2, 2), (2, 2, 2, 2), (0, 2, 2), (2, 2, 0)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ParameterError, match="shape"):
        TrilinearTable(torch.zeros(shape))
