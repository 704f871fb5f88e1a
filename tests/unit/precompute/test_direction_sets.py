"""Direction sets integrate harmonics exactly, however the sphere is turned."""

import math

import pytest
import torch

from precompute.direction_sets import DirectionSet, turned_directions
from render.spherical_harmonics import degrees_of_harmonics, evaluate_harmonics

TURNS = [(0.0, 0.0, 0.0), (0.3, 0.7, 0.1), (1.0, 0.25, 0.9)]


def directions(degree: int, turn: tuple[float, ...] = TURNS[1]) -> DirectionSet:
    return turned_directions(degree, torch.tensor(turn))


def mean_power(found: DirectionSet, axis: torch.Tensor, exponent: int) -> float:
    """Mean of (d . axis)^exponent over the sphere: of the projection, the row of l = 0 holds the weights times a constant."""
    weights = found.projection[0].double() / math.sqrt(4.0 * math.pi)
    return float(weights @ (found.direction.double() @ axis) ** exponent)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("degree", [0, 1, 3, 5])
def test_the_projection_gives_every_harmonic_back(degree: int, turn: tuple[float, ...]) -> None:
    found = directions(degree, turn)
    one = torch.eye((degree + 1) ** 2)
    assert found.direction.shape == (2 * (degree + 1) ** 2, 3)
    torch.testing.assert_close(found.projection @ found.harmonics, one, atol=2e-6, rtol=0.0)
    # One direction less spoils it.
    assert float((found.projection[:, 1:] @ found.harmonics[1:] - one).abs().max()) > 1e-2


@pytest.mark.parametrize("turn", TURNS)
def test_directions_are_unit_vectors_with_their_own_harmonics(turn: tuple[float, ...]) -> None:
    found = directions(3, turn)
    torch.testing.assert_close(found.direction.norm(dim=1), torch.ones(32), atol=1e-6, rtol=0.0)
    own = evaluate_harmonics(found.direction.double(), 3).float()
    torch.testing.assert_close(found.harmonics, own, atol=3e-6, rtol=0.0)
    assert not torch.allclose(found.harmonics, own.flip(0), atol=0.1)


@pytest.mark.parametrize("degree", [1, 3])
def test_polynomials_are_integrated_up_to_their_degree_and_no_further(degree: int) -> None:
    """Even powers of a cosine have the mean 1 / (n + 1) over the sphere, odd ones none."""
    axis = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64), dim=0)
    found = directions(degree)
    for exponent in range(2 * degree + 2):
        exact = (1 - exponent % 2) / (exponent + 1)
        assert mean_power(found, axis, exponent) == pytest.approx(exact, abs=1e-6)
    beyond = 2 * degree + 2
    assert abs(mean_power(found, axis, beyond) * (beyond + 1) - 1.0) > 1e-4


def test_other_numbers_turn_the_sphere() -> None:
    plain = directions(3, TURNS[0]).direction
    for turn in TURNS[1:]:
        turned = directions(3, turn).direction
        torch.testing.assert_close(turned @ turned.T, plain @ plain.T, atol=2e-6, rtol=0.0)
        assert float((turned - plain).norm(dim=1).max()) > 0.5
        # A turn, not a mirror image.
        assert torch.det(turned[[0, 9, 20]]).sign() == torch.det(plain[[0, 9, 20]]).sign()
    mirrored = plain[[0, 9, 20]] * torch.tensor([1.0, 1.0, -1.0])
    assert torch.det(mirrored).sign() != torch.det(plain[[0, 9, 20]]).sign()


def test_turns_are_even_over_the_sphere() -> None:
    """Where the first direction goes has no preferred axis: second moments of a third, up to noise of 2000 turns."""
    uniform = torch.rand(2000, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    first = torch.stack([turned_directions(0, turn).direction[0] for turn in uniform]).double()
    # The components of an even unit vector have the variance 1/3, their squares 4/45, products of two 1/15.
    assert float(first.mean(0).abs().max()) < 4.0 * math.sqrt(1.0 / 3.0 / 2000)
    moments = first.T @ first / 2000
    torch.testing.assert_close(moments.diagonal(), torch.full((3,), 1.0 / 3.0, dtype=torch.float64), atol=0.027, rtol=0)
    assert float((moments - moments.diag().diag()).abs().max()) < 4.0 * math.sqrt(1.0 / 15.0 / 2000)
    half = torch.stack([turned_directions(0, turn * 0.5).direction[0] for turn in uniform]).double()
    assert float(half.mean(0).abs().max()) > 0.1


@pytest.mark.parametrize("degree", [4, 5])
def test_halves_give_harmonics_of_a_smaller_degree_back_and_share_no_direction(degree: int) -> None:
    whole = directions(degree)
    halves = whole.halves(3)
    torch.testing.assert_close(torch.cat([half.direction for half in halves]), whole.direction)
    for half in halves:
        assert (half.degree, len(half.direction)) == (3, (degree + 1) ** 2)
        own = evaluate_harmonics(half.direction.double(), 3).float()
        torch.testing.assert_close(half.harmonics, own, atol=1e-5, rtol=0.0)
        torch.testing.assert_close(half.projection @ half.harmonics, torch.eye(16), atol=1e-5, rtol=0.0)


def test_a_half_is_a_rule_of_one_degree_less() -> None:
    """Halves of a set of degree five: products of two harmonics of degree two are integrated, not those of degree five."""
    whole = directions(5)
    weights = 2.0 * whole.projection[0, :36].double() * math.sqrt(4.0 * math.pi)
    for half in whole.halves(5):
        for degree, right in ((2, True), (5, False)):
            harmonics = half.harmonics[:, degrees_of_harmonics(5, odd=True) <= degree].double()
            gram = harmonics.T @ (weights[:, None] * harmonics)
            assert (float((gram - torch.eye(len(gram))).abs().max()) < 1e-6) is right


def test_each_half_sees_every_side_of_the_sphere() -> None:
    for half in directions(4, TURNS[0]).halves(3):
        assert float(half.direction.mean(0).norm()) < 1e-6
        axes = torch.cat([torch.eye(3), -torch.eye(3)])
        assert float((half.direction @ axes.T).amax(0).min()) > 0.8
