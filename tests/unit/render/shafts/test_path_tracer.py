import math
from dataclasses import replace

import pytest
import torch

from render.camera import OrthographicCamera, direction_from_angles
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.media import ExponentialDecay, Uniform
from render.path_tracer import trace_reference
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_ground, make_sphere
from render.shafts.lights import Sun
from render.shafts.path_tracer import ScatteredOrders, trace_orders
from render.shafts.scene import ShaftScene
from render.shafts.stage import MapSettings, Stage, prepare_stage
from render.shafts.truth import compute_truth
from tests.support.shaft_scenes import small_scene, small_stage
from tests.support.statistics import mean_square_z_p_value, passes_z_test

FOG = Constituent(Uniform(0.02, 30.0, -math.inf), albedo=0.9, asymmetry=0.4)


def foggy(part: Constituent, sun_elevation_deg: float = 28.0) -> Stage:
    sun = Sun(direction_from_angles(math.radians(15.0), math.radians(sun_elevation_deg)))
    meshes = (make_sphere((2.0, 0.0, 9.0), 7.0, 48), make_ground(300.0))
    scene = replace(small_scene(12, 8, meshes, Air((part,)), lamps=False), sun=sun)
    return small_stage(scene, MapSettings(exact=True))


@pytest.mark.parametrize(
    "part",
    [FOG, Constituent(ExponentialDecay(0.03, 12.0, -math.inf), phase="rayleigh")],
    ids=["uniform", "exponential, rayleigh"],
)
def test_the_first_order_is_the_truth_of_the_march(part: Constituent) -> None:
    stage = foggy(part)
    truth = compute_truth(stage, 1e-4).in_scattering[:, 0].double()
    traced = trace_orders(stage, 1, 2000, seed=3)
    difference = traced.mean[0] - truth
    assert passes_z_test(difference, traced.variance[0])
    assert mean_square_z_p_value(difference, traced.variance[0]) > 1e-3
    no_sphere = prepare_stage(replace(stage.scene, meshes=stage.scene.meshes[1:]), MapSettings(exact=True))
    unshadowed = replace(stage, lighting=no_sphere.lighting)
    wrong = compute_truth(unshadowed, 1e-3).in_scattering[:, 0].double()
    assert not passes_z_test(traced.mean[0] - wrong, traced.variance[0])


def layer_from_above(depth: float, sun: tuple[float, float, float]) -> Stage:
    """A level layer of fog between 0 and 1 m, seen straight down."""
    camera = OrthographicCamera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), 1.0, 2, 1)
    fog = Constituent(Uniform(depth, 1.0, 0.0), asymmetry=0.5)
    scene = ShaftScene(camera, air=Air((fog,)), sun=Sun(sun, (1.0, 1.0, 1.0)), reach=10.0)
    return prepare_stage(scene)


def test_higher_orders_are_those_of_the_cloud_path_tracer() -> None:
    """A wide flat box of constant density is the same layer, followed there by delta and ratio tracking."""
    sun = direction_from_angles(0.5, math.radians(55.0))
    stage = layer_from_above(1.5, sun)
    traced = trace_orders(stage, 3, 20_000, seed=1)
    grid = DensityGrid(torch.ones(4, 4, 4), torch.tensor([-60.0, -60.0, 0.0]), torch.tensor([60.0, 60.0, 1.0]))
    other = trace_reference(
        grid,
        stage.scene.camera,
        torch.tensor(sun),
        extinction=1.5,
        asymmetry=0.5,
        albedo=1.0,
        orders=3,
        samples=20_000,
        seed=2,
    )
    assert passes_z_test(traced.mean - other.orders, traced.variance + other.orders_variance)
    assert not passes_z_test(1.05 * traced.mean - other.orders, traced.variance + other.orders_variance)


def test_the_albedo_counts_once_for_each_scattering() -> None:
    stage = foggy(FOG)
    half = foggy(replace(FOG, albedo=0.45))
    full, less = (trace_orders(one, 3, 50, seed=5).mean for one in (stage, half))
    for order in range(3):
        torch.testing.assert_close(less[order], full[order] * 0.5 ** (order + 1))


def test_nothing_is_scattered_where_there_is_no_air_or_light() -> None:
    clear = trace_orders(foggy(replace(FOG, medium=Uniform(0.0, 30.0, -math.inf))), 2, 4)
    assert float(clear.mean.abs().max()) == 0.0
    night = trace_orders(foggy(replace(FOG, medium=Uniform(0.02, 30.0, -math.inf)), -10.0), 2, 4)
    assert float(night.mean.abs().max()) == 0.0


def test_the_same_seed_gives_the_same_paths() -> None:
    stage = foggy(FOG)

    def trace(seed: int) -> ScatteredOrders:
        return trace_orders(stage, 2, 8, seed)

    assert torch.equal(trace(1).mean, trace(1).mean)
    assert not torch.equal(trace(1).mean, trace(2).mean)


def test_other_scenes_are_refused() -> None:
    stage = foggy(FOG)
    for scene in (
        small_scene(4, 4),
        small_scene(4, 4, air=Air((replace(FOG, colour=(1.0, 0.5, 0.5)),))),
        replace(small_scene(4, 4, air=Air((FOG,))), sun=None),
        replace(small_scene(4, 4, air=Air((FOG,))), sun=Sun((0.0, 0.0, 1.0), shadow_points=3)),
    ):
        with pytest.raises(ParameterError, match="one white constituent"):
            trace_orders(small_stage(scene), 1, 4)
    for orders, samples in ((0, 4), (1, 1)):
        with pytest.raises(ParameterError, match="at least one order"):
            trace_orders(stage, orders, samples)
