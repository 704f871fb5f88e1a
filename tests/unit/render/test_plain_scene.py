import itertools
import math

import torch

from render.plain_scene import POLE, POLE_DISTANCES, POLE_HEIGHT, POLE_OFFSET, POLE_RADIUS, RIDGES, trace_plain


def trace(
    direction: tuple[float, float, float], height: float = 5.0, azimuth: float = 0.0
) -> tuple[float, float, list[float]]:
    ray = torch.nn.functional.normalize(torch.tensor([direction], dtype=torch.float64), dim=-1)
    found = trace_plain(torch.tensor([[0.0, 0.0, height]], dtype=torch.float64), ray, azimuth)
    return found.distance.item(), found.height.item(), found.normal[0].tolist()


def test_down_is_the_ground_and_up_is_the_sky() -> None:
    assert trace((0.0, 0.0, -1.0)) == (5.0, 0.0, [0.0, 0.0, 1.0])
    assert trace((0.0, 0.6, -0.8))[0] == 6.25
    assert math.isinf(trace((0.0, 0.1, 1.0))[0])
    assert math.isinf(trace((0.0, -1.0, 1e-9))[0])


def test_a_pole_stands_where_it_is_said_to() -> None:
    away = POLE_DISTANCES[0]
    distance, height, normal = trace((POLE_OFFSET, away, 0.0))
    assert abs(distance - (math.hypot(POLE_OFFSET, away) - POLE_RADIUS)) < 1e-9
    assert height == 5.0
    assert normal[1] < -0.8
    over = trace((POLE_OFFSET, away, POLE_HEIGHT))
    assert over[0] > away
    turned = trace((away, -POLE_OFFSET, 0.0), azimuth=0.5 * math.pi)
    assert abs(turned[0] - distance) < 1e-9
    ray = torch.nn.functional.normalize(torch.tensor([[POLE_OFFSET, away, 0.0]], dtype=torch.float64), dim=-1)
    colour = trace_plain(torch.tensor([[0.0, 0.0, 5.0]], dtype=torch.float64), ray, 0.0).albedo[0]
    assert torch.allclose(colour, torch.tensor(POLE, dtype=torch.float64))


def test_ridges_rise_one_behind_the_other() -> None:
    distances = [trace((0.01, 1.0, slope))[0] for slope in torch.linspace(0.001, 0.3, 200).tolist()]
    met = sorted(
        {min((away for away, _ in RIDGES), key=lambda a, d=d: abs(a - d)) for d in distances if math.isfinite(d)}
    )
    assert len(met) >= 3
    assert met == sorted(met)
    assert math.isinf(distances[-1])
    assert all(b >= 0.99 * a for a, b in itertools.pairwise(distances))


def test_a_camera_far_up_sees_the_ground() -> None:
    assert trace((0.0, 0.0, -1.0), height=1e7)[0] == 1e7
