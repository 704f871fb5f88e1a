"""The reference against closed forms and quadrature, by its own variances, and at every extreme."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from render import path_tracer
from render.camera import Camera, PinholeCamera
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.fused import torch_loops_only
from render.path_tracer import ReferenceImage, trace_reference
from render.phase_functions import evaluate_phase_function
from tests.support.quadrature import box_double, box_single
from tests.support.statistics import FALSE_ALARM, mean_square_z_p_value, passes_z_test
from tests.support.volumes import noise_box, scaled, towards, uniform_box, view_north

HALF = np.array([2.0, 2.5, 3.0])
SUN = torch.tensor([0.6, -0.48, 0.64])


def trace(grid: DensityGrid, camera: Camera, sun: torch.Tensor = SUN, **changes: float) -> ReferenceImage:
    settings: dict[str, float] = {"extinction": 0.4, "asymmetry": 0.3, "albedo": 0.9, "orders": 2, "samples": 400}
    return trace_reference(grid, camera, sun, **{**settings, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("extinction", [0.03, 0.3, 0.8])
def test_transmittance_of_a_uniform_box(extinction: float) -> None:
    grid, camera = uniform_box(), PinholeCamera((5.0, -9.0, 2.0), (0.0, 0.0, 0.0), 0.5, 8, 8)
    image = trace(grid, camera, extinction=extinction, orders=1, samples=4000)
    near, far = grid.intersect(*camera.rays())
    for factor, right in ((1.0, True), (1.5, False)):
        exact = torch.exp(-factor * extinction * (far - near))
        variance = exact * (1.0 - exact) / image.samples
        assert passes_z_test(image.transmittance - exact, variance) is right


def test_the_variance_of_the_transmittance_is_that_of_a_share() -> None:
    image = trace(uniform_box(), view_north(), samples=1000)
    share = image.transmittance
    torch.testing.assert_close(image.transmittance_variance, share * (1.0 - share) / 999)


@pytest.mark.parametrize("sun", [SUN, towards(0, 20), towards(180, 0), towards(90, 0), towards(40, -50)])
def test_single_scattering_of_a_uniform_box(sun: torch.Tensor) -> None:
    image = trace(uniform_box(), view_north(), sun, orders=1, samples=40_000)
    start, ahead = np.array([0.0, -2.5, 0.0]), np.array([0.0, 1.0, 0.0])
    integral = box_single(start, ahead, sun.double().numpy(), HALF, 0.4)
    for factor, right in ((1.0, True), (1.1, False)):
        exact = factor * integral * evaluate_phase_function(sun[1:2], 0.3)
        assert passes_z_test(image.orders[0] - exact, image.orders_variance[0]) is right
    torch.testing.assert_close(image.radiance, 0.9 * image.orders[0])


@pytest.mark.parametrize(("extinction", "asymmetry"), [(0.4, 0.3), (0.15, -0.6), (1.5, 0.7)])
def test_double_scattering_of_a_uniform_box(extinction: float, asymmetry: float) -> None:
    camera = view_north()
    image = trace(uniform_box(), camera, extinction=extinction, asymmetry=asymmetry, samples=100_000)
    start, ahead = np.array([0.0, -2.5, 0.0]), np.array([0.0, 1.0, 0.0])
    exact = box_double(start, ahead, SUN.double().numpy(), HALF, extinction, asymmetry)
    assert passes_z_test(image.orders[1] - exact, image.orders_variance[1])
    wrong = box_double(start, ahead, -SUN.double().numpy(), HALF, extinction, asymmetry)
    assert not passes_z_test(image.orders[1] - wrong, image.orders_variance[1])


def test_noise_is_seen_as_the_line_integral_of_its_interpolation() -> None:
    grid, camera = noise_box(sparse=0.5), PinholeCamera((5.0, -9.0, 2.0), (0.0, 0.0, 0.0), 0.6, 6, 6)
    image = trace(grid, camera, extinction=0.5, orders=1, samples=2000)
    origin, direction = camera.rays()
    near, far = grid.intersect(origin, direction)
    middle = near[:, None] + (far - near)[:, None] * (torch.arange(2000) + 0.5) / 2000
    length = grid.look_up_density(origin[:, None] + middle[..., None] * direction[:, None]).double().mean(1) * (
        far - near
    )
    for extinction, right in ((0.5, True), (0.55, False)):
        exact = torch.exp(-extinction * length)
        assert passes_z_test(image.transmittance - exact, exact * (1.0 - exact) / image.samples) is right


def test_albedo_enters_the_total_by_order() -> None:
    whole, half, none = (trace(uniform_box(), view_north(), albedo=albedo, orders=4) for albedo in (1.0, 0.5, 0.0))
    torch.testing.assert_close(whole.radiance, whole.orders.sum(0))
    powers = 0.5 ** torch.arange(1.0, 5.0)[:, None]
    torch.testing.assert_close(half.radiance, (powers * half.orders).sum(0))
    assert none.radiance.item() == none.radiance_variance.item() == 0.0
    assert torch.equal(none.orders, whole.orders)


def test_orders_that_are_not_recorded_still_count() -> None:
    whole, part = (trace(noise_box(), view_north(3, 3, 4.0), orders=20, recorded=kept) for kept in (20, 3))
    assert part.orders.shape[0] == 3
    assert torch.equal(part.orders, whole.orders[:3])
    assert torch.equal(part.radiance, whole.radiance)
    assert torch.equal(part.radiance_variance, whole.radiance_variance)
    for recorded in (0, 21):
        with pytest.raises(ParameterError, match="recorded"):
            trace(noise_box(), view_north(3, 3, 4.0), orders=20, recorded=recorded)


def repeated(samples: int = 100, repeats: int = 60) -> tuple[ReferenceImage, torch.Tensor]:
    images = [trace(uniform_box(), view_north(), orders=3, samples=samples, seed=seed) for seed in range(repeats)]
    return images[0], torch.stack([torch.stack([i.radiance[0], i.radiance_variance[0]]) for i in images])


def test_the_variance_predicts_the_spread_between_seeds() -> None:
    _, runs = repeated()
    radiance, variance = runs.double().unbind(1)
    ratio = float(radiance.var() / variance.mean())
    # The variance of 60 runs has a relative standard deviation of sqrt(2 / 59) = 0.18.
    assert 0.5 < ratio < 1.6


def test_variances_fall_with_the_number_of_samples() -> None:
    few, many = (trace(uniform_box(), view_north(), samples=samples) for samples in (1000, 16_000))
    assert float(many.radiance_variance / few.radiance_variance) == pytest.approx(1.0 / 16.0, rel=0.2)


def test_a_seed_gives_one_image_and_another_seed_another() -> None:
    camera = view_north(4, 3, 4.0)
    first, again, other = (trace(noise_box(), camera, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(first.orders, again.orders)
    assert torch.equal(first.transmittance, again.transmittance)
    assert not torch.equal(first.orders, other.orders)
    difference = first.radiance - other.radiance
    assert mean_square_z_p_value(difference, first.radiance_variance + other.radiance_variance) > FALSE_ALARM


def test_batches_of_lanes_are_no_part_of_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = view_north(3, 3, 4.0)
    with torch_loops_only():
        whole = trace(noise_box(), camera, samples=500)
        monkeypatch.setattr(path_tracer, "LANES", 1000)
        pieces = trace(noise_box(), camera, samples=500)
    torch.testing.assert_close(whole.orders, pieces.orders)
    torch.testing.assert_close(whole.radiance_variance, pieces.radiance_variance)


def test_scenes_have_no_scale() -> None:
    grid, camera = noise_box(), PinholeCamera((5.0, -9.0, 2.0), (0.0, 0.0, 0.0), 0.6, 4, 4)
    small = trace(grid, camera, extinction=0.5)
    position = tuple(256.0 * v for v in camera.position)
    large = dataclasses.replace(camera, position=position)
    same = trace(scaled(grid, 256.0), large, extinction=0.5 / 256.0)
    torch.testing.assert_close(same.radiance, small.radiance)
    assert not torch.allclose(trace(scaled(grid, 256.0), large, extinction=0.5).radiance, small.radiance, rtol=0.1)


def test_the_length_of_the_sun_vector_does_not_matter() -> None:
    first, second = (trace(uniform_box(), view_north(), factor * SUN) for factor in (1.0, 8.0))
    torch.testing.assert_close(first.radiance, second.radiance)


def is_black(image: ReferenceImage) -> bool:
    return (
        not image.orders.any()
        and not image.radiance.any()
        and not image.radiance_variance.any()
        and bool((image.transmittance == 1.0).all())
    )


def is_sane(image: ReferenceImage) -> bool:
    values = [getattr(image, field.name) for field in dataclasses.fields(image) if field.name != "samples"]
    return all(bool(torch.isfinite(v).all() & (v >= 0.0).all()) for v in values) and bool(
        (image.transmittance <= 1.0).all()
    )


@pytest.mark.parametrize("extinction", [0.0, 1e-12, 1e-38, 1e-41])
def test_vanishing_extinction_is_empty_air(extinction: float) -> None:
    for camera in (view_north(2, 2, 3.0), PinholeCamera((0.0, 0.0, 0.0), (1.0, 0.3, 0.2), 1.0, 2, 2)):
        assert is_black(trace(uniform_box(), camera, towards(0, 90), extinction=extinction))
    assert not is_black(trace(uniform_box(), view_north(2, 2, 3.0), extinction=0.1))


def test_empty_volumes_and_views_beside_the_cloud_are_black() -> None:
    assert is_black(trace(DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0), view_north(2, 2)))
    assert is_black(trace(uniform_box(), PinholeCamera((0.0, -9.0, 0.0), (0.0, -10.0, 0.0), 0.5, 2, 2)))


@pytest.mark.parametrize("asymmetry", [-0.99, 0.99])
def test_enormous_optical_depth_stays_finite(asymmetry: float) -> None:
    dense = trace(uniform_box(), view_north(), extinction=1e4 / 5.0, asymmetry=asymmetry, orders=4, samples=50)
    noisy = trace(noise_box(sparse=0.7), view_north(2, 2, 4.0), extinction=1e4 / 6.0, asymmetry=asymmetry, samples=20)
    assert is_sane(dense)
    assert is_sane(noisy)
    assert float(dense.transmittance.max()) == 0.0
    assert float(dense.radiance.sum()) > 0.0


def test_one_voxel_is_a_uniform_box() -> None:
    voxel = DensityGrid(torch.full((1, 1, 1), 2.0), torch.tensor([-2.0, -2.5, -3.0]), torch.tensor([2.0, 2.5, 3.0]))
    image = trace(voxel, view_north(), extinction=0.2, samples=20_000)
    same = trace(uniform_box(), view_north(), extinction=0.4, samples=20_000)
    assert torch.equal(image.orders, same.orders)
    assert not torch.equal(image.orders, trace(voxel, view_north(), extinction=0.4, samples=20_000).orders)


def test_a_camera_inside_the_volume() -> None:
    image = trace(uniform_box(), PinholeCamera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 1.0, 1, 1), samples=5000)
    exact = torch.tensor([math.exp(-0.4 * 2.5)])
    assert passes_z_test(image.transmittance - exact, exact * (1.0 - exact) / 5000)
    single = box_single(np.zeros(3), np.array([0.0, 1.0, 0.0]), SUN.double().numpy(), HALF, 0.4)
    exact = single * evaluate_phase_function(SUN[1:2], 0.3)
    assert passes_z_test(image.orders[0] - exact, image.orders_variance[0])


@pytest.mark.parametrize(
    "changes",
    [
        {"extinction": -1.0},
        {"extinction": math.inf},
        {"extinction": math.nan},
        {"albedo": 1.1},
        {"albedo": -0.1},
        {"albedo": math.nan},
        {"asymmetry": 1.0},
        {"asymmetry": -1.0},
        {"asymmetry": math.nan},
        {"orders": 0},
        {"samples": 1},
    ],
)
def test_parameters_outside_their_domain_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match=r"need|asymmetry"):
        trace(uniform_box(), view_north(), **changes)


def test_a_sun_without_direction_is_refused() -> None:
    with pytest.raises(ParameterError, match="direction"):
        trace(uniform_box(), view_north(), torch.zeros(3))


def test_some_pixels_alone_agree_with_the_whole_and_the_others_stay_black() -> None:
    camera = view_north(4, 3, 9.0)
    whole = trace(uniform_box(), camera)
    seen = torch.nonzero(whole.radiance).flatten()
    some = torch.cat([seen[1:4], torch.nonzero(whole.radiance == 0).flatten()[:1]])
    part = trace_reference(
        uniform_box(), camera, SUN, extinction=0.4, asymmetry=0.3, albedo=0.9, orders=2, samples=400, pixels=some
    )
    assert torch.equal(torch.nonzero(part.radiance).flatten(), seen[1:4])
    variance = part.radiance_variance + whole.radiance_variance
    assert passes_z_test((part.radiance - whole.radiance)[some], variance[some])
    beside = torch.ones(12, dtype=torch.bool)
    beside[some] = False
    assert torch.equal(part.transmittance[beside], torch.ones(int(beside.sum())))
