"""The fused loop of the reference path tracer follows the same paths as the torch loop."""

import pytest
import torch

from render.fused import torch_loops_only
from render.path_tracer import ReferenceImage, trace_reference
from tests.support.volumes import noise_box, towards, uniform_box, view_north

pytest.importorskip("numba")

NAMES = ("orders", "orders_variance", "radiance", "radiance_variance", "transmittance", "transmittance_variance")


def both(**changes: float) -> tuple[ReferenceImage, ReferenceImage]:
    settings: dict[str, float] = {"extinction": 1.5, "asymmetry": 0.6, "albedo": 0.95, "orders": 8, "samples": 60}
    sun, camera = towards(40.0, 30.0), view_north(8, 6, 6.0)
    grid = noise_box(sparse=0.4)

    def trace() -> ReferenceImage:
        return trace_reference(grid, camera, sun, **{**settings, **changes})  # type: ignore[arg-type]

    with torch_loops_only():
        plain = trace()
    return trace(), plain


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"seed": 5},
        {"asymmetry": -0.7},
        {"asymmetry": 0.0, "albedo": 0.0},
        {"asymmetry": 0.95},
        {"extinction": 0.01},
        {"extinction": 40.0, "samples": 8},
        {"extinction": 0.0},
        {"orders": 1},
        {"orders": 30, "recorded": 2, "albedo": 1.0, "extinction": 5.0},
    ],
)
def test_both_loops_follow_the_same_paths(changes: dict[str, float]) -> None:
    fused, plain = both(**changes)
    for name in NAMES:
        # A flight may end on the other side of a rounding error; such a path is one of many.
        torch.testing.assert_close(getattr(fused, name), getattr(plain, name), rtol=2e-3, atol=1e-6)


def test_threads_are_no_part_of_the_result() -> None:
    threads = torch.get_num_threads()
    try:
        images = []
        for count in (1, 3):
            torch.set_num_threads(count)
            images.append(trace_reference(uniform_box(), view_north(5, 4, 6.0), towards(0.0, 50.0), **ARGUMENTS))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(images[0].orders, images[1].orders)


def test_a_pixel_does_not_know_which_others_are_traced() -> None:
    whole = trace_reference(uniform_box(), view_north(5, 4, 6.0), towards(0.0, 50.0), **ARGUMENTS)
    one = torch.tensor([11])
    alone = trace_reference(uniform_box(), view_north(5, 4, 6.0), towards(0.0, 50.0), pixels=one, **ARGUMENTS)
    assert torch.equal(whole.orders[:, one], alone.orders[:, one])


ARGUMENTS: dict[str, object] = {"extinction": 0.5, "asymmetry": 0.3, "albedo": 1.0, "orders": 5, "samples": 40}
