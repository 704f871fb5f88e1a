"""Whether estimated errors are the true ones, and each image gets the smoothing that suits it."""

import math
from functools import cache

import torch

from precompute import error_probe
from precompute.error_budget import ALBEDOS
from precompute.error_probe import PROBE_RAYS, ErrorProbe, ImageErrors, SmoothedImages, probe_rays
from precompute.gather import lattice_over
from precompute.group_task import UNSEEN_ERROR
from precompute.light_lattice import number_points
from precompute.order_plan import close_tail, plan_orders
from precompute.path_sampler import TableNodes
from precompute.single_scattering import compute_single_scattering
from precompute.smoothing import LEVELS, find_neighbours
from precompute.source_model import SourceModel
from precompute.source_points import SourcePoints, SourceTable
from precompute.view import view_of
from render.phase_functions import evaluate_phase_function
from render.scattering_stack import sum_tail
from tests.support.rays import stratify_rays
from tests.support.volumes import smooth_box, towards, view_north


def test_rays_of_a_probe_are_spread_evenly() -> None:
    assert torch.equal(probe_rays(7), torch.arange(7))
    assert torch.equal(probe_rays(PROBE_RAYS), torch.arange(PROBE_RAYS))
    for count in (PROBE_RAYS + 1, 10 * PROBE_RAYS, 1_000_003):
        rays = probe_rays(count)
        assert len(rays) == len(rays.unique()) == PROBE_RAYS
        assert (int(rays[0]), int(rays[-1])) == (0, count - 1)
        assert int(rays.diff().max()) <= count // (PROBE_RAYS - 1) + 1
    assert len(probe_rays(0)) == 0


def test_each_column_takes_its_own_level() -> None:
    levels = [torch.full((4, 2, 3), float(number)) for number in range(4)]
    best = torch.tensor([2, 0, 3])
    assert torch.equal(error_probe._choose(levels, best), best.float().expand(4, 2, 3))
    assert torch.equal(error_probe._choose(levels[:1], torch.zeros(3)), levels[0])


GRID, CAMERA, SUN = smooth_box(8, 12.0), view_north(16, 12, 18.0), towards(120.0, 30.0)
ASYMMETRY, EXTINCTION = torch.tensor([0.0, 0.6, 0.85]), torch.tensor([0.05, 0.5, 2.0])
PLAN = plan_orders(6)
SEEDS = 12


class Raw:
    """Neighbours whose levels of smoothing change nothing."""

    def levels(self, source: torch.Tensor, expected: torch.Tensor) -> list[torch.Tensor]:
        return [source] * (LEVELS + 2)


class Exact:
    """Points between which nothing is missed."""

    def sharpen(self, values: torch.Tensor) -> torch.Tensor:
        return values


@cache
def images(paths: int, smooth: bool) -> tuple[list[list[ImageErrors]], torch.Tensor]:
    """Errors by seed and extinction, and images `(seed, extinction, albedo, asymmetry, ray)`, the last albedo one with its tail."""
    view = view_of(GRID, CAMERA, SUN)
    lattice = lattice_over(GRID, 1.0)
    strata = stratify_rays(GRID, view.origin, view.direction, EXTINCTION, 8)
    single, _ = compute_single_scattering(GRID, view.origin, view.direction, view.sun, EXTINCTION, 0.5, 16)
    numbers, albedo = torch.arange(lattice.size), torch.tensor(ALBEDOS)
    entry, knots = torch.arange(lattice.size, dtype=torch.int32), torch.tensor(PLAN.knots)
    once = (single, torch.zeros_like(single))
    probe = ErrorProbe(view, lattice, entry, strata, once, ASYMMETRY, PLAN, albedo, tail=True)
    phase = evaluate_phase_function(view.direction @ view.sun, ASYMMETRY[:, None])
    lit = albedo[:, None, None] * phase * single[:, None, None]
    model = SourceModel(torch.ones(len(numbers), 1), torch.ones(len(numbers)))
    errors, composed = [], []
    for seed in range(SEEDS):
        nodes = TableNodes(ASYMMETRY, EXTINCTION, ASYMMETRY, EXTINCTION)
        table = SourceTable(GRID, CAMERA, view.sun, lattice, nodes, PLAN, 0.5, seed)
        table.add_pass(SourcePoints(numbers, torch.full_like(numbers, paths)))
        neighbours = find_neighbours(lattice, numbers, table.paths)
        measured, pictures = [], []
        for node, source in enumerate(table.source):
            best = probe.smooth(node, source, Raw() if not smooth else neighbours, model, Exact(), False)
            measured.append(best.errors)
            halves = best.source[:, None].expand(-1, 2, -1, -1)
            chosen = torch.stack([probe.gather(node, halves[:, :, knot])[:, 0] for knot in range(len(knots))], dim=1)
            multiple = torch.einsum("ak,rkg->agr", albedo[:, None] ** knots, chosen)
            ratio, share = close_tail(PLAN, chosen.double().mean(0))
            bright = phase * single[node] + chosen.sum(1).T + (share * sum_tail(ratio, 6) * chosen[:, -1]).T
            pictures.append(torch.cat([lit[node] + multiple, bright[None]]))
        errors.append(measured)
        composed.append(torch.stack(pictures))
    return errors, torch.stack(composed).double()


def estimated(paths: int, smooth: bool) -> torch.Tensor:
    """Root of the mean squared estimate over seeds `(extinction, albedo, asymmetry)`, the last albedo one."""
    errors, _ = images(paths, smooth)
    by_seed = [[torch.cat([one.of_image, one.of_bright[None]]) for one in nodes] for nodes in errors]
    return torch.stack([torch.stack(nodes) for nodes in by_seed]).square().mean(0).sqrt()


def true_error(paths: int, smooth: bool, truth: torch.Tensor) -> torch.Tensor:
    found = images(paths, smooth)[1]
    return ((found - truth).square().mean((0, -1)) / truth.square().mean(-1)).sqrt()


def test_errors_without_smoothing_are_those_between_seeds() -> None:
    found = images(16, False)[1]
    # The mean of the seeds is the truth but for its own noise.
    real = true_error(16, False, found.mean(0)) * math.sqrt(SEEDS / (SEEDS - 1))
    ratio = estimated(16, False) / real
    assert 0.85 < float(ratio.log().mean().exp()) < 1.15
    box, bright = ratio[:, :-1], ratio[:, -1]
    assert 0.6 < float(box.min()) < float(box.max()) < 1.5
    assert 0.7 < float(bright.log().mean().exp()) < 1.3
    # Closing at the sixth order makes the tail of the thickest cloud most of it.
    assert 0.4 < float(bright.min()) < float(bright.max()) < 2.0


def test_errors_with_smoothing_count_its_bias() -> None:
    truth = images(256, False)[1].mean(0)
    # As groups state it: what is told from the first level misses some, here where a level reaches as far as light varies a third.
    real, stated = true_error(16, True, truth), UNSEEN_ERROR * estimated(16, True)
    ratio = stated / real
    assert 0.75 < float(ratio.log().mean().exp()) < 1.2
    assert 0.5 < float(ratio.min()) < float(ratio.max()) < 2.0
    assert float((real / true_error(16, False, truth)).log().mean().exp()) < 0.8


def test_errors_fall_with_the_root_of_the_paths() -> None:
    ratio = estimated(16, False) / estimated(256, False)
    assert 3.2 < float(ratio.log().mean().exp()) < 4.8


def test_errors_of_single_images_have_their_shape() -> None:
    one = images(16, True)[0][0][1]
    assert one.of_knots.shape == (len(PLAN.knots), 3)
    assert one.of_image.shape == (len(ALBEDOS), 3)
    assert (one.of_knots > 0.0).all()
    assert (one.of_image < one.of_knots.amax(0)).all()


def test_the_error_of_single_scattering_is_added_in_quadrature() -> None:
    view = view_of(GRID, CAMERA, SUN)
    lattice = lattice_over(GRID, 4.0)
    strata = stratify_rays(GRID, view.origin, view.direction, EXTINCTION, 8)
    single, _ = compute_single_scattering(GRID, view.origin, view.direction, view.sun, EXTINCTION, 0.5, 16)
    entry = torch.arange(lattice.size, dtype=torch.int32)
    without, alone = (
        ErrorProbe(view, lattice, entry, strata, (single, share * single), ASYMMETRY, PLAN, torch.tensor([0.9]))
        for share in (0.0, 0.03)
    )
    raw = torch.rand(len(view.pixel), 2, len(PLAN.knots), len(ASYMMETRY)) * 0.01
    nothing, exact = torch.zeros_like(raw), torch.zeros_like(raw[:, 0])
    dark, noisy = (SmoothedImages(image, nothing, nothing, exact) for image in (nothing, raw))
    for node in range(len(EXTINCTION)):
        torch.testing.assert_close(alone.composed(node, dark), torch.full((1, len(ASYMMETRY)), 0.03).double())
        both, of_multiple = alone.composed(node, noisy), without.composed(node, noisy)
        assert bool((both > of_multiple).all())
        assert bool((both.square() < of_multiple.square() + 0.03**2).all())


def test_what_sharpening_would_change_is_added_in_quadrature() -> None:
    view = view_of(GRID, CAMERA, SUN)
    lattice = lattice_over(GRID, 1.0)
    strata = stratify_rays(GRID, view.origin, view.direction, EXTINCTION, 8)
    single, _ = compute_single_scattering(GRID, view.origin, view.direction, view.sun, EXTINCTION, 0.5, 16)
    numbers, entry = torch.arange(lattice.size), torch.arange(lattice.size, dtype=torch.int32)
    once = (single, torch.zeros_like(single))
    probe = ErrorProbe(view, lattice, entry, strata, once, ASYMMETRY, PLAN, torch.tensor(ALBEDOS))
    model = SourceModel(torch.ones(len(numbers), 1), torch.ones(len(numbers)))
    points = number_points(lattice, torch.ones(lattice.size, dtype=torch.bool))
    # One and the same in both halves: without noise, and with nothing to smooth.
    half = torch.rand(lattice.size, 1, len(PLAN.knots), len(ASYMMETRY), generator=torch.Generator().manual_seed(3))
    source = half.expand(-1, 2, -1, -1).contiguous()
    blind, plain, sharp = (
        probe.smooth(0, source, Raw(), model, of, sharpened)
        for of, sharpened in ((Exact(), False), (points, False), (points, True))
    )
    assert float(blind.errors.of_image.max()) == 0.0
    assert torch.equal(plain.source, blind.source)
    torch.testing.assert_close(sharp.source.flatten(1), points.sharpen(plain.source.flatten(1)))
    assert torch.equal(plain.errors.of_image, sharp.errors.of_image)
    powers = torch.tensor(ALBEDOS).double()[:, None] ** torch.tensor(PLAN.knots)
    both = [probe.gather(0, one.source[:, None].expand(-1, 2, -1, -1).flatten(2)) for one in (plain, sharp)]
    first, second = (one[:, 0].unflatten(1, (len(PLAN.knots), -1)).double() for one in both)
    change, whole = (torch.einsum("ak,rkg->rag", powers, one) for one in (second - first, first))
    phase = evaluate_phase_function(view.direction @ view.sun, ASYMMETRY[:, None])[:, probe.rays]
    total = whole + torch.tensor(ALBEDOS)[:, None] * (phase * single[0, probe.rays]).T[:, None]
    expected = (change.square().mean(0) / total.square().mean(0)).sqrt()
    torch.testing.assert_close(plain.errors.of_image, expected, rtol=1e-4, atol=1e-6)
    assert float(expected.min()) > 1e-3
