import math

import pytest
import torch

from render.errors import ParameterError
from render.shafts.depth_edges import compute_log_depth, depth_gap


def test_gaps_are_ratios_and_the_sky_is_no_gap_from_itself() -> None:
    depth = compute_log_depth(torch.tensor([10.0, 11.0, math.inf, 0.0]))
    assert depth_gap(depth[0], depth[1]).item() == pytest.approx(math.log(1.1))
    assert depth_gap(depth[1], depth[0]).item() == pytest.approx(math.log(1.1))
    assert depth_gap(depth[2], depth[2]).item() == 0.0
    assert depth_gap(depth[3], depth[3]).item() == 0.0
    assert depth_gap(depth[0], depth[2]).item() == math.inf
    assert depth_gap(depth[3], depth[2]).item() == math.inf


def test_the_unit_of_length_does_not_matter() -> None:
    depth = torch.tensor([10.0, 13.0])
    gaps = [depth_gap(*compute_log_depth(scale * depth)).item() for scale in (1e-3, 1.0, 1e3)]
    assert gaps == pytest.approx([math.log(1.3)] * 3, rel=1e-5)


@pytest.mark.parametrize("bad", [-1.0, math.nan])
def test_a_depth_that_is_none_is_refused(bad: float) -> None:
    with pytest.raises(ParameterError, match="at least 0 m"):
        compute_log_depth(torch.tensor([1.0, bad]))
