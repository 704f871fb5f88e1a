"""What a fit found out, as the document that `result.json` holds and the pages show."""

import math
import platform
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from cloudfit import __version__
from cloudfit.determination import Determination
from cloudfit.fit_types import Candidate, FitOptions, PhotographFit
from cloudfit.optimisers import OPTIMISERS
from cloudfit.parameters import Parameter, SearchSpace
from cloudfit.quality import QUALITIES
from cloudfit.result import SCHEMA, Question, finite_or_none
from cloudfit.scene_record import describe_scene

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

BOUND_MARGIN = 0.005
"""A parameter within this share of its range from an end sits on its bound."""

NEAR_FLOOR = 1.5
"""A loss of at most this many floors is as good as a loss can be told to be."""


@dataclass(frozen=True)
class Circumstances:
    """What a document tells beside the fit itself.

    Args:
        photograph: the file.
        mask: the user's mask, or None.
        question: everything that the result depends on.
        seconds: by stage.
    """

    photograph: Path
    mask: Path | None
    question: Question
    seconds: Mapping[str, float]


def describe_reason(status: str, reason: str, circumstances: Circumstances) -> dict[str, Any]:
    """Document of a photograph that was not fitted; `status` is "failed" or "no_cloud"."""
    document = _common(circumstances, status)
    return {**document, "reason": reason}


def describe_fit(fit: PhotographFit, space: SearchSpace, circumstances: Circumstances) -> dict[str, Any]:
    """Document of a fit.

    Args:
        fit: what was found.
        space: ranges in which it was searched.
        circumstances: everything else.
    """
    photograph, mask, sunlight = fit.analysis.photograph, fit.analysis.mask, fit.analysis.sunlight
    document = _common(circumstances, "done")
    original_height, original_width = photograph.original_size
    height, width = photograph.pixels.shape[:2]
    document["interrupted"] = fit.interrupted
    document["photograph"] |= {
        "original_width": original_width,
        "original_height": original_height,
        "width": width,
        "height": height,
        "bit_depth": photograph.bit_depth,
        "exposure": photograph.exposure,
    }
    document["mask"] |= {
        "source": mask.source,
        "cloud_fraction": mask.cloud_fraction,
        "cloud_pixels": int(mask.cloud.sum()),
        "sky_pixels": int(mask.sky.sum()),
        "other_pixels": int(mask.other.sum()),
    }
    document["sunlight"] = {
        "colour": sunlight.colour.tolist(),
        "grey_threshold": sunlight.grey_threshold,
        "bright_fraction": sunlight.bright_fraction,
        "sky_colour": sunlight.ambient_sky_colour.tolist(),
    }
    document["candidates"] = [
        _describe_candidate(rank, candidate, fit, space, circumstances.question.options)
        for rank, candidate in enumerate(fit.candidates, 1)
    ]
    document["search"] = {
        "stop_reason": fit.stop_reason,
        "evaluations": fit.evaluations,
        "iterations": fit.iterations,
        "history": [finite_or_none(loss) for loss in fit.history],
    }
    document["determination"] = None if fit.determination is None else _describe_determination(fit.determination, space)
    document["warnings"] = list(fit.warnings)
    return document


def describe_options(options: FitOptions) -> dict[str, Any]:
    """The user's choices; a preset by its name, with its numbers beside it."""
    quality = next((name for name, preset in QUALITIES.items() if preset == options.quality), "custom")
    return {
        "quality": quality,
        "quality_settings": asdict(options.quality),
        "optical_depths": list(options.optical_depths),
        "ambient": options.ambient,
        "transfer": options.transfer,
        "air_refinements": options.air_refinements,
        "coarse_air": options.coarse_air,
        "search_pixels": options.search_pixels,
        "loss": options.loss,
        "optimiser": options.optimiser,
        "optimiser_settings": repr(OPTIMISERS.get(options.optimiser)),
        "evaluations": options.evaluations,
        "search_seconds": options.seconds,
        "candidates": options.candidates,
        "searches": options.searches,
        "seed": options.seed,
    }


def library_versions() -> dict[str, str]:
    """Versions of everything that computes."""
    return {
        "cloudfit": __version__,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "python": platform.python_version(),
    }


def peak_memory_mb() -> float | None:
    """Largest memory that this process has used so far [MiB]; None where the system does not tell."""
    if resource is None:
        return None
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used / (1 << 20) if sys.platform == "darwin" else used / 1024


def place_in_range(parameter: Parameter | Mapping[str, Any], value: float) -> float:
    """Where a value lies in its range, 0 at the lower end and 1 at the upper one, on the parameter's own scale."""
    record = asdict(parameter) if isinstance(parameter, Parameter) else parameter
    lower, upper = float(record["lower"]), float(record["upper"])
    if record["scale"] == "log":
        return math.log(max(value, lower) / lower) / math.log(upper / lower)
    return (value - lower) / (upper - lower)


def _common(circumstances: Circumstances, status: str) -> dict[str, Any]:
    question = circumstances.question
    return {
        "schema": SCHEMA,
        "status": status,
        "reason": None,
        "interrupted": False,
        "fingerprint": question.fingerprint(),
        "photograph": {
            "file": circumstances.photograph.name,
            "path": str(circumstances.photograph.resolve()),
            "sha256": question.photograph_sha256,
        },
        "mask": {
            "file": None if circumstances.mask is None else circumstances.mask.name,
            "sha256": question.mask_sha256,
        },
        "scene": describe_scene(question.scene),
        "options": describe_options(question.options),
        "seconds": dict(circumstances.seconds),
        "peak_memory_mb": peak_memory_mb(),
        "versions": library_versions(),
        "warnings": [],
        "files": {},
    }


def _describe_candidate(
    rank: int, candidate: Candidate, fit: PhotographFit, space: SearchSpace, options: FitOptions
) -> dict[str, Any]:
    parameters = {p.name: _describe_parameter(p, candidate.parameters[p.name]) for p in space.parameters}
    values = candidate.parameters
    sunlight = fit.analysis.sunlight
    fixed = {"sun": sunlight.colour, "sky": sunlight.ambient_sky_colour}.get(options.ambient)
    colour = [values[f"ambient_{name}"] for name in ("red", "green", "blue")] if fixed is None else fixed.tolist()
    return {
        "rank": rank,
        "parameters": parameters,
        "ambient_light_per_m": values["ambient"] * values["extinction"],
        "ambient_colour": colour,
        "air_depth": list(candidate.air_depth),
        "promised_loss": finite_or_none(candidate.promised_loss),
        "loss": finite_or_none(candidate.loss),
        "floor": finite_or_none(candidate.floor),
        "near_floor": candidate.floor > 0.0 and candidate.loss <= NEAR_FLOOR * candidate.floor,
        "wasserstein_levels": finite_or_none(candidate.wasserstein),
        "image_error": finite_or_none(candidate.picture.image_error),
        "picture_seconds": candidate.picture.seconds,
        "picture": picture_name(rank),
    }


def _describe_determination(determination: Determination, space: SearchSpace) -> dict[str, Any]:
    return {
        "answers": determination.answers,
        "excess": determination.excess,
        "parameters": {
            spread.name: {
                "determined": spread.is_determined,
                "lowest": spread.lowest,
                "highest": spread.highest,
                "unit": parameter.unit,
                "share": spread.share,
                "places": [
                    min(1.0, max(0.0, place_in_range(parameter, value))) for value in (spread.lowest, spread.highest)
                ],
            }
            for parameter, spread in zip(space.parameters, determination.parameters, strict=True)
        },
    }


def _describe_parameter(parameter: Parameter, value: float) -> dict[str, Any]:
    place = place_in_range(parameter, value)
    return {
        "value": value,
        "unit": parameter.unit,
        "symbol": parameter.symbol,
        "lower": parameter.lower,
        "upper": parameter.upper,
        "scale": parameter.scale,
        "place": min(1.0, max(0.0, place)),
        "bound": "lower" if place < BOUND_MARGIN else "upper" if place > 1.0 - BOUND_MARGIN else None,
    }


def picture_name(rank: int) -> str:
    """File of a candidate's picture."""
    return "best.png" if rank == 1 else f"candidate_{rank}.png"
