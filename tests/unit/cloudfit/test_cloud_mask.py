import cv2
import numpy as np
import pytest
import torch

from cloudfit.cloud_mask import CloudMask, Label, apply_user_mask, detect_clouds, read_user_mask
from cloudfit.photograph import read_photograph
from render.errors import InputError
from render.image_files import write_mask_png
from tests.support.shared_data import shared_file
from tests.support.sky_scenes import clear_scene, cloudy_scene

LABELLED = ("cumulus_kloofendal_a", "cumulus_meadow_negx", "cumulus_noon_02", "cumulus_picos", "sunset_beach")
CLEAR = ("neg_desert_clear", "neg_dusk_rocket")


def labels_by_hand(name: str, size: tuple[int, int]) -> np.ndarray:
    drawn = cv2.imread(str(shared_file(f"masks/{name}_sparse.png")), cv2.IMREAD_UNCHANGED)
    return cv2.resize(drawn, (size[1], size[0]), interpolation=cv2.INTER_NEAREST)


def found_and_drawn(name: str) -> tuple[np.ndarray, np.ndarray]:
    pixels = read_photograph(shared_file(f"photos/{name}.jpg")).pixels
    return detect_clouds(pixels).cloud.numpy(), labels_by_hand(name, tuple(pixels.shape[:2]))


def balanced_accuracy(cloud: np.ndarray, drawn: np.ndarray) -> float:
    return float(cloud[drawn == Label.CLOUD].mean() + (~cloud)[drawn == Label.SKY].mean()) / 2.0


def test_balanced_accuracy_on_the_labelled_photographs():
    scores = {name: balanced_accuracy(*found_and_drawn(name)) for name in LABELLED}
    assert np.mean(list(scores.values())) >= 0.97, scores
    assert min(scores.values()) >= 0.95, scores


def test_the_labels_tell_a_good_mask_from_a_bad_one():
    # Chroma alone, as in the paper: it takes the glow of a sunset for cloud and its dark clouds for sky.
    pixels = read_photograph(shared_file("photos/sunset_beach.jpg")).pixels
    chroma = (pixels.amax(dim=2) - pixels.amin(dim=2)) / pixels.amax(dim=2).clamp(min=1e-3)
    drawn = labels_by_hand("sunset_beach", tuple(pixels.shape[:2]))
    assert balanced_accuracy((chroma < 0.5).numpy(), drawn) < 0.8


def test_landscape_is_not_cloud():
    shares = {}
    for name in (*LABELLED, *CLEAR):
        cloud, drawn = found_and_drawn(name)
        if (drawn == Label.OTHER).any():
            shares[name] = float(cloud[drawn == Label.OTHER].mean())
    assert max(shares.values()) <= 0.05, shares


@pytest.mark.parametrize("change", ["mirror", "brighter", "darker", "crop", "warmer", "cooler"])
def test_a_changed_photograph_keeps_its_clouds(change):
    changes = {
        "mirror": lambda p: p.flip(1),
        "brighter": lambda p: (p * 2**0.5).clamp(max=1.0),
        "darker": lambda p: p * 2**-0.5,
        "crop": lambda p: p[: int(0.9 * p.shape[0]), int(0.15 * p.shape[1]) :],
        "warmer": lambda p: (p * torch.tensor([1.08, 1.0, 0.93])).clamp(max=1.0),
        "cooler": lambda p: (p * torch.tensor([0.93, 1.0, 1.08])).clamp(max=1.0),
    }
    for name in ("cumulus_picos", "sunset_beach"):
        pixels = read_photograph(shared_file(f"photos/{name}.jpg"), max_side=800).pixels
        drawn = torch.from_numpy(labels_by_hand(name, tuple(pixels.shape[:2]))).expand(3, -1, -1).permute(1, 2, 0)
        if change in ("mirror", "crop"):
            drawn = changes[change](drawn)
        cloud = detect_clouds(changes[change](pixels).contiguous()).cloud.numpy()
        assert balanced_accuracy(cloud, drawn[..., 0].numpy()) >= 0.93, name


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("storm_over_sea.jpg", 0.9, 1.0),
        ("overcast_city_potsdam.jpg", 0.9, 1.0),
        ("altocumulus_evening_a.jpg", 0.6, 0.95),
        ("dusk_thin_clouds_lake.jpg", 0.1, 0.4),
        ("cirrus_colosseum.jpg", 0.3, 0.7),
        ("kloofendal_48d_partly_cloudy_puresky_1k.hdr", 0.3, 0.8),
        ("the_sky_is_on_fire_1k.hdr", 0.15, 1.0),
    ],
)
def test_clouds_are_found_in_every_kind_of_sky(name, least, most):
    mask = detect_clouds(read_photograph(shared_file(f"photos/{name}")).pixels)
    assert least <= mask.cloud_fraction <= most


def test_a_made_up_scene():
    pixels, cloud, ground = cloudy_scene()
    mask = detect_clouds(pixels)
    assert mask.source == "automatic"
    assert mask.cloud[cloud].double().mean() > 0.95
    assert mask.cloud[~cloud & ~ground].double().mean() < 0.05
    assert mask.other[ground].double().mean() > 0.95
    assert (mask.cloud.int() + mask.sky.int() + mask.other.int() == 1).all()


@pytest.mark.parametrize(
    ("pixels", "fraction"),
    [
        (clear_scene(), 0.0),
        (torch.zeros(40, 60, 3), 0.0),
        (torch.ones(40, 60, 3), 1.0),
        (torch.full((40, 60, 3), 0.2), 1.0),
        (torch.tensor([0.1, 0.2, 0.6]).expand(40, 60, 3), 0.0),
        (torch.ones(1, 1, 3), 1.0),
        (torch.tensor([0.1, 0.2, 0.6]).expand(1, 1, 3), 0.0),
        (torch.ones(1, 50, 3), 1.0),
        (torch.ones(50, 1, 3), 1.0),
    ],
)
def test_pictures_of_one_thing(pixels, fraction):
    mask = detect_clouds(pixels)
    assert mask.labels.dtype == torch.uint8
    assert mask.labels.shape == pixels.shape[:2]
    assert mask.cloud_fraction == pytest.approx(fraction, abs=0.01)


def test_light_far_above_white_does_no_harm():
    pixels, cloud, _ = cloudy_scene()
    pixels = pixels.clone()
    pixels[30:34, 30:34] = 6e4
    assert detect_clouds(pixels).cloud[cloud].double().mean() > 0.95


def automatic() -> CloudMask:
    return CloudMask(torch.tensor([[Label.CLOUD, Label.SKY, Label.OTHER, Label.CLOUD]], dtype=torch.uint8))


def test_the_fraction_counts_the_sky_alone():
    assert automatic().cloud_fraction == pytest.approx(2 / 3)
    assert CloudMask(torch.full((2, 2), Label.OTHER, dtype=torch.uint8)).cloud_fraction == 0.0


def test_a_plain_mask_decides_every_cloud(tmp_path):
    write_mask_png(tmp_path / "mask.png", np.array([[0, 255, 0, 255]], np.uint8))
    mask = apply_user_mask(automatic(), read_user_mask(tmp_path / "mask.png", (1, 4)))
    # A cloud that the user denies is sky; landscape stays landscape.
    assert mask.labels.tolist() == [[Label.SKY, Label.CLOUD, Label.OTHER, Label.CLOUD]]
    assert mask.source == "user"


def test_a_labelled_mask_corrects_where_it_is_not_automatic(tmp_path):
    write_mask_png(tmp_path / "mask.png", np.array([[0, 85, 170, 0]], np.uint8))
    mask = apply_user_mask(automatic(), read_user_mask(tmp_path / "mask.png", (1, 4)))
    assert mask.labels.tolist() == [[Label.CLOUD, Label.OTHER, Label.SKY, Label.CLOUD]]
    assert mask.source == "corrected"


def test_a_mask_is_brought_to_the_size_of_the_photograph(tmp_path):
    write_mask_png(tmp_path / "mask.png", np.array([[85, 255], [170, 255]], np.uint8))
    labels = read_user_mask(tmp_path / "mask.png", (4, 4))
    assert labels.tolist() == [[85, 85, 255, 255]] * 2 + [[170, 170, 255, 255]] * 2


def test_masks_of_other_levels_or_shapes_are_refused(tmp_path):
    write_mask_png(tmp_path / "grey.png", np.array([[0, 128, 255]], np.uint8))
    with pytest.raises(InputError, match=r"grey\.png: expected the grey levels .* got 128"):
        read_user_mask(tmp_path / "grey.png", (1, 3))
    write_mask_png(tmp_path / "tall.png", np.zeros((200, 100), np.uint8))
    with pytest.raises(InputError, match="shape of the photograph"):
        read_user_mask(tmp_path / "tall.png", (100, 200))
    with pytest.raises(InputError, match="no such file"):
        read_user_mask(tmp_path / "gone.png", (1, 3))
    with pytest.raises(ValueError, match="shape"):
        apply_user_mask(automatic(), torch.zeros(2, 2, dtype=torch.uint8))
