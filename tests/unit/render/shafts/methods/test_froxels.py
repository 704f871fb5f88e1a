from dataclasses import replace

import pytest
import torch

from render.errors import ParameterError
from render.shafts.march import ShadowLooks
from render.shafts.methods import BruteForce, Froxels
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_cells_as_fine_as_a_march_are_the_march() -> None:
    """Without surfaces all rays are equally long, so that froxels and steps end at the same places."""
    scene = small_scene(meshes=())
    stage = small_stage(replace(scene, camera=replace(scene.camera, field_of_view=0.01)))
    exact = BruteForce(200).gather(stage).in_scattering
    fine = Froxels(200, 1, 1.0, 0.0, ShadowLooks()).gather(stage).in_scattering
    assert relative_rms(fine, exact) < 1e-4
    assert relative_rms(Froxels(10, 1, 1.0, 0.0).gather(stage).in_scattering, exact) > 1e-3


def test_cells_converge_to_brute_force_behind_surfaces_too() -> None:
    stage = small_stage()
    exact = BruteForce(2048).gather(stage).in_scattering
    errors = [
        relative_rms(Froxels(n, 1, 1.0, 0.0, ShadowLooks(4)).gather(stage).in_scattering, exact) for n in (32, 128, 512)
    ]
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]
    assert errors[2] < 3e-3


def test_cells_gather_around_lamps() -> None:
    stage = small_stage(small_scene(48, 32))
    exact = BruteForce(1024).gather(stage).in_scattering
    lamps_only = replace(stage, lighting=replace(stage.lighting, sun=None))
    alone = BruteForce(1024).gather(lamps_only).in_scattering
    gathered, even = (Froxels(48, 1, 4.0, g).gather(lamps_only).in_scattering for g in (0.05, 0.0))
    assert relative_rms(gathered, alone) < 0.7 * relative_rms(even, alone)
    assert relative_rms(Froxels().gather(stage).in_scattering, exact) < 0.2
    lengths = Froxels(40).edges(100.0, (30.0,)).diff()
    assert float(lengths.min()) > 0.0
    places = Froxels(40).edges(100.0, (30.0,))
    assert abs(float(places[int(lengths.argmin())]) - 30.0) < 3.0
    assert (float(places[0]), float(places[-1])) == (0.0, 100.0)


def test_lengths_grow_by_a_constant_factor_without_lamps() -> None:
    lengths = Froxels(8, growth=4.0).edges(100.0).double().diff()
    ratios = lengths[1:] / lengths[:-1]
    torch.testing.assert_close(ratios, ratios[:1].expand_as(ratios), rtol=2e-3, atol=0.0)
    torch.testing.assert_close(ratios.prod() * ratios[0], torch.tensor(4.0, dtype=torch.float64), rtol=1e-2, atol=0.0)
    even = Froxels(8, growth=1.0).edges(100.0).diff()
    torch.testing.assert_close(even, torch.full((8,), 12.5))


def test_numbers_without_meaning_are_refused() -> None:
    for wrong in ({"cells": 0}, {"factor": 0}, {"growth": 0.5}, {"gathering": -1.0}):
        with pytest.raises(ParameterError):
            replace(Froxels(), **wrong)
    assert Froxels(10, 6).refined() == Froxels(20, 4)
