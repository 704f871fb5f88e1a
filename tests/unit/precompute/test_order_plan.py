"""Sharing of orders: exact where it claims to be, close in between, and a tail that a geometric decay gives back."""

import pytest
import torch

from precompute.order_plan import (
    CONNECTION,
    CONTINUATION,
    DENSE_ORDERS,
    EXACT_SHARE,
    FAR_ORDER,
    LARGEST_RATIO,
    SEPARATE_ORDERS,
    close_tail,
    place_knots,
    plan_orders,
)

KNOTS = {
    2: (2,),
    3: (2, 3),
    4: (2, 3, 4),
    5: (2, 3, 4, 5),
    6: (2, 3, 4, 6),
    12: (2, 3, 4, 6, 10, 12),
    18: (2, 3, 4, 6, 10, 18),
    66: (2, 3, 4, 6, 10, 18, 34, 66),
    130: (2, 3, 4, 6, 10, 18, 34, 66, 130),
    258: (2, 3, 4, 6, 10, 18, 34, 66, 258),
    2000: (2, 3, 4, 6, 10, 18, 34, 66, 258, 1026, 2000),
}

DECAYS = {
    "thick": lambda k: k**-1.5,
    "slow": lambda k: 0.97**k,
    "fast": lambda k: 0.7**k,
}
LARGEST_ERRORS = {"thick": 5e-3, "slow": 2e-2, "fast": 3e-3}
"""Relative, of the summed orders at albedos 0.8 to 1; measured: 4.0e-3, 1.95e-2 and 2.4e-3 with 66 orders."""


def orders_of(largest: int) -> torch.Tensor:
    return torch.arange(2, largest + 1, dtype=torch.float64)


def albedo_sums(largest: int, decay: str, albedo: float) -> tuple[float, float]:
    """Sum of albedo^k f_k order by order, and over the knots."""
    plan, orders = plan_orders(largest), orders_of(largest)
    energy = DECAYS[decay](orders)
    knots = torch.tensor(plan.knots, dtype=torch.float64)
    return float((albedo**orders * energy).sum()), float((albedo**knots * (energy @ plan.shares)).sum())


@pytest.mark.parametrize("largest", KNOTS)
def test_distances_of_the_knots_double_and_then_quadruple(largest: int) -> None:
    plan = plan_orders(largest)
    assert plan.knots == KNOTS[largest]
    assert plan.largest_order == largest
    assert plan.shares.shape == (largest - 1, len(plan.knots))
    assert plan.continuation.shape == plan.connection.shape == (largest - 1,)


@pytest.mark.parametrize("largest", KNOTS)
def test_every_order_is_shared_out_wholly_between_its_neighbours(largest: int) -> None:
    plan = plan_orders(largest)
    torch.testing.assert_close(plan.shares.sum(1), torch.ones(largest - 1, dtype=torch.float64))
    assert (plan.shares >= 0.0).all()
    for row, order in enumerate(range(2, largest + 1)):
        used = [plan.knots[number] for number in plan.shares[row].nonzero().flatten().tolist()]
        if order in plan.knots:
            assert used == [order]
        else:
            below, above = max(k for k in plan.knots if k < order), min(k for k in plan.knots if k > order)
            assert used == [below, above]


def test_the_first_orders_stand_for_themselves() -> None:
    plan = plan_orders(66)
    separate = SEPARATE_ORDERS - 1
    assert torch.equal(plan.shares[:separate, :separate], torch.eye(separate, dtype=torch.float64))


@pytest.mark.parametrize("largest", [6, 18, 66])
def test_powers_of_two_albedos_are_exact(largest: int) -> None:
    plan, orders = plan_orders(largest), orders_of(largest)
    knots = torch.tensor(plan.knots, dtype=torch.float64)
    torch.testing.assert_close(plan.shares @ torch.ones_like(knots), torch.ones_like(orders))
    for number, (low, high) in enumerate(zip(plan.knots, plan.knots[1:], strict=False)):
        q = EXACT_SHARE ** (1.0 / low)
        between = (orders >= low) & (orders <= high)
        columns = [number, number + 1]
        found = plan.shares[between][:, columns] @ q ** knots[columns]
        torch.testing.assert_close(found, q ** orders[between])
        if high - low > 1:
            off = plan.shares[between][:, columns] @ (0.9 * q) ** knots[columns]
            assert not torch.allclose(off, (0.9 * q) ** orders[between], rtol=1e-3)


@pytest.mark.parametrize("decay", DECAYS)
@pytest.mark.parametrize("largest", [18, 34, 66])
def test_the_summed_light_is_close_for_every_albedo(decay: str, largest: int) -> None:
    errors = []
    for albedo in torch.linspace(0.8, 1.0, 41).tolist():
        exact, shared = albedo_sums(largest, decay, albedo)
        errors.append(abs(shared / exact - 1.0))
    assert errors[-1] < 1e-7
    assert max(errors) < LARGEST_ERRORS[decay]
    assert max(errors) > 0.1 * LARGEST_ERRORS[decay]


def test_ending_every_order_at_the_knot_below_would_be_worse() -> None:
    """Whole orders in the image of the knot below them, the simplest sharing, err several times as much."""
    plan, orders = plan_orders(66), orders_of(66)
    knots = torch.tensor(plan.knots, dtype=torch.float64)
    below = (torch.bucketize(orders, knots, right=True) - 1).clamp(max=len(knots) - 1)
    for decay, accepted in LARGEST_ERRORS.items():
        energy = DECAYS[decay](orders)
        exact, shared = albedo_sums(66, decay, 0.9)
        lumped = float((0.9 ** knots[below] * energy).sum())
        assert abs(lumped / exact - 1.0) > 2.0 * max(abs(shared / exact - 1.0), 0.1 * accepted)


def test_fewer_paths_go_on_and_fewer_vertices_are_connected_beyond_the_first_knots() -> None:
    plan = plan_orders(18)
    going_on = {
        order: share for order, share in zip(range(2, 19), plan.continuation.tolist(), strict=True) if share < 1
    }
    assert going_on == {5: CONTINUATION, 7: CONTINUATION, 11: CONTINUATION}
    connected = plan.connection.tolist()
    assert connected[: DENSE_ORDERS - 1] == [1.0] * (DENSE_ORDERS - 1)
    assert connected[DENSE_ORDERS - 1 :] == [CONNECTION] * (18 - DENSE_ORDERS)


@pytest.mark.parametrize("largest", [5, 6, 18, 66, 130, 258])
@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.8, 0.95, 0.99, 0.999])
def test_the_tail_of_diffusing_light_is_found(largest: int, ratio: float) -> None:
    plan, orders = plan_orders(largest), orders_of(largest)
    energy = ((0.3 * orders**-1.5 * ratio ** (orders - 2.0)) @ plan.shares).reshape(-1, 1, 1)
    found, share = close_tail(plan, energy)
    assert found.shape == share.shape == (1, 1)
    assert float(found) == pytest.approx(ratio, abs=4e-3 * (1.0 - ratio) + 1e-4)
    last = 0.3 * largest**-1.5 * ratio ** (largest - 2.0)
    assert float(energy[-1, 0, 0] * share) == pytest.approx(last, rel=0.05 if largest > FAR_ORDER else 0.02)
    geometric = ((0.3 * ratio ** (orders - 2.0)) @ plan.shares).reshape(-1, 1, 1)
    assert float(close_tail(plan, geometric)[0]) > ratio


def test_black_images_have_no_tail() -> None:
    plan = plan_orders(18)
    energy = torch.ones(len(plan.knots), 4)
    energy[-1, 0] = energy[-2, 1] = 0.0
    energy[-2:, 2] = 0.0
    ratio, share = close_tail(plan, energy)
    assert not ratio[:3].any()
    assert not share[:3].any()
    assert ratio[3] > 0.0
    assert share[3] > 0.0


@pytest.mark.parametrize("largest", [5, 18, 258])
def test_any_noise_gives_a_tail_within_bounds(largest: int) -> None:
    """Energies that rise from knot to knot, or all but vanish, are noise; neither may give more than the largest ratio or no number."""
    plan = plan_orders(largest)
    last = torch.logspace(-30.0, 30.0, 121, dtype=torch.float64)
    energy = torch.ones(len(plan.knots), 121, dtype=torch.float64)
    energy[-1] = last
    ratio, share = close_tail(plan, energy)
    assert torch.isfinite(ratio).all()
    assert torch.isfinite(share).all()
    assert (ratio.diff() >= 0.0).all()
    assert float(ratio[0]) < 0.4  # 1e-30 from order 130 to 258 is a decay of a third a scattering
    assert float(ratio[-1]) == pytest.approx(LARGEST_RATIO)
    assert float(share.min()) > 0.0
    assert float(share.max()) <= 1.0 + 1e-9


@pytest.mark.parametrize("largest", KNOTS)
def test_knots_are_placed_as_in_the_plan(largest: int) -> None:
    assert tuple(place_knots(largest)) == KNOTS[largest]


@pytest.mark.parametrize("largest", [66, 130, 2000])
def test_knots_of_fewer_orders_are_the_first_ones_but_for_the_last(largest: int) -> None:
    every = place_knots(1 << 30)
    assert place_knots(largest)[:-1] == every[: len(place_knots(largest)) - 1]
    assert (largest in every) is (largest == 66)


@pytest.mark.parametrize("last", [2, 4, 6, 18, 66])
def test_a_plan_until_a_knot_is_the_plan_of_that_many_orders(last: int) -> None:
    part, alone = plan_orders(66).until(last), plan_orders(last)
    assert part.knots == alone.knots
    assert part.largest_order == last
    assert torch.equal(part.shares, alone.shares)
    assert torch.equal(part.continuation, alone.continuation)
    assert torch.equal(part.connection, alone.connection)
    assert part.shares.shape == (last - 1, len(part.knots))
    torch.testing.assert_close(part.shares.sum(1), torch.ones(last - 1, dtype=torch.float64))
    assert last == 66 or not torch.equal(plan_orders(66).shares, part.shares)


def test_a_plan_until_an_order_between_knots_is_none() -> None:
    with pytest.raises(ValueError, match="not in tuple"):
        plan_orders(66).until(7)
