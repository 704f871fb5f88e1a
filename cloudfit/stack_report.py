"""What a stack models, at which error and why no more, in sentences."""

from collections.abc import Mapping, Sequence
from typing import Any


def describe_groups(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """One sentence for each group of extinctions, from the reports that a builder leaves in `ScatteringTables.groups`."""
    return [_describe_group(group) for group in groups]


def _describe_group(group: Mapping[str, Any]) -> str:
    depth = f"optical depth {group['thinnest']:.3g} to {group['thickest']:.3g}"
    seconds = sum(group["seconds"].values())
    omitted = (
        f"; the orders beyond add {group['omitted_share']:.1%} at most and come from a pilot"
        if group["omitted_share"]
        else ""
    )
    if group["largest_order"] == 1:
        return f"{depth}: single scattering{omitted} ({group['stop_reason']}), {seconds:.1f} s"
    carried = f", the high orders carried on {group['carried_points']:,} points" if group["carried_points"] else ""
    return (
        f"{depth}: orders to {group['largest_order']}{omitted}; {group['paths']:,} paths from {group['points']:,} points "
        f"{group['spacing']:.2g} voxels apart{carried}; error {group['error']:.1%} ({group['stop_reason']}), {seconds:.1f} s"
    )
