"""Strata of rays that nobody needs single scattering of."""

from torch import Tensor

from precompute.gather import Strata
from render.density_grid import DensityGrid
from render.ray_march import march_rays


def stratify_rays(grid: DensityGrid, origin: Tensor, direction: Tensor, extinction: Tensor, strata: int) -> Strata:
    """Strata of rays `(ray, 3)` for every extinction `(extinction,)` [1/m]."""
    found = Strata.uncut(len(extinction), len(origin), strata)
    found.cut(extinction, slice(len(origin)), march_rays(grid, origin, direction))
    return found
