"""Orders beyond the last: sums of powers are continued exactly, noise and growth are not."""

import pytest
import torch

from precompute.order_tail import HISTORY, LAGS, extrapolate_orders

POINTS, BEYOND = 500, 200


def modes(ratios: list[float], orders: int = HISTORY + BEYOND) -> torch.Tensor:
    """Orders `(order, point, 1)` that are sums of powers, each ratio with a place of its own to shine."""
    shine = torch.rand(len(ratios), POINTS, generator=torch.Generator().manual_seed(3), dtype=torch.float64) + 0.1
    powers = torch.tensor(ratios, dtype=torch.float64) ** torch.arange(orders, dtype=torch.float64)[:, None]
    return (powers @ shine)[..., None].float()


def continued(values: torch.Tensor, shares: torch.Tensor) -> torch.Tensor:
    return extrapolate_orders(list(values[:HISTORY]), shares)


@pytest.mark.parametrize("ratios", [[0.9], [0.97, 0.8], [0.985, 0.93, 0.85], [0.985, 0.95, 0.9, 0.8]])
def test_sums_of_powers_go_on(ratios: list[float]) -> None:
    values = modes(ratios)
    # Single orders of all residues, and all of them together.
    shares = torch.zeros(BEYOND, 5)
    for column, order in enumerate((0, 1, 6, 43)):
        shares[order, column] = 1.0
    shares[:, 4] = 1.0
    expected = torch.einsum("ok,opc->kpc", shares, values[HISTORY:])
    torch.testing.assert_close(continued(values, shares), expected, rtol=0.01, atol=0.0)


def test_one_ratio_for_all_points_would_not_do() -> None:
    values = modes([0.985, 0.93])
    expected = values[HISTORY:].sum(0)
    ratio = values[HISTORY - 1].mean() / values[HISTORY - 2].mean()
    geometric = values[HISTORY - 1] * (ratio / (1.0 - ratio))
    assert float(((geometric - expected) / expected).abs().max()) > 0.1
    found = continued(values, torch.ones(BEYOND, 1))[0]
    assert float(((found - expected) / expected).abs().max()) < 0.01


def test_columns_do_not_depend_on_each_other() -> None:
    values = torch.cat([modes([0.98, 0.9]), modes([0.7])], dim=2)
    shares = torch.ones(BEYOND, 1)
    alone = [continued(values[..., column : column + 1], shares) for column in range(2)]
    torch.testing.assert_close(continued(values, shares), torch.cat(alone, dim=2))


def test_what_grows_or_is_nothing_has_no_tail() -> None:
    shares = torch.ones(BEYOND, 2)
    assert not continued(modes([1.05]), shares).any()
    assert not continued(torch.zeros(HISTORY, POINTS, 1), shares).any()


def test_noise_stays_small() -> None:
    generator = torch.Generator().manual_seed(7)
    noise = torch.randn(HISTORY, POINTS, 1, generator=generator)
    found = continued(noise, torch.ones(BEYOND, 1))
    assert torch.isfinite(found).all()
    assert float(found.abs().max()) < 5.0 * float(noise.abs().max())


@pytest.mark.parametrize("known", [1, 3, 5, 9, 4 * LAGS])
def test_a_short_history_is_enough_for_few_modes(known: int) -> None:
    values = modes([0.9])
    found = extrapolate_orders(list(values[:known]), torch.ones(BEYOND, 1))[0]
    expected = values[known : known + BEYOND].sum(0)
    if known <= 4:
        assert not found.any()
    else:
        torch.testing.assert_close(found, expected, rtol=0.01, atol=0.0)
