import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from render.errors import ParameterError
from render.shafts.epipolar import EpipolarLines, LightImage, arrange_lines

WIDTH, HEIGHT = 40, 24

LIGHTS = {
    "in the middle": (20.0, 12.0, 1.0),
    "on a pixel": (7.5, 3.5, 1.0),
    "in a corner": (0.0, 0.0, 1.0),
    "on a side": (40.0, 5.0, 1.0),
    "off the frame": (-30.0, 10.0, 1.0),
    "beyond a corner": (70.0, -40.0, 1.0),
    "behind the camera": (-20.0, -12.0, -1.0),
    "far away": (3e7, 2e7, 1.0),
    "at infinity": (-0.6, 0.8, 0.0),
    "at infinity along a row": (1.0, 0.0, 0.0),
}


def lines_of(
    light: tuple[float, float, float], gap: float = 3.0, width: int = WIDTH, height: int = HEIGHT
) -> EpipolarLines:
    return arrange_lines(LightImage(*light, width, height), gap)


def pixel_centres(width: int = WIDTH, height: int = HEIGHT) -> torch.Tensor:
    number = torch.arange(width * height)
    return torch.stack([number % width, number // width], dim=1).double() + 0.5


def rebuild(lines: EpipolarLines, points: torch.Tensor) -> torch.Tensor:
    """Points from the two lines that they are located between."""
    line, fraction, inward = lines.locate(points)
    before, after = lines.points_at(line, inward), lines.points_at(line + 1, inward)
    return torch.lerp(before, after, fraction[:, None])


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())
def test_every_pixel_lies_where_it_is_located(light: tuple[float, float, float]) -> None:
    lines = lines_of(light)
    line, fraction, inward = lines.locate(pixel_centres())
    assert torch.allclose(rebuild(lines, pixel_centres()), pixel_centres(), atol=1e-6)
    assert bool(((fraction >= 0.0) & (fraction <= 1.0)).all())
    assert 0 <= int(line.min()) <= int(line.max()) < lines.lines - 1
    moved = torch.lerp(lines.points_at(line, inward), lines.points_at(line + 1, inward), 1.0 - fraction[:, None])
    assert not torch.allclose(moved, pixel_centres(), atol=1e-2)


@given(
    st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-10.0, 10.0)),
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(0.3, 100.0),
)
@settings(max_examples=200, deadline=None)
def test_pixels_are_located_whatever_the_light(
    light: tuple[float, float, float], width: int, height: int, gap: float
) -> None:
    if max(abs(number) for number in light) == 0.0:
        return
    lines = lines_of(light, gap, width, height)
    points = pixel_centres(width, height)
    assert torch.allclose(rebuild(lines, points), points, atol=1e-6)


@pytest.mark.parametrize("light", [light for light in LIGHTS.values() if light[2]])
def test_lines_pass_through_the_light(light: tuple[float, float, float]) -> None:
    """The cross product of two directions from the light to points of a line is zero."""
    lines = lines_of(light)
    every = torch.arange(lines.lines)
    seen = torch.tensor([light[0] / light[2], light[1] / light[2]], dtype=torch.float64)
    first, second = (lines.points_at(every, torch.full((lines.lines,), q, dtype=torch.float64)) for q in (0.0, 0.3))
    toward = torch.nn.functional.normalize(first - seen, dim=1)
    along = torch.nn.functional.normalize(second - first, dim=1)
    assert float((toward[:, 0] * along[:, 1] - toward[:, 1] * along[:, 0]).abs().max()) < 1e-6
    inward = torch.full((lines.lines,), lines.light.scale / lines.light.w, dtype=torch.float64)
    assert torch.allclose(lines.points_at(every, inward), seen.expand(lines.lines, 2), rtol=1e-6, atol=1e-6)


def test_lines_end_where_the_light_leaves_the_frame() -> None:
    def borders(light: tuple[float, float, float]) -> set[tuple[int, float]]:
        return {(side.axis, side.border) for side in LightImage(*light, WIDTH, HEIGHT).exit_sides}

    left, right, top, bottom = (0, 0.0), (0, 40.0), (1, 0.0), (1, 24.0)
    assert borders(LIGHTS["in the middle"]) == {left, right, top, bottom}
    assert borders(LIGHTS["in a corner"]) == {right, bottom}
    assert borders(LIGHTS["on a side"]) == {left, top, bottom}
    assert borders(LIGHTS["off the frame"]) == {right, top, bottom}
    assert borders(LIGHTS["at infinity along a row"]) == {left}
    assert borders(LIGHTS["behind the camera"]) == borders(LIGHTS["in the middle"])


def test_ends_lie_evenly_on_the_border() -> None:
    lines = lines_of(LIGHTS["in a corner"], gap=5.0)
    assert lines.sectors == (5, 8)
    assert lines.ends[:6].tolist() == [[40.0, pytest.approx(4.8 * n)] for n in range(6)]
    assert lines.ends[6:].tolist() == [[5.0 * n, 24.0] for n in range(9)]


def test_what_is_no_image_of_a_light_is_refused() -> None:
    for light in ((0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 1.0)):
        with pytest.raises(ParameterError, match="finite"):
            LightImage(*light, WIDTH, HEIGHT)
    with pytest.raises(ParameterError, match="one pixel"):
        LightImage(1.0, 1.0, 1.0, 0, 4)
    with pytest.raises(ParameterError, match="gap"):
        lines_of(LIGHTS["in a corner"], gap=0.0)
