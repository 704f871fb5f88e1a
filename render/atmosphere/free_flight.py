"""Free flights through the air by inverting the optical depth, and the weights of paths that stand for all wavelengths.

The optical depth is known exactly where a ray passes from shell to shell. Between two crossings a flight is drawn as if the extinction
were its mean there; the exact transmittance up to the end, over the density with which that end was drawn, makes up for it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from render.atmosphere.air_ray import AirRay
from render.atmosphere.shells import Shells, piece_columns, shell_columns, shell_crossings


@dataclass(frozen=True, eq=False)
class Weights:
    """What paths contribute at each wavelength, and how likely each wavelength as hero would have been to choose them.

    Args:
        contribution: product of the steps' contributions `(lane, wavelength)`, up to a common factor of a lane.
        density: product of the densities of the steps, for each hero `(lane, wavelength)`, up to the same factor.
    """

    contribution: Tensor
    density: Tensor

    @staticmethod
    def ones(lanes: int, wavelengths: int) -> "Weights":
        """Weights of paths without steps."""
        one = torch.ones(lanes, wavelengths, dtype=torch.float64)
        return Weights(one, one)

    def __getitem__(self, chosen: Tensor) -> "Weights":
        """The weights of some of the paths."""
        return Weights(self.contribution[chosen], self.density[chosen])

    def joined(self, others: "Weights") -> "Weights":
        """These weights and those of other paths behind them."""
        return Weights(torch.cat([self.contribution, others.contribution]), torch.cat([self.density, others.density]))

    def times(self, contribution: Tensor, density: Tensor) -> "Weights":
        """Weights after one more step; contributions and densities of the step `(lane, wavelength)`.

        Both are divided by the largest density, which changes no quotient and keeps long paths from underflow.
        """
        contribution, density = self.contribution * contribution, self.density * density
        largest = density.amax(-1, keepdim=True)
        scale = torch.where(largest > 0.0, largest, 1.0)
        return Weights(contribution / scale, density / scale)

    def estimate(self) -> Tensor:
        """Contributions over the mean density of the heroes `(lane, wavelength)`: the balance heuristic."""
        return self.contribution / self.density.mean(-1, keepdim=True)


def fly(
    shells: Shells, rays: AirRay, forced: Tensor, hero: Tensor, weights: Weights, uniform: Tensor
) -> tuple[Tensor, Tensor, Tensor, Weights]:
    """One flight of each path.

    Args:
        shells: the air.
        rays: along which they fly, one a lane.
        forced: whether a flight must end in the air even if its ray meets the ground `(lane,)`; where a ray leads into space all do.
        hero: number of the wavelength that chooses `(lane,)`.
        weights: of the paths.
        uniform: random numbers inside (0, 1) `(lane,)`.

    Returns:
        Distance flown `(lane,)` [m]; whether the flight ended on the ground `(lane,)`; whether it ended at all, which it does not
        where there is nothing to collide with `(lane,)`; and the weights.
    """
    at = shell_crossings(shells, rays.radius, rays.cos_view, rays.length(shells.atmosphere))
    depth = shell_columns(shells, rays.radius, rays.cos_view, at) @ shells.extinction
    depth = torch.cat([torch.zeros_like(depth[:, :1]), depth.cumsum(1)], dim=1)
    total = depth[:, -1]
    lane = torch.arange(len(hero))
    in_air = forced | ~rays.intersects_ground
    opacity = -torch.expm1(-total)
    reach = torch.where(in_air[:, None], opacity, 1.0)

    sought = -torch.log1p(-uniform * reach[lane, hero])
    on_ground = ~in_air & (sought >= total[lane, hero])
    # Rounding may reach the end of the ray, where there is no piece to be in.
    sought = torch.minimum(sought, torch.nextafter(total[lane, hero], torch.zeros_like(sought)))
    of_hero = depth[lane, :, hero]
    piece = (of_hero[:, 1:] <= sought[:, None]).sum(-1).clamp(max=of_hero.shape[-1] - 2)
    alive = on_ground | (total[lane, hero] > 0.0)

    first, length = at[lane, piece], at[lane, piece + 1] - at[lane, piece]
    inside = depth[lane, piece + 1] - depth[lane, piece]
    crossed = inside[lane, hero]
    share = (sought - of_hero[lane, piece]) / torch.where(crossed > 0.0, crossed, 1.0)
    distance = first + share * length
    column = piece_columns(shells, rays.radius, rays.cos_view, first, distance)
    transmittance = torch.exp(-(depth[lane, piece] + column @ shells.extinction))
    assumed = torch.exp(-(depth[lane, piece] + share[:, None] * inside)) * inside / length[:, None]
    density = torch.where(reach > 0.0, assumed / torch.where(reach > 0.0, reach, 1.0), 0.0)

    through = torch.exp(-total)
    ended = weights.times(
        torch.where(on_ground[:, None], through, transmittance), torch.where(on_ground[:, None], through, density)
    )
    return torch.where(on_ground, at[:, -1], distance), on_ground, alive, ended
