"""Building stacks: every stage reported, reproducible, defined at every extreme."""

import dataclasses
import math

import pytest
import torch

from precompute.error_budget import Effort
from precompute.scattering_orders import FEWEST_PATHS, GROUP_EDGES, _effort_of_group, build_scattering_stack
from render.camera import Camera, OrthographicCamera, PinholeCamera, frame_volume
from render.density_grid import DensityGrid
from render.errors import ParameterError
from render.fused import torch_loops_only
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack, ScatteringTables
from tests.support.volumes import noise_box, scaled, smooth_box, towards, uniform_box, view_north

SUN = towards(120.0, 30.0)
EFFORT = Effort(orders=3, points=200, paths=4000, strata=8)
BESIDE = PinholeCamera((0.0, -9.0, 0.0), (0.0, -10.0, 0.0), 0.5, 3, 2)


def build(
    grid: DensityGrid | None = None,
    camera: Camera | None = None,
    asymmetry: list[float] | None = None,
    extinction: list[float] | None = None,
    **changes: object,
) -> ScatteringTables:
    volume = grid or noise_box()
    settings: dict[str, object] = {"sun": SUN, "effort": EFFORT, "seed": 1, **changes}
    return build_scattering_stack(
        volume,
        camera or view_north(8, 6, 7.0),
        settings.pop("sun"),  # type: ignore[arg-type]
        torch.tensor([0.0, 0.6] if asymmetry is None else asymmetry),
        torch.tensor([0.1, 1.0, 8.0] if extinction is None else extinction),
        **settings,  # type: ignore[arg-type]
    )


def is_sane(tables: ScatteringTables) -> bool:
    values = [getattr(tables, field.name) for field in dataclasses.fields(tables)]
    return all(bool(torch.isfinite(v).all()) for v in values if isinstance(v, torch.Tensor)) and all(
        bool((v >= 0.0).all()) for v in (tables.single, tables.multiple, tables.image_error, tables.effective_share)
    )


def test_tables_have_their_shapes() -> None:
    tables = build()
    pixels = len(tables.pixel)
    assert 0 < pixels < 48
    assert tables.single.shape == (3, pixels)
    assert tables.multiple.shape == (2, 2, 3, pixels)
    assert tables.standard_error.shape == tables.effective_share.shape == (2, 2, 3)
    assert tables.image_error.shape == (2, 3)
    assert (tables.width, tables.height) == (8, 6)
    assert is_sane(tables)


def test_pixels_are_those_that_see_cloud() -> None:
    grid, camera = noise_box(), view_north(8, 6, 7.0)
    tables = build(grid, camera)
    length = compute_optical_length(grid, *camera.rays())
    assert torch.equal(tables.pixel, torch.nonzero(length).flatten())
    assert torch.equal(tables.optical_length, length[tables.pixel])
    torch.testing.assert_close(tables.cos_sun, SUN[1].expand(len(tables.pixel)))


def test_a_seed_gives_one_stack_and_another_seed_another() -> None:
    first, again, other = build(seed=1), build(seed=1), build(seed=2)
    assert torch.equal(first.multiple, again.multiple)
    assert torch.equal(first.single, again.single)
    assert torch.equal(first.single, other.single)
    assert not torch.equal(first.multiple, other.multiple)


def test_the_number_of_threads_does_not_matter() -> None:
    one = build()
    torch.set_num_threads(2)
    try:
        two = build()
    finally:
        torch.set_num_threads(1)
    torch.testing.assert_close(two.multiple, one.multiple, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(two.single, one.single, rtol=1e-6, atol=1e-9)


def test_progress_names_every_group_and_comes_to_its_end() -> None:
    calls: list[tuple[str, float]] = []
    tables = build(on_progress=lambda stage, share: calls.append((stage, share)))
    stages = list(dict.fromkeys(stage for stage, _ in calls))
    depths = tables.extinction * tables.largest_optical_length
    assert len(stages) == len({int(torch.bucketize(d, torch.tensor(GROUP_EDGES))) for d in depths}) == 3
    for stage in stages:
        shares = [share for name, share in calls if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
        assert stage.startswith("optical depth")


@pytest.mark.parametrize("grid", [DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0), noise_box()])
def test_views_without_cloud_have_no_pixel(grid: DensityGrid) -> None:
    tables = build(grid, BESIDE)
    assert len(tables.pixel) == 0
    assert tables.single.shape == (3, 0)
    assert tables.multiple.shape == (2, 2, 3, 0)
    assert not tables.image_error.any()
    layers = ScatteringStack(tables)(*(torch.full((2,), 0.5) for _ in range(3)))
    assert layers.multiple.shape == (2, 0)


@pytest.mark.parametrize(
    "camera",
    [
        view_north(1, 1),
        PinholeCamera((0.2, 0.1, 0.0), (1.0, 2.0, 0.5), 1.0, 4, 3),  # inside
        OrthographicCamera((0.0, 0.0, 0.0), (0.3, 1.0, 0.0), 9.0, 4, 3),  # its plane cuts the volume
        OrthographicCamera((0.0, 0.0, 20.0), (0.0, 0.0, 0.0), 7.0, 4, 3),
        frame_volume(noise_box(), width=4, height=3),
    ],
)
def test_every_camera_works(camera: Camera) -> None:
    tables = build(camera=camera)
    assert len(tables.pixel) > 0
    assert is_sane(tables)
    assert float(tables.multiple.sum(-1).min()) > 0.0


@pytest.mark.parametrize(("asymmetry", "extinction"), [([0.3], [1.0]), ([0.3], [0.1, 9.0]), ([-0.99, 0.99], [1.0])])
def test_few_nodes_are_enough(asymmetry: list[float], extinction: list[float]) -> None:
    tables = build(asymmetry=asymmetry, extinction=extinction)
    assert is_sane(tables)
    layers = ScatteringStack(tables)(torch.tensor(asymmetry[-1:]), torch.tensor(extinction[-1:]), torch.ones(1))
    torch.testing.assert_close(layers.multiple[0], tables.multiple[:, -1, -1].sum(0), rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("grid", [uniform_box(), uniform_box(voxels=(1, 1, 1)), noise_box(sparse=0.7)])
def test_extinctions_from_nothing_to_enormous_depth(grid: DensityGrid) -> None:
    tables = build(grid, extinction=[1e-12, 1e-3, 0.5, 40.0, 1e4 / 5.0])
    assert is_sane(tables)
    assert float(tables.single.max()) <= 1.0
    thin = tables.single[0] / (1e-12 * tables.optical_length)
    torch.testing.assert_close(thin, torch.ones_like(thin), rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("extinction", [1e-12, 1e-30])
def test_nothing_but_vanishing_extinction(extinction: float) -> None:
    assert is_sane(build(extinction=[extinction]))


def test_scenes_have_no_scale() -> None:
    small = build(smooth_box(8, 8.0), view_north(6, 6, 9.0))
    camera = OrthographicCamera((0.0, -50.0 * 64.0, 0.0), (0.0, 0.0, 0.0), 9.0 * 64.0, 6, 6)
    large = build(scaled(smooth_box(8, 8.0), 64.0), camera, extinction=[0.1 / 64.0, 1.0 / 64.0, 8.0 / 64.0])
    torch.testing.assert_close(large.single, small.single, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(large.multiple, small.multiple, rtol=1e-4, atol=1e-6)


def test_the_length_of_the_sun_vector_does_not_matter() -> None:
    torch.testing.assert_close(build(sun=4.0 * SUN).multiple, build().multiple)


def test_more_orders_leave_the_first_alone() -> None:
    few, many = build(), build(effort=dataclasses.replace(EFFORT, orders=5))
    assert torch.equal(many.multiple[:2], few.multiple)
    assert many.multiple.shape[0] == 4


def test_halves_give_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """64 times the paths, an eighth of the error of the source as it is; smoothing makes the errors of few paths smaller."""
    # What interpolation misses does not fall with the paths.
    monkeypatch.setattr("precompute.light_lattice.LightLattice.sharpen", lambda self, values: values)
    few = dataclasses.replace(EFFORT, points=50)
    many = dataclasses.replace(few, paths=64 * EFFORT.paths)
    smooth = build(effort=few).image_error
    monkeypatch.setattr("precompute.smoothing.Neighbourhood.levels", lambda self, source, expected: [source])
    plain = build(effort=few).image_error
    ratio = (plain / build(effort=many).image_error).log().mean().exp()
    assert 5.0 < float(ratio) < 12.0
    assert float((smooth / plain).log().mean().exp()) < 0.8


def test_torch_and_fused_loops_build_the_same_stack() -> None:
    pytest.importorskip("numba")
    effort = dataclasses.replace(EFFORT, orders=10, tail=True)
    fused = build(effort=effort)
    with torch_loops_only():
        plain = build(effort=effort)
    for name in ("multiple", "single", "image_error", "standard_error", "effective_share", "tail_ratio", "tail_share"):
        torch.testing.assert_close(getattr(fused, name), getattr(plain, name), rtol=2e-4, atol=1e-7)


def test_batches_of_paths_are_no_part_of_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = build()
    monkeypatch.setattr("precompute.source_points.LANES", 64)
    torch.testing.assert_close(build().multiple, expected.multiple, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(
    ("share", "paths", "tolerance", "expected"),
    [
        (0.5, 40_000, 0.02, 20_000),
        (0.001, 40_000, 0.02, 200 * FEWEST_PATHS),
        (0.001, 500, 0.02, 500),
        (0.001, 40_000, None, 40),
    ],
)
def test_every_group_has_paths_enough_to_tell_its_errors(
    share: float, paths: int, tolerance: float | None, expected: int
) -> None:
    effort = Effort(points=200, paths=paths, tolerance=tolerance)
    assert _effort_of_group(effort, share, []).paths == expected


CLOSED = Effort(orders=18, points=200, paths=40_000, strata=8, tail=True, tolerance=0.08)


def test_thin_groups_trace_less_but_have_all_images() -> None:
    tables = build(extinction=[0.1, 0.2, 1.0, 8.0], effort=CLOSED)
    orders = [int(group["largest_order"]) for group in tables.groups]  # type: ignore[call-overload]
    assert orders == sorted(orders)
    assert orders[0] < orders[-1] == 18
    assert tables.knots.tolist() == [2, 3, 4, 6, 10, 18]
    assert is_sane(tables)
    untraced = tables.knots > orders[0]
    assert not tables.standard_error[untraced, :, 0].any()
    assert (tables.standard_error[~untraced, :, 0] > 0.0).all()
    mean = tables.multiple.mean(-1)
    # The pilot's paths reach the next knot, the highest ones none.
    assert (mean[int(untraced.int().argmax()), :, 0] > 0.0).all()
    assert (mean[untraced, :, 0] < 1e-1 * mean[0, :, 0]).all()
    # From thin to thick every order grows.
    assert (mean.diff(dim=-1)[..., :2] >= 0.0).all()


def test_the_tail_follows_the_decay_of_the_last_images() -> None:
    tables = build(extinction=[0.1, 8.0], effort=CLOSED)
    assert (tables.tail_ratio[:, 1] > 0.3).all()
    assert (tables.tail_ratio[:, 0] < tables.tail_ratio[:, 1]).all()
    assert (tables.tail_ratio < 1.0).all()
    assert (tables.tail_share[:, 1] > 0.0).all()
    assert (tables.tail_share <= 1.0).all()
    without = build(extinction=[0.1, 8.0], effort=dataclasses.replace(CLOSED, tail=False))
    assert torch.equal(without.multiple, tables.multiple)
    assert not without.tail_ratio.any()


def test_progress_never_falls_though_passes_follow() -> None:
    calls: list[tuple[str, float]] = []
    tables = build(effort=CLOSED, on_progress=lambda stage, share: calls.append((stage, share)))
    for stage in dict.fromkeys(stage for stage, _ in calls):
        shares = [share for name, share in calls if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
    assert len(tables.groups) == 3


@pytest.mark.parametrize("extinction", [[1e-6], [1e-6, 1e-5], [0.05], [0.02, 0.1]])
@pytest.mark.parametrize("tail", [True, False])
def test_thin_clouds_alone_are_no_special_case(extinction: list[float], tail: bool) -> None:
    tables = build(extinction=extinction, effort=dataclasses.replace(CLOSED, tail=tail))
    assert is_sane(tables)
    assert all(int(group["largest_order"]) <= 4 for group in tables.groups)  # type: ignore[call-overload]
    layers = ScatteringStack(tables)(torch.tensor([0.3]), torch.tensor(extinction[-1:]), torch.ones(1))
    assert torch.isfinite(layers.multiple).all()
    assert (layers.multiple < layers.single).all()


@pytest.mark.parametrize(
    ("asymmetry", "extinction"),
    [
        ([1.0], [1.0]),
        ([math.nan], [1.0]),
        ([], [1.0]),
        ([0.5, 0.0], [1.0]),
        ([0.0, 0.0], [1.0]),
        ([0.0], []),
        ([0.0], [0.0, 1.0]),
        ([0.0], [-1.0]),
        ([0.0], [1.0, 1.0]),
        ([0.0], [2.0, 1.0]),
        ([0.0], [math.inf]),
        ([0.0], [math.nan]),
    ],
)
def test_nodes_outside_their_domain_are_refused(asymmetry: list[float], extinction: list[float]) -> None:
    with pytest.raises(ParameterError, match=r"asymmetry|extinction"):
        build(asymmetry=asymmetry, extinction=extinction)


def test_a_sun_without_direction_is_refused() -> None:
    for sun in (torch.zeros(3), torch.tensor([0.0, math.nan, 1.0])):
        with pytest.raises(ParameterError, match="direction"):
            build(sun=sun)


@pytest.mark.parametrize("changes", [{"orders": 1}, {"points": 0}, {"paths": 0}, {"strata": 0}])
def test_no_effort_is_refused(changes: dict[str, int]) -> None:
    with pytest.raises(ParameterError, match="at least"):
        dataclasses.replace(EFFORT, **changes)


def test_thin_nodes_alone_still_have_an_anchor() -> None:
    assert is_sane(build(extinction=[0.001, 0.01]))
