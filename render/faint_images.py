"""What stands in a table for images that are too faint for a float."""

import torch
from torch import Tensor


def follow_thicker(black: Tensor, nodes: Tensor, log_mean: Tensor, relative: Tensor) -> None:
    """Give images too faint for a float the shape of the next thicker one, and a mean that goes on as those of the next two do.

    What the interpolation makes of a floor instead reaches up to the next images, and has multiplied them by ten.

    Args:
        black: whether an image is too faint `(knot, asymmetry, extinction)`.
        nodes: coordinate of the extinctions `(extinction,)`.
        log_mean: logarithms of the means over their thin powers, changed in place `(knot, asymmetry, extinction)`.
        relative: images over their means, likewise `(knot, asymmetry, extinction, pixel)`.
    """
    last = black.shape[2] - 1
    for node in range(last - 1, -1, -1):
        here, next_one, after = black[:, :, node], log_mean[:, :, node + 1], log_mean[:, :, min(node + 2, last)]
        reach = (nodes[node + 1] - nodes[node]) / (nodes[min(node + 2, last)] - nodes[node + 1]).clamp(min=1e-30)
        going_on = next_one + (next_one - after) * reach.to(after)
        log_mean[:, :, node] = torch.where(here, going_on, log_mean[:, :, node])
        relative[:, :, node][here] = relative[:, :, node + 1][here]
