"""Smoothing: what is smooth stays, noise goes, and two halves tell which of both an image is."""

import math
from itertools import pairwise

import pytest
import torch

from precompute.gather import Lattice
from precompute.smoothing import (
    LEVELS,
    SPLINE,
    VARIANCES,
    LevelErrors,
    bias_of,
    find_neighbours,
    measure_levels,
    steady_changes,
)

COUNTS = (40, 36, 1)
LATTICE = Lattice(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0.5, 0.25, 1.0]), COUNTS)
CUBE = Lattice(torch.zeros(3), torch.ones(3), (24, 24, 24))


def every(lattice: Lattice) -> torch.Tensor:
    return torch.arange(lattice.size)


def smoothed(
    lattice: Lattice, numbers: torch.Tensor, source: torch.Tensor, paths: torch.Tensor | None = None
) -> list[torch.Tensor]:
    """Levels of a source `(point,)` or `(point, column)`."""
    weights = torch.full((len(numbers),), 64) if paths is None else paths
    columns = source if source.ndim == 2 else source[:, None]
    zero = torch.zeros_like(columns)
    return list(find_neighbours(lattice, numbers, weights).levels(columns, zero))[:-1]


def some_points(lattice: Lattice, share: float = 0.4) -> tuple[torch.Tensor, torch.Tensor]:
    """A random part of the lattice, and numbers of paths that differ."""
    generator = torch.Generator().manual_seed(0)
    numbers = torch.nonzero(torch.rand(lattice.size, generator=generator) < share).flatten()
    return numbers, 2 ** torch.randint(2, 12, (len(numbers),), generator=generator)


def test_levels_begin_with_the_source_itself() -> None:
    source = torch.randn(LATTICE.size, 3, generator=torch.Generator().manual_seed(1))
    levels = smoothed(LATTICE, every(LATTICE), source)
    assert len(levels) == LEVELS + 1
    assert torch.equal(levels[0], source)
    assert all(level.shape == source.shape for level in levels)


def test_constants_stay_even_where_neighbours_are_missing() -> None:
    numbers, paths = some_points(CUBE)
    for level in smoothed(CUBE, numbers, torch.full((len(numbers),), 3.0), paths):
        torch.testing.assert_close(level, torch.full_like(level, 3.0))


def test_one_point_alone_keeps_its_value() -> None:
    for level in smoothed(CUBE, torch.tensor([777]), torch.tensor([2.5]), torch.tensor([4])):
        torch.testing.assert_close(level, torch.tensor([[2.5]]))


def test_linear_functions_stay_in_the_interior() -> None:
    positions = LATTICE.positions(every(LATTICE))
    linear = positions @ torch.tensor([2.0, -3.0, 0.5])
    curved = linear + 0.3 * (positions[:, 0] / LATTICE.spacing[0]) ** 2
    place = torch.stack([every(LATTICE) % COUNTS[0], every(LATTICE) // COUNTS[0]], dim=1)
    for level, (straight, bent) in enumerate(
        zip(smoothed(LATTICE, every(LATTICE), linear), smoothed(LATTICE, every(LATTICE), curved), strict=True)
    ):
        reach = 2 * ((1 << level) - 1)
        inside = ((place >= reach) & (place < torch.tensor(COUNTS[:2]) - reach)).all(1)
        assert int(inside.sum()) > 50
        torch.testing.assert_close(straight[inside, 0], linear[inside], rtol=1e-4, atol=1e-4)
        # The spline's variance is 1, then 1 + 4, then 1 + 4 + 16 squared spacings: a parabola rises by so much.
        rise = 0.3 * (4**level - 1) / 3
        torch.testing.assert_close(bent[inside, 0], curved[inside] + rise, rtol=1e-3, atol=1e-2)


def test_an_impulse_spreads_by_the_spline_along_each_axis() -> None:
    source = torch.zeros(CUBE.size)
    middle = 12 + 24 * (12 + 24 * 12)
    source[middle] = 1.0
    first = smoothed(CUBE, every(CUBE), source)[1].reshape(24, 24, 24)
    spline = torch.tensor(SPLINE)
    expected = spline[:, None, None] * spline[:, None] * spline
    torch.testing.assert_close(first[10:15, 10:15, 10:15], expected)
    assert float(first.sum()) == pytest.approx(1.0, rel=1e-5)


def test_noise_falls_by_the_kernel_s_factor() -> None:
    noise = torch.randn(CUBE.size, 30, generator=torch.Generator().manual_seed(2))
    middle = torch.zeros(24, 24, 24, dtype=torch.bool)
    middle[10:14, 10:14, 10:14] = True
    one_level = sum(weight**2 for weight in SPLINE) ** 3
    levels = smoothed(CUBE, every(CUBE), noise)
    assert float(levels[1][middle.flatten()].square().mean()) == pytest.approx(one_level, rel=0.1)
    squares = [float(level.square().mean()) for level in levels]
    assert all(later < 0.3 * earlier for earlier, later in pairwise(squares))


def test_points_weigh_by_their_paths() -> None:
    line = Lattice(torch.zeros(3), torch.ones(3), (2, 1, 1))
    paths = torch.tensor([4, 64])
    _, first, *_ = smoothed(line, torch.arange(2), torch.tensor([1.0, 0.0]), paths)
    # 6 of 16 for the point itself, 4 for its neighbour, nothing elsewhere; the other axes have one point.
    expected = torch.tensor([6 * 4 / (6 * 4 + 4 * 64), 4 * 4 / (4 * 4 + 6 * 64)])
    torch.testing.assert_close(first[:, 0], expected)
    equal = smoothed(line, torch.arange(2), torch.tensor([1.0, 0.0]))[1]
    assert not torch.allclose(equal[:, 0], expected, rtol=0.1)


def test_rows_of_the_lattice_do_not_run_into_each_other() -> None:
    """The last point of a row and the first of the next have neighbouring numbers and are far apart."""
    flat = Lattice(torch.zeros(3), torch.ones(3), (16, 3, 1))
    source = torch.zeros(3, 16)
    source[1, 15] = 1.0
    for level in smoothed(flat, every(flat), source.flatten())[1:2]:
        spread = level.reshape(3, 16)
        assert float(spread[:, 13:].sum()) == pytest.approx(float(spread.sum()))
        assert not spread[:, :13].any()


def edge_image(pixels: int, noise: float, seed: int = 3) -> torch.Tensor:
    """Two halves `(pixel, half)` of a line with a sharp edge."""
    truth = (torch.arange(pixels) >= pixels // 2).float()
    normal = torch.randn(pixels, 2, generator=torch.Generator().manual_seed(seed))
    return truth[:, None] + noise * normal


def levels_of(image: torch.Tensor) -> list[torch.Tensor]:
    """The points of a line are the pixels."""
    line = Lattice(torch.zeros(3), torch.ones(3), (len(image), 1, 1))
    return smoothed(line, every(line), image)


def test_noisier_images_are_smoothed_more() -> None:
    best = [int(measure_levels(levels_of(edge_image(256, noise))).total.argmin()) for noise in (0.0, 0.1, 0.5, 3.0)]
    assert best[0] == 0
    assert best == sorted(best)
    assert best[-1] == LEVELS


def test_a_sharp_edge_without_noise_is_left_alone() -> None:
    # As many pixels as a probe has rays.
    errors = measure_levels(levels_of(edge_image(64, 0.0).repeat(64, 1)))
    assert float(errors.total[0]) == 0.0
    assert (errors.total[1:] > 1e-3).all()
    assert (errors.bias.diff() > 0.0).all()


def test_the_level_taken_is_nearly_the_best_one() -> None:
    truth = edge_image(256, 0.0)[:, 0]
    for noise in (0.05, 0.3, 1.0):
        levels = levels_of(edge_image(256, noise))
        real = torch.stack([(level.mean(1) - truth).square().mean() for level in levels])
        taken = int(measure_levels(levels).total.argmin())
        assert float(real[taken]) < 1.5 * float(real.min())
        assert float(real.max()) > 2.0 * float(real.min())


def test_noise_and_bias_are_right_on_average_where_noise_is_small() -> None:
    seeds, wave = 50, torch.sin(torch.arange(4096) * (2.0 * math.pi / 6.0))[:, None]
    noise = 0.02 * torch.randn(len(wave), 2 * seeds, generator=torch.Generator().manual_seed(3))
    exact = levels_of(wave)
    levels = [level.unflatten(1, (seeds, 2)).movedim(1, -1) for level in levels_of(wave + noise)]
    errors = measure_levels(levels)
    for level, smooth in enumerate(exact):
        bias = float((smooth - wave).square().mean())
        assert float(errors.bias[level].mean()) == pytest.approx(bias, rel=0.1, abs=1e-9)
        real = (levels[level].mean(1) - smooth).square().mean()
        assert float(errors.noise[level].mean()) == pytest.approx(float(real), rel=0.1)
    # One half alone would count its own noise as bias.
    naive = (levels[1][:, 0] - levels[0][:, 0]).square().mean()
    assert float(naive) > float(errors.bias[1].mean())


def test_a_bias_is_told_through_noise_that_hides_it() -> None:
    seeds, place = 30, torch.arange(24) * (2.0 * math.pi / 16.0)
    wave = (torch.sin(place) * torch.sin(place)[:, None] * torch.sin(place)[:, None, None]).flatten()[:, None]
    noise = 4.0 * torch.randn(CUBE.size, 2 * seeds, generator=torch.Generator().manual_seed(6))
    exact = smoothed(CUBE, every(CUBE), wave)
    levels = [level.unflatten(1, (seeds, 2)).movedim(1, -1) for level in smoothed(CUBE, every(CUBE), wave + noise)]
    errors = measure_levels(levels)
    for level in (2, 3):
        bias, change = float((exact[level] - wave).square().mean()), levels[level] - levels[0]
        assert float(errors.bias[level].mean()) == pytest.approx(bias, rel=0.35)
        assert float(errors.bias[level].std()) < 0.5 * float((change[:, 0] * change[:, 1]).mean(0).std())
    real = torch.stack([(level.mean(1) - wave).square().mean(0) for level in levels])
    taken = real.gather(0, errors.total.argmin(0)[None])[0]
    assert float(taken.mean()) < 1.05 * float(real.mean(1).min())


def test_the_steady_changes_count_within_the_deviation_of_the_others() -> None:
    change = torch.randn(2000, 2, 1, generator=torch.Generator().manual_seed(7)) + 1.0
    products = change.prod(1)[:, 0]
    exact, deviation = float(products.mean()), float(products.std()) / math.sqrt(2000.0)
    for told, held in ((0.0, exact - 2.0 * deviation), (0.97 * exact, 0.97 * exact), (9.0, exact + deviation)):
        if told == 0.97 * exact:
            assert exact - 2.0 * deviation < told < exact + deviation
        steady = torch.full((2000, 2, 1), math.sqrt(told))
        assert float(bias_of(change, steady)) == pytest.approx(held, rel=1e-3)


def test_steady_changes_are_scaled_to_the_whole_of_a_parabola() -> None:
    """Averages raise a parabola by their variance."""
    raised = [torch.full((4, 2, 1), variance) for variance in VARIANCES[:-1]]
    for told, whole in zip(steady_changes(raised), raised, strict=True):
        torch.testing.assert_close(told, whole)


def test_a_negative_bias_counts_as_none() -> None:
    errors = LevelErrors(torch.tensor([1.0, 2.0]), torch.tensor([-0.5, 0.5]))
    assert errors.total.tolist() == [1.0, 2.5]


def test_what_is_expected_is_not_smoothed() -> None:
    numbers, paths = some_points(CUBE)
    generator = torch.Generator().manual_seed(5)
    expected, rest = (torch.rand(len(numbers), 2, generator=generator) for _ in range(2))
    found = list(find_neighbours(CUBE, numbers, paths).levels(expected + rest, expected))
    assert len(found) == LEVELS + 2
    torch.testing.assert_close(found[0], expected + rest)
    assert torch.equal(found[-1], expected)
    for level, smooth in zip(found[1:-1], smoothed(CUBE, numbers, rest, paths)[1:], strict=True):
        torch.testing.assert_close(level, expected + smooth, rtol=1e-4, atol=1e-5)
