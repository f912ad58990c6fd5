"""Distributions of toleranced numbers, and the accuracy grades of the standards."""

import numpy as np
import pytest
from scipy import stats

import gearjax as gj
from gearjax.tolerance import DISTRIBUTIONS
from gearjax.tolerance.grades import it_tolerance, run_out_tolerance, single_pitch_tolerance, total_pitch_tolerance

SHARES = np.array([1e-12, 1e-4, 0.05, 0.3, 0.5, 0.77, 0.95, 1 - 1e-4, 1 - 1e-12])
KNOWN = [
    (gj.Normal(2.0, 0.5), stats.norm(2.0, 0.5)),
    (gj.TruncatedNormal(0.0, 1.0, -0.5, 2.0), stats.truncnorm(-0.5, 2.0)),
    (gj.TruncatedNormal(0.0, 1.0, 5.0, 7.0), stats.truncnorm(5.0, 7.0)),
    (gj.TruncatedNormal(1.0, 2.0, -13.0, -8.0), stats.truncnorm(-7.0, -4.5, 1.0, 2.0)),
    (gj.Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    (gj.UniformPhase(), stats.uniform(-np.pi, 2 * np.pi)),
    (gj.Rayleigh(6e-6), stats.rayleigh(0.0, 6e-6)),
    (gj.Lognormal(2.0, 0.3), stats.lognorm(0.3, 0.0, 2.0)),
]


@pytest.mark.parametrize(("ours", "known"), KNOWN, ids=lambda part: getattr(part, "kind", ""))
def test_quantiles_and_moments_are_those_of_scipy(ours, known):
    np.testing.assert_allclose(ours.quantile(SHARES), known.ppf(SHARES), rtol=1e-7, atol=1e-12 * known.std())
    assert ours.deviation == pytest.approx(known.std(), rel=1e-9)
    assert ours.expected == pytest.approx(known.mean(), rel=1e-9, abs=1e-12)


def test_discrete_values_come_with_their_probabilities():
    spread = gj.Discrete((5.0, 1.0, 2.0), (0.5, 0.2, 0.3))
    shares = (np.arange(1000) + 0.5) / 1000
    values, counts = np.unique(spread.quantile(shares), return_counts=True)
    assert values.tolist() == [1.0, 2.0, 5.0]
    assert counts.tolist() == [200, 300, 500]
    assert spread.expected == pytest.approx(3.3)
    assert spread.deviation == pytest.approx(np.sqrt(0.2 * 1 + 0.3 * 4 + 0.5 * 25 - 3.3**2))
    assert gj.Discrete((1.0, 2.0)).quantile(np.array([0.2, 0.8])).tolist() == [1.0, 2.0]


def test_measured_values_are_drawn_as_often_as_each_other():
    spread = gj.Empirical((3.0, 1.0, 7.0, 5.0))
    assert spread.quantile(np.array([0.1, 0.3, 0.6, 0.99, 1.0])).tolist() == [1.0, 3.0, 5.0, 7.0, 7.0]
    assert (spread.expected, spread.deviation) == (4.0, pytest.approx(np.std([1, 3, 5, 7])))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gj.Normal(0.0, -1.0), "std"),
        (lambda: gj.Normal(float("nan"), 1.0), "mean"),
        (lambda: gj.Uniform(2.0, 1.0), "high"),
        (lambda: gj.TruncatedNormal(0.0, 1.0, 2.0, 1.0), "high"),
        (lambda: gj.TruncatedNormal(0.0, 1.0, 20.0, 21.0), "mean"),
        (lambda: gj.Discrete((1.0, 2.0), (0.5, 0.6)), "must add to 1"),
        (lambda: gj.Discrete((1.0, 2.0), (1.0,)), "one per value"),
        (lambda: gj.Empirical(()), "at least one"),
        (lambda: gj.Lognormal(0.0, 1.0), "median"),
        (lambda: gj.Iso1328RunOut(5, 2.5, 125e-3), "module"),
        (lambda: gj.Iso286(0.0, 4, 50e-3), "grade"),
    ],
)
def test_impossible_distributions_are_refused(make, words):
    with pytest.raises(gj.ParameterError, match=words):
        make()


def test_every_distribution_has_its_own_kind():
    kinds = [kind.kind for kind in DISTRIBUTIONS]
    assert len(set(kinds)) == len(kinds)


# ISO 1328-1:1995, tables 1 and 2, and ISO 1328-2:1997, table B.1: grades 5 to 8 [um] for sizes up to (d, m) [mm]
PRINTED = {
    single_pitch_tolerance: {
        (20, 2): (4.7, 6.5, 9.5, 13),
        (20, 3.5): (5, 7.5, 10, 15),
        (50, 2): (5, 7, 10, 14),
        (50, 3.5): (5.5, 7.5, 11, 15),
        (50, 6): (6, 8.5, 12, 17),
        (50, 10): (7, 10, 14, 20),
        (125, 2): (5.5, 7.5, 11, 15),
        (125, 3.5): (6, 8.5, 12, 17),
        (125, 6): (6.5, 9, 13, 18),
        (125, 10): (7.5, 10, 15, 21),
        (280, 2): (6, 8.5, 12, 17),
        (280, 3.5): (6.5, 9, 13, 18),
        (280, 10): (8, 11, 16, 23),
    },
    total_pitch_tolerance: {
        (20, 2): (11, 16, 23, 32),
        (50, 2): (14, 20, 29, 41),
        (50, 3.5): (15, 21, 30, 42),
        (125, 2): (18, 26, 37, 52),
        (125, 3.5): (19, 27, 38, 53),
        (125, 10): (20, 29, 41, 58),
        (280, 3.5): (25, 35, 50, 70),
        (280, 6): (25, 36, 51, 72),
    },
    run_out_tolerance: {
        (20, 2): (9, 13, 18, 25),
        (20, 3.5): (9.5, 13, 19, 27),
        (50, 3.5): (12, 17, 24, 34),
        (125, 3.5): (15, 21, 30, 43),
        (125, 6): (16, 22, 31, 44),
        (280, 3.5): (20, 28, 40, 56),
    },
}


@pytest.mark.parametrize("tolerance", PRINTED, ids=lambda function: function.__name__)
def test_limits_of_gears_are_the_printed_ones(tolerance):
    for (diameter, module), row in PRINTED[tolerance].items():
        for grade, printed in zip((5, 6, 7, 8), row, strict=True):
            found = tolerance(grade, module * 1e-3, diameter * 1e-3, "1995")
            assert found / 1e-6 == pytest.approx(printed), (diameter, module, grade)


def test_limits_of_the_edition_of_2013_follow_its_formulas():
    # m = 3 mm, d = 120 mm, class 6: 8.94, 31.8 and 28.6 um, rounded
    assert single_pitch_tolerance(6, 3e-3, 120e-3) == pytest.approx(9e-6)
    assert total_pitch_tolerance(6, 3e-3, 120e-3) == pytest.approx(29e-6)
    assert run_out_tolerance(6, 3e-3, 120e-3) == pytest.approx(26e-6)


def test_limits_of_sizes_are_the_printed_ones():
    # ISO 286-1:2010, table 1
    for size, printed in {3: (4, 6, 10, 14), 30: (9, 13, 21, 33), 31: (11, 16, 25, 39), 500: (27, 40, 63, 97)}.items():
        assert [it_tolerance(grade, size * 1e-3) / 1e-6 for grade in (5, 6, 7, 8)] == pytest.approx(printed)
    assert it_tolerance(14, 100e-3) == pytest.approx(870e-6)


def test_sizes_follow_the_law_behind_the_table():
    steps = {6: 10, 7: 16, 8: 25, 9: 40, 10: 64, 11: 100}
    for low, high in ((30, 50), (80, 120), (180, 250), (315, 400)):
        middle = np.sqrt(low * high)
        unit = 0.45 * middle ** (1 / 3) + 0.001 * middle
        for grade, multiple in steps.items():
            assert it_tolerance(grade, high * 1e-3) / 1e-6 == pytest.approx(multiple * unit, rel=0.035)


@pytest.mark.parametrize("given", [(0, 2e-3, 50e-3), (12, 2e-3, 50e-3), (6, 2.0, 50e-3), (6, 2e-3, 20.0)])
def test_sizes_outside_of_the_standard_are_refused(given):
    with pytest.raises(gj.ParameterError):
        single_pitch_tolerance(*given)
    with pytest.raises(gj.ParameterError):
        it_tolerance(6, 4.0)


def test_graded_run_out_holds_its_limit_in_997_of_1000():
    spread = gj.Iso1328RunOut(5, 2.5e-3, 125e-3)
    assert spread.quantile(np.array(0.9973)) == pytest.approx(0.5 * run_out_tolerance(5, 2.5e-3, 125e-3))
    assert gj.Iso286(1e-4, 7, 50e-3).deviation == pytest.approx(25e-6 / 6)


def test_a_tolerance_in_the_middle_is_rounded_up():
    """Exactly 4.15 um by the formula, a little less in binary numbers."""
    assert gj.flank_tolerance("f_f_alpha", 3, 6e-3, 0.1157, 0.075) * 1e6 == pytest.approx(4.2, abs=1e-9)


def test_moments_of_a_normal_distribution_between_close_limits_are_those_of_a_uniform_one():
    for mean, std, low, high in ((0.15e-3, 0.1, 0.149e-3, 0.151e-3), (0.0, 1e9, 2.0, 3.0), (5.0, 1e3, 5.0, 6.0)):
        one = gj.TruncatedNormal(mean, std, low, high)
        assert one.expected == pytest.approx(0.5 * (low + high), rel=1e-5)
        assert one.deviation == pytest.approx((high - low) / 12**0.5, rel=1e-5)


@pytest.mark.parametrize("ends", [(-8.0, 0.5), (7.9, 30.0), (-1e5, 1e5), (-3.0, 1e6), (-9.0, -7.5)])
def test_moments_of_truncated_normals_are_those_of_an_integral(ends):
    one = gj.TruncatedNormal(0.0, 1.0, *ends)
    near = max(ends[0], min(ends[1], 0.0))  # the most frequent value
    x = near + np.linspace(max(ends[0] - near, -12.0), min(ends[1] - near, 12.0), 2_000_001)
    weights = np.exp(0.5 * (near**2 - x**2))
    weights /= weights.sum()
    mean = (weights * x).sum()
    assert one.expected == pytest.approx(mean, rel=1e-5, abs=1e-6)
    assert one.deviation == pytest.approx(np.sqrt((weights * (x - mean) ** 2).sum()), rel=1e-4)
