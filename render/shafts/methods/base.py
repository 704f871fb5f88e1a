"""What a method is: settings, and a way from a scene that is ready to its in-scattered light."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, Self

from torch import Tensor

from render.errors import ParameterError
from render.shafts.stage import Stage


@dataclass(frozen=True, eq=False)
class Gathered:
    """Outcome of a method.

    Args:
        in_scattering: light of sun and lamps that the air adds `(pixel, channel)`.
        modelled: sentences about what was computed.
        skipped: sentences about what was left out, and why.
        seconds: of the method's own parts [s].
    """

    in_scattering: Tensor
    modelled: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)


class Method(Protocol):
    """A frozen dataclass of settings."""

    def gather(self, stage: Stage) -> Gathered:
        """In-scattered light of every pixel."""

    def refined(self) -> Self:
        """The same method with settings of about half the error."""

    def at_full_density(self, steps: int) -> "Method":
        """The same method with everything it spares switched off: as many equal steps along every pixel's ray."""


def check_steps(steps: int) -> None:
    """Raise ParameterError for a number of steps below 1."""
    if steps < 1:
        raise ParameterError(f"expected at least one step along a ray, got {steps}")
