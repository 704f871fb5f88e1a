"""Composition from tables: exact at nodes, smooth, differentiable, with the limits of thin clouds and no scattering."""

import dataclasses

import pytest
import torch
from torch import Tensor

from render.errors import ParameterError
from render.phase_functions import evaluate_phase_function
from render.scattering_stack import CloudLayers, ScatteringStack, ScatteringTables, sum_tail

PIXELS, ORDERS = 6, 4
ASYMMETRY = torch.tensor([0.0, 0.3, 0.6, 0.85])
EXTINCTION, SOFT = torch.logspace(-2.0, 0.5, 6), 0.1


def tables_of(pixels: int = PIXELS, asymmetry: Tensor = ASYMMETRY, extinction: Tensor = EXTINCTION) -> ScatteringTables:
    """Tables that a made-up cloud would have: order k of a thin one grows with the k-th power of the extinction."""
    generator = torch.Generator().manual_seed(0)
    length = 1.0 + 20.0 * torch.rand(pixels, generator=generator)
    depth = extinction[:, None] * length
    single = -torch.expm1(-depth) * torch.exp(-0.3 * depth)
    powers = torch.arange(2, ORDERS + 1)[:, None, None, None]
    multiple = 0.05 * (-torch.expm1(-depth)) ** powers * torch.exp(-asymmetry[:, None, None])
    shape = (ORDERS - 1, len(asymmetry), len(extinction))
    return ScatteringTables(
        width=3,
        height=2,
        pixel=torch.arange(pixels),
        optical_length=length,
        cos_sun=2.0 * torch.rand(pixels, generator=generator) - 1.0,
        asymmetry=asymmetry,
        extinction=extinction,
        soft_extinction=torch.tensor(SOFT),
        knots=torch.arange(2, ORDERS + 1),
        single=single,
        multiple=multiple,
        tail_ratio=torch.zeros(shape[1:]),
        tail_share=torch.zeros(shape[1:]),
        standard_error=torch.full(shape, 0.1),
        image_error=torch.full(shape[1:], 0.05),
        bright_error=torch.full(shape[1:], 0.05),
        effective_share=torch.ones(shape),
    )


def stack(**arguments: Tensor) -> ScatteringStack:
    return ScatteringStack(tables_of(**arguments))  # type: ignore[arg-type]


def compose(
    model: ScatteringStack, g: float, s: float, albedo: float, dtype: torch.dtype = torch.float64
) -> CloudLayers:
    return model(*(torch.tensor([v], dtype=dtype) for v in (g, s, albedo)))


@pytest.mark.parametrize("albedo", [1.0, 0.4])
def test_nodes_give_back_the_tables(albedo: float) -> None:
    tables, model = tables_of(), stack()
    powers = albedo ** torch.arange(2, ORDERS + 1)[:, None]
    for row, g in enumerate(ASYMMETRY.tolist()):
        for column, s in enumerate(EXTINCTION.tolist()):
            layers = compose(model, g, s, albedo, torch.float32)
            single = albedo * evaluate_phase_function(tables.cos_sun, g) * tables.single[column]
            multiple = (powers * tables.multiple[:, row, column]).sum(0)
            torch.testing.assert_close(layers.single[0], single, rtol=2e-5, atol=0.0)
            torch.testing.assert_close(layers.multiple[0], multiple, rtol=2e-5, atol=0.0)
            wrong = (powers * tables.multiple[:, row - 1, column]).sum(0)
            assert not torch.allclose(layers.multiple[0], wrong, rtol=0.05)


def test_transmittance_and_opacity_are_exact_everywhere() -> None:
    length = tables_of().optical_length.double()
    for s in (0.0, 1e-12, 1e-6, 0.0123, 0.5, 1e4):
        layers = compose(stack(), 0.2, s, 0.9)
        torch.testing.assert_close(layers.transmittance[0], torch.exp(-s * length))
        torch.testing.assert_close(layers.opacity[0], -torch.expm1(-s * length), rtol=1e-12, atol=0.0)


def test_between_nodes_logarithms_are_interpolated() -> None:
    """A pure power of s, that of each order, and an exponential of g are straight lines there."""
    tables = tables_of()
    s_table = EXTINCTION[:, None].expand(-1, PIXELS)
    order = torch.arange(2, ORDERS + 1)[:, None, None, None]
    power = EXTINCTION[:, None] ** order * torch.exp(-3.0 * ASYMMETRY[:, None, None])
    multiple = power.expand(-1, -1, -1, PIXELS)
    model = ScatteringStack(dataclasses.replace(tables, single=s_table, multiple=multiple))
    layers = compose(model, 0.47, 0.0777, 1.0)
    phase = evaluate_phase_function(tables.cos_sun.double(), 0.47)
    torch.testing.assert_close(layers.single[0], phase * 0.0777, rtol=1e-5, atol=0.0)
    expected = sum(0.0777**k for k in range(2, ORDERS + 1)) * torch.exp(torch.tensor(-3.0 * 0.47, dtype=torch.float64))
    torch.testing.assert_close(layers.multiple[0], expected.expand(PIXELS), rtol=1e-5, atol=0.0)


def test_below_the_nodes_each_order_falls_with_its_power() -> None:
    s = float(EXTINCTION[0])
    for albedo in (1.0, 0.5):
        at, half, tiny = (compose(stack(), 0.3, share * s, albedo) for share in (1.0, 0.5, 1e-9))
        torch.testing.assert_close(half.single, 0.5 * at.single)
        torch.testing.assert_close(tiny.single, 1e-9 * at.single)
        second = torch.tensor([[2.0**-k for k in range(2, ORDERS + 1)]], dtype=torch.float64)
        orders = albedo ** torch.arange(2, ORDERS + 1)[:, None] * tables_of().multiple[:, 1, 0].double()
        torch.testing.assert_close(half.multiple, second @ orders, rtol=1e-5, atol=0.0)
        assert not torch.allclose(half.multiple, 0.5 * at.multiple, rtol=0.1)


def test_no_extinction_and_no_albedo_scatter_nothing() -> None:
    for s, albedo in ((0.0, 1.0), (0.3, 0.0), (0.0, 0.0)):
        layers = compose(stack(), 0.3, s, albedo, torch.float32)
        assert not layers.single.any()
        assert not layers.multiple.any()
    assert torch.equal(compose(stack(), 0.3, 0.0, 1.0).transmittance, torch.ones(1, PIXELS, dtype=torch.float64))


def test_above_the_nodes_the_tables_are_held() -> None:
    top, beyond = (compose(stack(), 0.3, s, 1.0) for s in (float(EXTINCTION[-1]), 1e6))
    torch.testing.assert_close(beyond.single, top.single, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(beyond.multiple, top.multiple, rtol=1e-6, atol=0.0)
    assert float(beyond.transmittance.max()) == 0.0


def central_difference(model: ScatteringStack, point: list[float], axis: int, step: float) -> float:
    def value(offset: float) -> float:
        moved = [v + offset * (i == axis) for i, v in enumerate(point)]
        layers = compose(model, *moved)
        return float((layers.single + 2.0 * layers.multiple + 3.0 * layers.transmittance).sum())

    return (value(step) - value(-step)) / (2.0 * step)


def gradient(model: ScatteringStack, point: list[float]) -> list[float]:
    inputs = [torch.tensor([v], dtype=torch.float64, requires_grad=True) for v in point]
    layers = model(*inputs)
    (layers.single + 2.0 * layers.multiple + 3.0 * layers.transmittance).sum().backward()
    return [float(i.grad) for i in inputs if i.grad is not None]


LOWEST, HIGHEST = float(EXTINCTION[0].double()), float(EXTINCTION[-1].double())
POINTS = [
    [0.2, 0.1, 0.9],
    [0.3, float(EXTINCTION[2]), 0.5],
    [1e-4, LOWEST * 1.001, 0.01],
    [0.8499, HIGHEST * 0.999, 0.999],
    [0.4, LOWEST * 0.7, 0.9],
]


@pytest.mark.parametrize("point", POINTS)
def test_gradients_are_those_of_central_differences(point: list[float]) -> None:
    model = stack()
    found = gradient(model, point)
    assert len(found) == 3
    for axis, slope in enumerate(found):
        step = 1e-5 * max(point[axis], 1e-2)
        assert slope == pytest.approx(central_difference(model, point, axis, step), rel=1e-5, abs=1e-7)
    assert found[1] != pytest.approx(found[2], rel=1e-3)


def test_the_gradient_at_the_lowest_node_is_that_towards_thicker_clouds() -> None:
    model = stack()
    at, above, below = (gradient(model, [0.2, LOWEST + offset, 0.9])[1] for offset in (0.0, 1e-9, -1e-9))
    assert at == pytest.approx(above, rel=1e-5)
    assert at != pytest.approx(above + below, rel=0.1)


def test_gradients_at_the_bounds_are_finite() -> None:
    for point in ([0.0, 0.0, 0.0], [0.85, HIGHEST, 1.0], [0.0, LOWEST, 0.0], [0.5, 1e-30, 1.0]):
        assert all(abs(slope) < 1e6 for slope in gradient(stack(), point))


@pytest.mark.parametrize("population", [1, 50])
def test_candidates_do_not_mix(population: int) -> None:
    generator = torch.Generator().manual_seed(1)
    uniform = torch.rand(3, 50, generator=generator)
    g, s, albedo = 0.85 * uniform[0], EXTINCTION[-1] * uniform[1], uniform[2]
    model = stack()
    together = model(g, s, albedo)
    pieces = [model(*(v[i : i + population] for v in (g, s, albedo))) for i in range(0, 50, population)]
    for field in dataclasses.fields(CloudLayers):
        whole = getattr(together, field.name)
        assert whole.shape == (50, PIXELS)
        torch.testing.assert_close(torch.cat([getattr(p, field.name) for p in pieces]), whole, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 6), (4, 1), (2, 2)])
def test_few_nodes_are_enough(rows: int, columns: int) -> None:
    tables = tables_of(asymmetry=ASYMMETRY[:rows], extinction=EXTINCTION[:columns])
    layers = compose(ScatteringStack(tables), float(ASYMMETRY[rows - 1]), float(EXTINCTION[columns - 1]), 1.0)
    expected = tables.multiple[:, rows - 1, columns - 1].double().sum(0)
    torch.testing.assert_close(layers.multiple[0], expected, rtol=1e-5, atol=0.0)


def test_views_without_cloud_have_no_pixel() -> None:
    tables = tables_of(pixels=0)
    layers = compose(ScatteringStack(tables), 0.2, 0.1, 0.9)
    assert layers.single.shape == layers.multiple.shape == layers.opacity.shape == (1, 0)
    assert tables.largest_optical_length == 0.0
    assert tables_of().largest_optical_length == float(tables_of().optical_length.max())


def test_black_entries_stay_black() -> None:
    tables = tables_of()
    multiple = torch.zeros_like(tables.multiple)
    multiple[0] = tables.multiple[0]
    multiple[0, ..., 2] = 0.0
    single = tables.single.clone()
    single[:, 4] = 0.0
    layers = compose(ScatteringStack(dataclasses.replace(tables, multiple=multiple, single=single)), 0.2, 0.1, 1.0)
    whole = compose(
        ScatteringStack(dataclasses.replace(tables, multiple=tables.multiple[:1], knots=tables.knots[:1])),
        0.2,
        0.1,
        1.0,
    )
    assert float(layers.multiple[0, 2]) == 0.0
    assert 0.0 < float(layers.single[0, 4]) < 1e-6 * float(whole.single.max())
    others = [0, 1, 3, 5]
    torch.testing.assert_close(layers.multiple[0, others], whole.multiple[0, others], rtol=2e-3, atol=0.0)
    torch.testing.assert_close(layers.single[0, others], whole.single[0, others])


def test_noise_of_the_tables_is_averaged_not_lost() -> None:
    """Between nodes the mean over many noisy pixels is that without noise; a mean of logarithms would be too small."""
    pixels, spread = 20_000, 0.6
    quiet = tables_of(pixels)
    normal = torch.randn(quiet.multiple.shape, generator=torch.Generator().manual_seed(3))
    noise = torch.exp(spread * normal - 0.5 * spread**2)
    noisy = dataclasses.replace(quiet, multiple=quiet.multiple * noise)
    exact, found = (compose(ScatteringStack(t), 0.43, 0.07, 1.0).multiple for t in (quiet, noisy))
    geometric = float(torch.exp(noise.log().mean()))
    assert float(found.mean() / exact.mean()) == pytest.approx(1.0, abs=0.015)
    assert geometric == pytest.approx(1.0 - 0.5 * spread**2, abs=0.03)


def test_nodes_with_large_errors_are_marked() -> None:
    error = torch.full((4, 6), 0.05)
    error[3, 2] = 0.2
    model = ScatteringStack(dataclasses.replace(tables_of(), image_error=error), largest_image_error=0.1)
    s = EXTINCTION
    between = (s[:-1] * s[1:]).sqrt()
    g = torch.tensor([0.7, 0.7, 0.7, 0.7, 0.5, 0.7, 0.9, 0.9])
    at = torch.stack([between[0], between[1], between[2], between[3], between[1], 0.5 * s[0], s[2], 2.0 * s[-1]])
    grey = torch.full_like(g, 0.9)
    assert model.is_usable(g, at, grey).tolist() == [True, False, False, True, True, True, False, True]
    assert stack().is_usable(g, at, grey).all()
    assert model.is_usable(g[:0], at[:0], grey[:0]).shape == (0,)


def test_nodes_that_only_bright_clouds_miss_are_marked_for_these() -> None:
    error = torch.full((4, 6), 0.05)
    error[1, 2] = 0.25
    model = ScatteringStack(dataclasses.replace(tables_of(), bright_error=error), largest_image_error=0.1)
    albedo = torch.tensor([0.5, 0.98, 0.984, 0.986, 1.0])
    here = ASYMMETRY[1].expand(5), EXTINCTION[2].expand(5)
    torch.testing.assert_close(model.estimated_error(*here, albedo), torch.tensor([0.05, 0.05, 0.09, 0.11, 0.25]))
    assert model.is_usable(*here, albedo).tolist() == [True, True, True, False, False]
    assert model.is_usable(ASYMMETRY[3:], EXTINCTION[5:], torch.ones(1)).all()


def test_the_number_of_orders_is_that_of_the_tables() -> None:
    assert stack().orders == ORDERS


@pytest.mark.parametrize("shapes", [((2,), (3,), (2,)), ((2,), (2,), (1,)), ((2, 1), (2, 1), (2, 1)), ((), (), ())])
def test_other_shapes_are_refused(shapes: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(ParameterError, match="shape"):
        stack()(*(torch.full(shape, 0.1) for shape in shapes))


KNOTS = (2, 3, 4, 6, 10)


def knotted(ratio: float = 0.0, share: float = 0.0) -> ScatteringTables:
    """Tables whose images stand for the orders around the knots, with a tail."""
    tables = tables_of()
    exponents = torch.tensor(KNOTS)[:, None, None, None]
    depth = EXTINCTION[:, None] * tables.optical_length
    multiple = 0.05 * (-torch.expm1(-depth)) ** exponents * torch.exp(-ASYMMETRY[:, None, None]) * exponents**0.5
    nodes = (len(ASYMMETRY), len(EXTINCTION))
    return dataclasses.replace(
        tables,
        knots=torch.tensor(KNOTS),
        multiple=multiple,
        tail_ratio=torch.full(nodes, ratio),
        tail_share=torch.full(nodes, share),
        standard_error=torch.zeros(len(KNOTS), *nodes),
        effective_share=torch.ones(len(KNOTS), *nodes),
    )


@pytest.mark.parametrize("albedo", [1.0, 0.95, 0.4])
@pytest.mark.parametrize(("ratio", "share"), [(0.0, 0.0), (0.8, 0.3), (0.95, 0.1)])
def test_images_count_with_the_albedo_s_power_of_their_knot_and_the_last_with_its_tail(
    albedo: float, ratio: float, share: float
) -> None:
    tables = knotted(ratio, share)
    model = ScatteringStack(tables)
    powers = albedo ** torch.tensor(KNOTS, dtype=torch.float64)
    # Order K has the share of the last image; those beyond it fall like k^(-3/2) r^k.
    beyond = sum((1.0 + n / KNOTS[-1]) ** -1.5 * (albedo * ratio) ** n for n in range(1, 2000))
    powers[-1] *= 1.0 + share * beyond
    expected = (powers[:, None] * tables.multiple[:, 1, 2].double()).sum(0)
    found = compose(model, float(ASYMMETRY[1]), float(EXTINCTION[2]), albedo).multiple[0]
    torch.testing.assert_close(found, expected, rtol=5e-4 if share else 2e-5, atol=0.0)
    consecutive = (albedo ** torch.arange(2, 7)[:, None] * tables.multiple[:, 1, 2]).sum(0).double()
    assert albedo == 1.0 or not torch.allclose(found, consecutive, rtol=2e-3)
    assert model.orders == 10


def test_a_tail_makes_bright_clouds_brighter_and_dark_ones_hardly() -> None:
    with_tail, without = ScatteringStack(knotted(0.9, 0.2)), ScatteringStack(knotted())
    gain = [
        float(compose(with_tail, 0.2, 0.1, a).multiple.sum() / compose(without, 0.2, 0.1, a).multiple.sum()) - 1.0
        for a in (0.5, 0.9, 1.0)
    ]
    assert 0.0 < gain[0] < 1e-3 < 10.0 * gain[1] < 10.0 * gain[2]


def test_any_interpolated_tail_is_finite_and_not_negative() -> None:
    """Between nodes with and without a tail cubic weights overshoot; neither a ratio above one nor a share below zero may follow."""
    tables = knotted()
    ratio, share = torch.zeros(4, 6), torch.zeros(4, 6)
    ratio[:, 3:], share[:, 3:] = 0.9999, 1.0
    model = ScatteringStack(dataclasses.replace(tables, tail_ratio=ratio, tail_share=share))
    plain = ScatteringStack(tables)
    s = torch.logspace(-3.0, 1.0, 200)
    parameters = torch.full_like(s, 0.4), s, torch.full_like(s, 1.0)
    found, least = model(*parameters).multiple, plain(*parameters).multiple
    assert torch.isfinite(found).all()
    assert (found >= least * (1.0 - 1e-5)).all()
    assert (found <= (1.0 + 1.1 * float(sum_tail(torch.ones(1), KNOTS[-1]))) * least + 1e-6).all()


@pytest.mark.parametrize("kept", [0.0, 1e-20, 0.3, 0.9, 0.99, 0.999, 0.9999, 1.0])
@pytest.mark.parametrize("largest", [2, 10, 66, 258])
def test_the_tail_is_the_sum_of_its_terms(kept: float, largest: int) -> None:
    terms = torch.arange(1.0, 4e6, dtype=torch.float64)
    exact = float(((1.0 + terms / largest) ** -1.5 * kept**terms).sum())
    found = float(sum_tail(torch.tensor([kept], dtype=torch.float64), largest))
    # For one kept light and nothing else the sum converges as slowly as the root of its length.
    assert found == pytest.approx(exact, rel=2e-3 if kept < 1.0 else 3.0 * (largest / 4e6) ** 0.5 + 5e-3, abs=1e-12)


def test_below_the_nodes_a_knot_falls_with_its_power() -> None:
    s, tables = float(EXTINCTION[0]), knotted(0.8, 0.3)
    beyond = float(sum_tail(torch.tensor([0.5 * 0.8]), KNOTS[-1]))
    powers = 0.5 ** torch.tensor(KNOTS, dtype=torch.float64)
    powers[-1] *= 1.0 + 0.3 * beyond
    expected = (powers[:, None] * tables.multiple[:, 1, 0].double()).sum(0)
    found = compose(ScatteringStack(tables), 0.3, 0.5 * s, 1.0).multiple[0]
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=0.0)


@pytest.mark.parametrize("point", POINTS)
def test_gradients_with_knots_and_tail_are_those_of_central_differences(point: list[float]) -> None:
    model = ScatteringStack(knotted(0.9, 0.3))
    for axis, slope in enumerate(gradient(model, point)):
        step = 1e-5 * max(point[axis], 1e-2)
        # Steps of 1e-8 leave 1e-7 of a difference of float64.
        assert slope == pytest.approx(central_difference(model, point, axis, step), rel=1e-5, abs=1e-6)
    without = gradient(ScatteringStack(knotted()), point)
    assert point[2] < 0.9 or gradient(model, point)[2] > 1.001 * without[2] or point[1] < 10.0 * LOWEST


def test_images_left_out_for_speed_change_nothing_that_counts() -> None:
    """Without gradients faint images and nodes without weight are not read."""
    model = ScatteringStack(knotted(0.9, 0.3))
    generator = torch.Generator().manual_seed(4)
    g, s, albedo = torch.rand(3, 60, generator=generator, dtype=torch.float64)
    g, s = 0.85 * g, LOWEST * 0.5 * (2.0 * HIGHEST / LOWEST) ** s
    moving = albedo.clone().requires_grad_()
    quick, whole = model(g, s, albedo).multiple, model(g, s, moving).multiple.detach()
    torch.testing.assert_close(quick, whole, rtol=1e-4, atol=0.0)


def test_a_first_node_that_float32_rounds_up_does_not_stop_the_gradient() -> None:
    # In float32 the logarithms of some nodes lie above those in float64; a candidate on the node must not fall off it.
    for factor in (1.0, 1.1, 1.3, 1.7, 2.3, 2.9):
        tables = dataclasses.replace(tables_of(), extinction=EXTINCTION * factor)
        model = ScatteringStack(tables)
        lowest = float(tables.extinction[0].double())
        at, above = (gradient(model, [0.2, lowest * share, 0.9])[1] for share in (1.0, 1.0 + 1e-6))
        assert at == pytest.approx(above, rel=1e-4)


def test_single_precision_composes_what_double_precision_does() -> None:
    """Over the whole box and beyond it, bounds included; errors are of the order of the rounding of the tables' logarithms."""
    generator = torch.Generator().manual_seed(8)
    unit = torch.rand(400, 3, generator=generator, dtype=torch.float64)
    unit = unit.masked_fill(unit < 0.05, 0.0).masked_fill(unit > 0.95, 1.0)
    lowest, highest = float(EXTINCTION[0].double().log()), float(EXTINCTION[-1].double().log())
    arguments = (0.85 * unit[:, 0], (lowest - 5.0 + (highest - lowest + 7.0) * unit[:, 1]).exp(), unit[:, 2])
    model = ScatteringStack(knotted(0.98, 0.2))
    single, double = model(*(values.float() for values in arguments)), model.double()(*arguments)
    for name in ("single", "multiple", "transmittance", "opacity"):
        found, exact = getattr(single, name).double(), getattr(double, name)
        scale = exact.abs().amax(1, keepdim=True).clamp(min=1e-30)
        assert float(((found - exact) / scale).abs().max()) < 3e-5
