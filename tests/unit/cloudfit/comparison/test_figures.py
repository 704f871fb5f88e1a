import xml.etree.ElementTree as ElementTree

from cloudfit.comparison.analysis import Analysis
from cloudfit.comparison.figures import COLOURS, DRAWN_STRONGLY, figures, runtime_figure
from cloudfit.plots import FAINT, INK
from tests.support.comparison import facts, make_run


def analysis(methods: int, loss: float = 1.0) -> Analysis:
    runs = [
        make_run(f"method {n}", seed=seed, steps=((1, 0.1, 2.0 + n), (5 + n, 0.2, loss + 0.1 * n)))
        for n in range(methods)
        for seed in range(2)
    ]
    return Analysis.of_runs(runs, [facts()], [f"method {n}" for n in range(methods)], 100, None)


def test_every_figure_can_stand_in_a_page() -> None:
    drawn = figures(analysis(3))
    assert len(drawn) == 6
    for svg in drawn.values():
        root = ElementTree.fromstring(svg.replace("xlink:href", "href"))
        assert root.tag.endswith("svg")
        assert INK not in svg
        assert FAINT not in svg
        assert "method 0</text>" in svg


def test_of_many_methods_the_best_are_named() -> None:
    svg = runtime_figure(analysis(DRAWN_STRONGLY + 3), by_seconds=False)
    named = [n for n in range(DRAWN_STRONGLY + 3) if f"method {n}</text>" in svg]
    assert named == list(range(DRAWN_STRONGLY))


def test_a_method_has_the_same_colour_whatever_its_rank() -> None:
    # "late" is ahead in evaluations, "soon" in seconds.
    runs = [
        make_run("soon", steps=((1, 0.1, 9.0), (60, 0.2, 1.0))),
        make_run("late", steps=((1, 0.1, 9.0), (2, 9.0, 1.0))),
    ]
    compared = Analysis.of_runs(runs, [facts()], ["soon", "late"], 100, None)
    assert compared.ranking(False) == compared.ranking(True)[::-1] == ["late", "soon"]
    for by_seconds, order in ((False, (1, 0)), (True, (0, 1))):
        svg = runtime_figure(compared, by_seconds)
        places = [svg.index(COLOURS[number]) for number in order]
        assert places == sorted(places), "drawn in the order of the ranking, each in its own colour"


def test_equal_runs_give_equal_bytes_and_other_runs_do_not() -> None:
    assert runtime_figure(analysis(2), False) == runtime_figure(analysis(2), False)
    assert runtime_figure(analysis(2), False) != runtime_figure(analysis(2, loss=0.5), False)


def test_runs_that_reach_nothing_can_be_drawn() -> None:
    runs = [make_run("a", steps=((1, 0.0, 1.0),), evaluations=1, seconds=0.0), make_run("b", steps=(), evaluations=0)]
    assert len(figures(Analysis.of_runs(runs, [facts()], ["a", "b"], 2, None))) == 6
