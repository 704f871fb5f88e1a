"""The inverse problem: photograph analysis, histogram losses, the fit, optimisers, batches, reports, command line."""

__version__ = "0.1.0"
