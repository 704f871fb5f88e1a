import pytest
import torch

from render.errors import ParameterError
from render.media import MEDIA, compute_optical_depth, find_medium


def test_every_medium_is_found_by_its_name() -> None:
    for name, medium in MEDIA.items():
        assert find_medium(name) is medium
    with pytest.raises(ParameterError, match="uniform, linear, exponential"):
        find_medium("pea soup")


def test_every_medium_is_made_of_an_extinction_and_a_height() -> None:
    depths = [compute_optical_depth(make(0.01, 100.0), torch.tensor(0.0), 1.0).item() for make in MEDIA.values()]
    assert depths == pytest.approx([1.0, 0.5, 1.0])
