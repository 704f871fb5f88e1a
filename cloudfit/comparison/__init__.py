"""Comparison of optimisers on cloud problems: runs that can be resumed, statistics with their sources, tables, logs and a page."""
