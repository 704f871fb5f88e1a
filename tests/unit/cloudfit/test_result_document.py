import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cloudfit.fit_types import FitOptions
from cloudfit.parameters import Parameter
from cloudfit.photograph import read_photograph
from cloudfit.quality import QUALITIES, Quality
from cloudfit.result_document import (
    Circumstances,
    describe_fit,
    describe_options,
    describe_reason,
    library_versions,
    peak_memory_mb,
    picture_name,
    place_in_range,
)
from tests.support.hand_made_fit import (
    SECONDS,
    make_analysis,
    make_circumstances,
    make_fit,
    make_question,
    make_space,
    write_photograph,
)


def test_a_fit_is_described_with_units_and_ranges(tmp_path: Path) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    document = describe_fit(fit, make_space(), make_circumstances(photograph))
    assert json.loads(json.dumps(document)) == document
    assert document["status"] == "done"
    assert document["photograph"]["file"] == "photo.png"
    assert (document["photograph"]["width"], document["photograph"]["height"]) == (8, 6)
    assert document["mask"]["cloud_pixels"] == 12
    assert document["seconds"] == SECONDS
    assert document["scene"]["sun_azimuth_deg"] == pytest.approx(220.0)
    best, second = document["candidates"]
    assert (best["rank"], second["rank"]) == (1, 2)
    assert best["parameters"]["extinction"]["unit"] == "1/m"
    assert best["ambient_light_per_m"] == pytest.approx(0.5 * 0.2)
    assert best["parameters"]["albedo"]["bound"] == "upper"
    assert best["parameters"]["ambient"]["bound"] is None
    assert best["near_floor"] is False
    assert best["air_depth"] == [0.0, 0.3, 0.6]


def test_a_loss_close_to_the_floor_is_called_so(tmp_path: Path) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)), losses=(0.44, 0.46))  # the floor is 0.3
    best, second = describe_fit(fit, make_space(), make_circumstances(photograph))["candidates"]
    assert best["near_floor"] is True
    assert second["near_floor"] is False


@pytest.mark.parametrize(("ambient", "colour"), [("sun", [1.0, 0.9, 0.8]), ("sky", [0.3, 0.6, 1.0])])
def test_the_colour_of_the_ambient_light_is_that_of_the_choice(
    tmp_path: Path, ambient: str, colour: list[float]
) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    circumstances = Circumstances(photograph, None, make_question(ambient=ambient), SECONDS)
    best = describe_fit(fit, make_space(), circumstances)["candidates"][0]
    assert best["ambient_colour"] == pytest.approx(colour)


def test_a_free_ambient_colour_is_the_fitted_one(tmp_path: Path) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)), losses=(0.5,))
    fit = replace(fit, determination=None)
    fit.candidates[0].parameters.update(ambient_red=0.1, ambient_green=0.2, ambient_blue=0.3)
    circumstances = Circumstances(photograph, None, make_question(ambient="free"), SECONDS)
    best = describe_fit(fit, make_space("free"), circumstances)["candidates"][0]
    assert best["ambient_colour"] == [0.1, 0.2, 0.3]
    assert "ambient_red" in best["parameters"]


def test_what_is_determined_is_described_with_its_range(tmp_path: Path) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    described = describe_fit(fit, make_space(), make_circumstances(photograph))["determination"]
    assert (described["answers"], described["excess"]) == (42, 0.06)
    assert list(described["parameters"]) == list(make_space().names)
    extinction, asymmetry = described["parameters"]["extinction"], described["parameters"]["asymmetry"]
    assert (extinction["determined"], asymmetry["determined"]) == (True, False)
    assert (extinction["lowest"], extinction["highest"], extinction["unit"]) == (0.19, 0.21, "1/m")
    assert asymmetry["places"] == pytest.approx([0.1 / 0.9, 0.7 / 0.9])
    interrupted = make_fit(make_analysis(read_photograph(photograph)), interrupted=True)
    assert describe_fit(interrupted, make_space(), make_circumstances(photograph))["determination"] is None


def test_no_floor_is_not_near(tmp_path: Path) -> None:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)), losses=(0.0,))
    paired = replace(fit, candidates=(replace(fit.candidates[0], floor=0.0),))
    assert describe_fit(fit, make_space(), make_circumstances(photograph))["candidates"][0]["near_floor"] is True
    assert describe_fit(paired, make_space(), make_circumstances(photograph))["candidates"][0]["near_floor"] is False


def test_a_reason_is_described_without_a_fit(tmp_path: Path) -> None:
    document = describe_reason("failed", "it is empty", make_circumstances(tmp_path / "photo.png"))
    assert (document["status"], document["reason"]) == ("failed", "it is empty")
    assert "candidates" not in document


def test_a_preset_has_its_name_and_another_quality_none() -> None:
    assert describe_options(FitOptions(quality=QUALITIES["draft"]))["quality"] == "draft"
    draft = QUALITIES["draft"]
    custom = Quality(0.3, draft.table_effort, draft.picture_effort, 7, 0.6, 0.25)
    assert describe_options(FitOptions(quality=custom))["quality"] == "custom"


def test_the_search_of_the_air_is_recorded() -> None:
    assert describe_options(FitOptions(air_refinements=0))["air_refinements"] == 0
    assert describe_options(FitOptions())["air_refinements"] == FitOptions().air_refinements > 0


def test_the_loss_is_recorded() -> None:
    assert describe_options(FitOptions())["loss"] == "l1"
    assert describe_options(FitOptions(loss="soft_l1", coarse_air=True)) | {"loss": "l1", "coarse_air": False} == (
        describe_options(FitOptions())
    )


def test_places_follow_the_scale_of_the_parameter() -> None:
    linear = Parameter("albedo", "beta", "1", 0.0, 2.0)
    log = Parameter("extinction", "sigma_t", "1/m", 0.01, 1.0, "log")
    assert place_in_range(linear, 0.5) == 0.25
    assert place_in_range(log, 0.1) == pytest.approx(0.5)
    assert place_in_range(linear, 0.1) != pytest.approx(0.5)
    assert [place_in_range(log, value) for value in (0.01, 1.0)] == pytest.approx([0.0, 1.0])


def test_versions_and_memory_are_those_of_this_process() -> None:
    assert library_versions()["torch"] == torch.__version__
    memory = peak_memory_mb()
    assert memory is None or 20 < memory < 1e6


def test_pictures_are_named_by_rank() -> None:
    assert [picture_name(rank) for rank in (1, 2, 3)] == ["best.png", "candidate_2.png", "candidate_3.png"]
