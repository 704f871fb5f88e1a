from render.shafts.epipolar_sampling import EpipolarSettings
from render.shafts.methods import BruteForce, Engelhardt2010
from render.shafts.methods.engelhardt2010 import refine_lines
from tests.support.shaft_scenes import relative_rms, small_scene, small_stage


def test_dense_lines_come_near_to_every_pixel() -> None:
    stage = small_stage(small_scene(48, 32))
    exact = BruteForce(64).gather(stage).in_scattering
    dense = Engelhardt2010(64, EpipolarSettings(0.5, 0.5, 1, 0.02)).gather(stage)
    sparse = Engelhardt2010(64, EpipolarSettings(12.0, 1.0, 32, 0.5)).gather(stage)
    assert relative_rms(dense.in_scattering, exact) < 0.02
    assert relative_rms(sparse.in_scattering, exact) > 2.0 * relative_rms(dense.in_scattering, exact)
    assert set(sparse.seconds) == {"epipolar lines", "marching", "interpolation"}


def test_refined_lines_are_twice_as_dense() -> None:
    lines = refine_lines(EpipolarSettings(2.0, 1.0, 16, 0.1))
    assert (lines.line_gap, lines.stride, lines.depth_tolerance) == (1.0, 8, 0.05)
    assert refine_lines(EpipolarSettings(stride=1)).stride == 1
