import json
from pathlib import Path

import pytest
import torch

from cloudfit.commands.info import describe_file, info
from cloudfit.photograph import read_photograph
from cloudfit.result_document import describe_fit, describe_reason
from cloudfit.result_folder import write_fit, write_reason
from precompute.stack_store import save_stack
from render.density_grid import DensityGrid
from render.errors import InputError, ResultError, VolumeError
from render.volume_files import write_volume
from tests.support.fake_stages import one_pixel_tables
from tests.support.hand_made_fit import make_analysis, make_circumstances, make_fit, make_space, write_photograph


@pytest.fixture
def result(tmp_path: Path) -> Path:
    photograph = write_photograph(tmp_path / "photo.png")
    fit = make_fit(make_analysis(read_photograph(photograph)))
    write_fit(tmp_path / "photo", fit, describe_fit(fit, make_space(), make_circumstances(photograph)), "token")
    return tmp_path / "photo" / "result.json"


def test_a_volume_is_described(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    density = torch.zeros(2, 3, 4)
    density[0, 0, 0] = 0.75
    write_volume(path, DensityGrid.from_voxel_size(density, (1.0, 2.0, 3.0)))
    document = describe_file(path)
    assert document["voxels"] == [4, 3, 2]
    assert document["voxel_size_m"] == pytest.approx([1.0, 2.0, 3.0])
    assert document["largest_density"] == 0.75
    assert document["filled_voxels"] == pytest.approx(1 / 24)


def test_a_stack_is_described(tmp_path: Path) -> None:
    path = tmp_path / "stack.safetensors"
    save_stack(path, one_pixel_tables(), "f" * 64, {"seed": 3})
    document = describe_file(path)
    assert (document["kind"], document["knots"], document["cloud_pixels"]) == ("scattering stack", [2, 3, 4], 1)
    assert document["modelled"] == []
    assert document["provenance"]["seed"] == 3
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(InputError, match="cannot read the tables"):
        describe_file(path)
    with pytest.raises(InputError, match="no such file"):
        describe_file(tmp_path / "gone.safetensors")


def test_a_result_is_described_by_file_and_by_folder(result: Path) -> None:
    document = describe_file(result)
    assert document == describe_file(result.parent)
    assert (document["loss"], document["extinction_per_m"], document["albedo"]) == (0.6, 0.2, 1.0)
    assert document["candidates"] == 2


def test_a_result_without_a_fit_is_described(tmp_path: Path) -> None:
    write_reason(
        tmp_path / "x", None, describe_reason("failed", "why", make_circumstances(tmp_path / "x.jpg")), "token"
    )
    assert describe_file(tmp_path / "x")["reason"] == "why"


def test_files_of_no_known_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no such file"):
        describe_file(tmp_path)
    with pytest.raises(VolumeError, match="should end in"):
        describe_file(tmp_path / "cloud.txt")


def test_table_and_json_hold_the_same(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info(result, json=True)
    document = json.loads(capsys.readouterr().out)
    assert document["photograph"] == "photo.png"
    info(result)
    table = capsys.readouterr().out
    assert "extinction per m" in table
    assert "0.2" in table
