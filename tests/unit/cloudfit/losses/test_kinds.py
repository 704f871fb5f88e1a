import pytest
import torch

from cloudfit.losses.kinds import Loss, PhotographValues, PixelLoss
from render.errors import ParameterError

HALF = Loss("half", 0.0, 1.0, "1", lambda histogram, target: 0.5 * (histogram - target).abs().sum(-1))
BRIGHTER = PixelLoss(
    "brighter",
    0.0,
    1.0,
    "1",
    "bin",
    False,
    lambda photograph: photograph.cloud.mean(-1, keepdim=True),
    lambda values, target: (values.mean(-1) - target[:, 0]).abs().double(),
)


def test_a_loss_of_histograms_computes_in_float64_and_has_no_gradient_to_offer() -> None:
    assert HALF(torch.tensor([1.0, 0.0]), torch.tensor([0.0, 1.0])).dtype == torch.float64
    assert float(HALF(torch.tensor([0.75, 0.25]), torch.tensor([0.25, 0.75]))) == 0.5
    assert not HALF.is_differentiable


def test_a_loss_of_pixels_prepares_its_target_once_and_has_a_gradient() -> None:
    photograph = PhotographValues(torch.tensor([[0.2, 0.4], [0.5, 0.5]]), torch.zeros(2, 1))
    target = BRIGHTER.prepare(photograph)
    assert BRIGHTER(torch.full((4, 2, 7), 0.5), target).shape == (4, 2)
    assert BRIGHTER(torch.full((2, 7), 0.5), target).tolist() == pytest.approx([0.2, 0.0], abs=1e-7)
    assert BRIGHTER.is_differentiable


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"half: .*\(3,\) and \(2,\)"):
        HALF(torch.zeros(3), torch.zeros(2))
    with pytest.raises(ParameterError, match=r"brighter: .*\(5, 7\) and \(2, 1\)"):
        BRIGHTER(torch.zeros(5, 7), torch.zeros(2, 1))
    with pytest.raises(ParameterError, match="brighter"):
        BRIGHTER(torch.zeros(2, 0), torch.zeros(2, 1))
