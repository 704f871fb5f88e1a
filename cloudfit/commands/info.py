"""`cloudfit info`: what a volume, a stack of tables or a result holds."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from cloudfit.commands import options as o
from cloudfit.commands.console import EXIT_CODES, Speaker, print_json, print_table, reported_errors

EPILOG = f"""Examples:

cloudfit info cloud.vol

cloudfit info results/beach/result.json

cloudfit info results/.tables/stack-0123456789abcdef.safetensors --json

{EXIT_CODES}"""

File = Annotated[
    Path, typer.Argument(help="A volume, a file of tables, a result.json or its folder.", show_default=False)
]


def info(file: File, quiet: o.Quiet = False, json: o.AsJson = False) -> None:
    """Tell what a volume, a stack of tables or a result holds."""
    with reported_errors(Speaker(quiet)):
        document = describe_file(file)
        if json:
            print_json(document)
        else:
            print_table(
                ["", ""], [[name.replace("_", " "), _write(value)] for name, value in _flatten(document)], left=2
            )


def describe_file(path: Path) -> dict[str, Any]:
    """What a file holds.

    Raises:
        InputError: the file is missing, damaged, or of no kind that is known here.
    """
    kind = "folder" if path.is_dir() else path.suffix.lower()
    return _KINDS.get(kind, _describe_volume)(path)


def _describe_volume(path: Path) -> dict[str, Any]:
    from cloudfit.scene_record import volume_hash
    from render.volume_files import read_volume

    grid = read_volume(path)
    z, y, x = grid.density.shape
    return {
        "kind": "volume",
        "file": str(path),
        "voxels": [x, y, z],
        "voxel_size_m": grid.voxel_size.tolist(),
        "lower_m": grid.lower.tolist(),
        "upper_m": grid.upper.tolist(),
        "largest_density": grid.maximum,
        "mean_density": float(grid.density.double().mean()),
        "filled_voxels": float((grid.density > 0).double().mean()),
        "sha256": volume_hash(grid),
    }


def _describe_stack(path: Path) -> dict[str, Any]:
    from safetensors import SafetensorError, safe_open

    from cloudfit.stack_report import describe_groups
    from precompute.stack_store import load_stack
    from precompute.store import load_tables
    from render.errors import InputError, StoreError

    try:
        with safe_open(path, framework="pt") as file:
            key = (file.metadata() or {}).get("key", "")
        tables, (_, provenance) = load_stack(path, key), load_tables(path, key)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; check the name") from error
    except (SafetensorError, StoreError, OSError) as error:
        raise InputError(f"cannot read the tables {path}: {error}") from error
    return {
        "kind": "scattering stack",
        "file": str(path),
        "bytes": path.stat().st_size,
        "width": tables.width,
        "height": tables.height,
        "cloud_pixels": len(tables.pixel),
        "largest_optical_length_m": tables.largest_optical_length,
        "knots": tables.knots.tolist(),
        "asymmetry_nodes": tables.asymmetry.tolist(),
        "extinction_nodes_per_m": tables.extinction.tolist(),
        "median_image_error": float(tables.image_error.median()),
        "largest_image_error": float(tables.image_error.max()),
        "largest_image_error_at_albedo_one": float(tables.bright_error.max()),
        "modelled": describe_groups(tables.groups),
        "provenance": provenance,
        "key": key,
    }


def _describe_result(path: Path) -> dict[str, Any]:
    from cloudfit.result import read_result

    document = read_result(path)
    gist: dict[str, Any] = {
        "kind": "result",
        "photograph": document["photograph"]["file"],
        "status": document["status"],
        "reason": document["reason"],
        "volume": document["scene"]["volume"]["file"] or "procedural cumulus",
        "sun_azimuth_deg": document["scene"]["sun_azimuth_deg"],
        "sun_elevation_deg": document["scene"]["sun_elevation_deg"],
        "quality": document["options"]["quality"],
    }
    if document["status"] == "done":
        best = document["candidates"][0]
        gist |= {
            name: best[name] for name in ("loss", "floor", "wasserstein_levels", "air_depth", "ambient_light_per_m")
        }
        gist |= {
            name if parameter["unit"] == "1" else f"{name}_per_m": parameter["value"]
            for name, parameter in best["parameters"].items()
        }
        gist |= {"candidates": len(document["candidates"]), "stop_reason": document["search"]["stop_reason"]}
    return {**gist, "seconds": document["seconds"]["total"], "warnings": document["warnings"]}


_KINDS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".json": _describe_result,
    "folder": _describe_result,
    ".safetensors": _describe_stack,
}


def _flatten(document: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in document.items():
        rows += _flatten(value, f"{prefix}{name} ") if isinstance(value, dict) else [(f"{prefix}{name}", value)]
    return rows


def _write(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_write(item) for item in value) or "none"
    if isinstance(value, float):
        return f"{value:.5g}"
    return "none" if value is None else str(value)
