"""What every test runs under."""

from collections.abc import Iterator

import pytest
import torch

from render.fused import fused_loops_wanted, torch_loops_only


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Small tensors gain nothing from threads, and threads that fight for busy cores lose much."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=["torch", "fused"])
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run a test with the torch loops and with their fused twins."""
    if request.param == "fused":
        if not fused_loops_wanted():
            pytest.skip("numba is not installed, or not to be used")
        yield
    else:
        with torch_loops_only():
            yield
