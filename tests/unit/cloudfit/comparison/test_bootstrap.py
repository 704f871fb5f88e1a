import numpy as np
import pytest

from cloudfit.comparison.bootstrap import compare_pairs, holm, sign_flip_test


def test_the_sign_flips_can_be_counted() -> None:
    # Of the eight patterns of 1, 2, 3 only +++ and --- have a mean of 2 or more in modulus.
    assert sign_flip_test(np.array([1.0, 2.0, 3.0])) == 2 / 8
    # 3 - 1 - 2 = 0 is not as far as 3 + 1 - 2 = 2; eight patterns reach 2: all but 3 - 1 - 2 and its mirror.
    assert sign_flip_test(np.array([3.0, 1.0, -2.0])) == 6 / 8
    assert sign_flip_test(np.zeros(4)) == 1.0


def test_many_pairs_are_tested_at_random_and_never_with_a_p_value_of_zero() -> None:
    assert 0.0 < sign_flip_test(np.ones(40)) < 0.001
    alternating = np.tile([1.0, -1.0], 20)
    assert sign_flip_test(alternating) == 1.0


def test_holm_multiplies_by_the_number_of_tests_that_are_left() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_difference_of_two_methods_is_paired_by_problem() -> None:
    base = np.array([0.1, 0.9, 0.4, 0.6, 0.2, 0.7, 0.5, 0.3])
    (contrast,) = compare_pairs({"a": base + 0.05, "b": base})
    assert (contrast.first, contrast.second) == ("a", "b")
    assert contrast.difference == pytest.approx(0.05)
    assert contrast.low == pytest.approx(0.05)
    assert contrast.high == pytest.approx(0.05)
    assert contrast.wins == 1.0
    assert contrast.p_value == 2 / 256


def test_the_interval_covers_the_true_difference_about_as_often_as_it_says() -> None:
    generator = np.random.default_rng(5)
    covered = 0
    for _ in range(300):
        values = generator.normal(0.3, 1.0, 30)
        (contrast,) = compare_pairs({"a": values, "b": np.zeros(30)}, resamples=500)
        covered += contrast.low <= 0.3 <= contrast.high
    # 95 % nominal, a little less for 30 problems; 300 trials have a standard deviation of 1.3 %.
    assert 0.89 < covered / 300 < 0.985


def test_equal_seeds_give_equal_intervals_and_one_method_gives_none() -> None:
    values = dict(zip("abc", np.random.default_rng(0).random((3, 7)), strict=True))
    assert compare_pairs(values, seed=1) == compare_pairs(values, seed=1)
    assert compare_pairs(values, seed=1) != compare_pairs(values, seed=2)
    assert [(c.first, c.second) for c in compare_pairs(values)] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert compare_pairs({"a": np.ones(3)}) == []
