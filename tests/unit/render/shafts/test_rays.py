import torch

from render.shafts.rays import ViewRays, shifted_edges, uniform_edges


def test_points_and_edges_lie_along_the_rays() -> None:
    rays = ViewRays(
        torch.tensor([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]),
        torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        torch.tensor([4.0, 8.0]),
    )
    edges = uniform_edges(rays, 4)
    torch.testing.assert_close(edges, torch.tensor([[0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 2.0, 4.0, 6.0, 8.0]]))
    torch.testing.assert_close(rays.points_at(edges)[0, -1], torch.tensor([1.0, 6.0, 3.0]))
    assert len(rays[1:]) == 1
    assert rays[torch.tensor([1])].distance.tolist() == [8.0]
    assert rays.doubled().distance.dtype == torch.float64


def test_shifted_steps_tile_the_ray() -> None:
    rays = ViewRays(torch.zeros(2, 3), torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3), torch.tensor([8.0, 2.0]))
    edges = shifted_edges(rays, 4, 0.25)
    torch.testing.assert_close(edges[0], torch.tensor([0.0, 1.5, 3.5, 5.5, 7.5, 8.0]))
    torch.testing.assert_close(edges[1], 0.25 * edges[0])
    torch.testing.assert_close(shifted_edges(rays, 4, 0.0)[:, :-1], uniform_edges(rays, 4))
