from pathlib import Path

import pytest
import torch

from cloudfit.analysis import analyse_photograph
from cloudfit.example_photographs import EXAMPLES, HEIGHT, WIDTH, render_example, simple_sky, write_examples
from cloudfit.photograph import read_photograph


def test_the_sky_brightens_towards_the_horizon() -> None:
    sky = simple_sky((0.0, 0.1, 0.4), (0.3, 0.5, 0.7), 5, 20)
    assert sky.shape == (20, 5, 3)
    assert bool((sky.diff(dim=0) > 0.0).all())


def test_the_ready_made_examples_have_clouds_that_are_found(tmp_path: Path) -> None:
    for path in write_examples(tmp_path):
        analysis = analyse_photograph(read_photograph(path))
        assert analysis.photograph.original_size == (HEIGHT, WIDTH)
        assert 0.1 < analysis.mask.cloud_fraction < 0.9


@pytest.mark.slow
def test_a_ready_made_example_is_what_the_path_tracer_renders() -> None:
    example = EXAMPLES[0]
    ready = read_photograph(Path(__file__).parents[3] / "cloudfit" / "examples" / f"{example.name}.png").pixels
    fresh = render_example(example, samples=4, seed=99)
    blocks = (-1, HEIGHT // 20, 20, WIDTH // 20, 20, 3)
    unclipped = (ready < 0.9).all(-1, keepdim=True)
    difference = ((fresh - ready) * unclipped).reshape(blocks).mean((2, 4))
    assert float(difference.abs().mean()) < 0.02
    assert float((ready * unclipped).reshape(blocks).mean((2, 4)).std()) > 0.05
    assert torch.isfinite(fresh).all()
