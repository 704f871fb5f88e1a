import pytest
import torch

from render.colour import DISPLAY_CURVES, linear_to_srgb, luminance, srgb_to_linear


def test_known_points_of_the_srgb_curve():
    # IEC 61966-2-1: the linear piece ends at 0.04045 = 12.92 x 0.0031308; half of the scale is 0.21404.
    encoded = torch.tensor([[0.0, 0.04045, 0.5], [1.0, 0.02, 0.0404]])
    expected = torch.tensor([[0.0, 0.0031308, 0.2140411], [1.0, 0.02 / 12.92, 0.0404 / 12.92]])
    torch.testing.assert_close(srgb_to_linear(encoded), expected, atol=2e-6, rtol=0.0)


def test_the_curve_is_not_a_plain_power():
    encoded = torch.full((1, 3), 0.5)
    assert abs(float(srgb_to_linear(encoded)[0, 0]) - 0.5**2.4) > 0.01


@pytest.mark.parametrize("shape", [(3,), (5, 3), (2, 4, 3), (2, 3, 4, 3)])
def test_encoding_inverts_decoding_in_every_shape(shape):
    encoded = torch.rand(shape, generator=torch.Generator().manual_seed(1)) * 1.5
    torch.testing.assert_close(linear_to_srgb(srgb_to_linear(encoded)), encoded, atol=1e-5, rtol=0.0)


def test_colours_keep_their_places():
    colours = torch.arange(12.0).reshape(2, 2, 3) / 12.0
    decoded = srgb_to_linear(colours)
    torch.testing.assert_close(decoded[1, 0], srgb_to_linear(colours[1, 0]))
    assert (decoded.flatten().diff() > 0).all()


def test_the_curve_has_finite_slopes_at_black():
    linear = torch.zeros(1, 3, requires_grad=True)
    linear_to_srgb(linear).sum().backward()
    torch.testing.assert_close(linear.grad, torch.full((1, 3), 12.92))


def test_luminance_of_white_is_one_and_green_outweighs_blue():
    assert float(luminance(torch.ones(3))) == pytest.approx(1.0)
    green, blue = luminance(torch.eye(3))[1:]
    assert float(green) == pytest.approx(0.7152)
    assert green > blue


def test_a_wrong_channel_count_is_refused():
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        srgb_to_linear(torch.zeros(4, 2))


def test_display_curves():
    linear = torch.full((1, 3), 0.2140411)
    torch.testing.assert_close(DISPLAY_CURVES["srgb"](linear), torch.full((1, 3), 0.5), atol=1e-5, rtol=0.0)
    assert DISPLAY_CURVES["none"](linear) is linear
