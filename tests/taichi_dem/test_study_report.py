"""What a study says and shows, of points made by hand."""

import dataclasses
import itertools
import math

from bobbing import bobbing
from made_studies import made_study, points, rows, said_of

from taichi_dem.settings import Settings
from taichi_dem.study_picture import picture, value
from taichi_dem.study_point import Point, cheapest, pareto, write
from taichi_dem.study_result import Study


def test_cheapest_is_one_that_surely_meets_the_target():
    found = points()
    assert cheapest(found, 1e-1) is found[0]
    assert cheapest(found, 1e-2) is found[1]
    assert cheapest(found, 1e-3) is found[3]  # the third may err by 1.2e-3
    assert cheapest(found, 1e-4) is None


def test_none_is_on_the_front_by_luck():
    found = points()
    assert pareto(found) == found
    found[2].means["other"] = (0.0, 1e-3)
    assert pareto(found) == [found[0], found[1], found[3]]
    assert found[2].bound == 2e-3


def test_sentences_name_what_meets_each_target(tmp_path):
    result = made_study(tmp_path, points(), orders={"trajectory": 1.98})
    said = said_of(result)
    assert "comparable over all 1 s" in said[0] and "1.98" in said[2]
    assert [line.partition(":")[0] for line in said[3:]] == [
        f"error {target}" for target in ("0.1", "0.01", "0.001", "0.0001")
    ]
    assert "none of the settings tried" in said[-1]
    result.sparse_order = 2.1
    assert "exchange to the next: 2.10" in said_of(result)[3]
    stopped = Point("step", Settings(1e-5), "stopped: too deep")
    said = said_of(made_study(tmp_path, [*points(), stopped], last=8))
    assert "chaotic" in said[0] and "250 ms of 1 s" in said[0] and "too deep" in said[2]


def test_errors_that_do_not_go_with_the_step_are_named(tmp_path):
    found = points()
    for point in found:
        point.errors = {"trajectory": 1e-3, "depression": 1e-3, "energy drift": 1e-15}
    said = said_of(made_study(tmp_path, found, orders={"trajectory": 1.98}))
    assert said[2] == "orders of convergence in the time step: trajectory 1.98; none of depression"
    result = made_study(tmp_path, found)
    assert said_of(result)[2].startswith("no order in the time step: nothing tells")
    result.cut_short = "interrupted"
    assert not any("order" in line for line in said_of(result))


def test_what_may_be_as_cheap_is_counted(tmp_path):
    """Where times overlap; of those that meet the error."""
    found = points()[:2]
    found[0].times, found[1].times = [1.0, 0.9, 1.2], [1.5, 1.15, 1.3]
    said = said_of(made_study(tmp_path, found))
    assert "1 s per simulated second (1 other as cheap within the scatter of rounds); " in said[2]
    assert "scatter" not in said[3]
    found[1].times = [1.5, 1.3, 1.3]
    assert "scatter" not in said_of(made_study(tmp_path, found))[2]


def test_only_measures_that_were_compared_are_named(tmp_path):
    """In a box, say, without a substrate."""
    found = points()
    found[0].errors = {"trajectory": 5e-2, "contact force": 1e-2}
    found[1].errors = {"trajectory": 2e-3}
    assert (
        "errors are those of trajectory, contact force;" in said_of(made_study(tmp_path, found))[0]
    )
    for point in found:
        point.means = {"radius of gyration": (1e-2, 1e-3)}
    said = said_of(made_study(tmp_path, found, last=8))[0]
    assert said.endswith("5 perturbed runs, with their uncertainty: radius of gyration")
    assert "errors" not in said_of(made_study(tmp_path))[0]


def test_what_an_ensemble_cannot_tell_is_not_claimed(tmp_path):
    """Whatever was found is below the uncertainty."""
    point = points()[0]
    point.error, point.uncertainty = 1e-5, 0.02
    point.means = {"mean": (1e-5, 0.02), "other": (1e-6, 0.0)}
    orders = {"trajectory": 1.98}
    said = said_of(made_study(tmp_path, [point], last=8, orders=orders))
    assert "in the first 250 ms: trajectory 1.98" in said[2]
    assert "is the cheapest" in said[3] and said[3].endswith("surely within 0.04")
    assert all("met by none" in line for line in said[4:])
    assert said[4].endswith("none below 0.04 could be told from 5 runs")


def test_where_nothing_touches_no_setting_is_advised(tmp_path):
    result = made_study(tmp_path, points(), window=3e-3, touched=False)
    (said,) = said_of(result)
    assert said.startswith("nothing touched in these 3 ms:") and "longer --duration" in said


def test_knobs_of_a_ground_that_nothing_touches_are_said_to_change_nothing(tmp_path):
    turned = Point("residual", Settings(1e-5), "finished", error=1e-3, alone=0.0, times=[1.0])
    result = made_study(tmp_path, [turned], window=3e-3, grounded=False)
    assert "touched the substrate in these 3 ms" in said_of(result)[2]
    turned.alone = 1e-5  # something touched between two samples
    assert "substrate" not in " ".join(said_of(result))
    turned.alone = 0.0
    assert "substrate" not in " ".join(said_of(made_study(tmp_path, [turned], grounded=True)))


def test_advice_lists_what_was_turned_and_over_which_time_it_holds(tmp_path):
    tight = Settings.tightest(bobbing(), 1e-5)
    given = Settings.of(bobbing(), 1e-5)
    cheap, exact = (
        Point("", settings, "finished", error=error, times=[error])
        for settings, error in ((tight, 1e-4), (given, 1e-2))
    )
    turned = ("step", "coupling")
    result = made_study(tmp_path, [cheap, exact], window=1e-3, tight=tight, turned=turned)
    said = said_of(result)
    assert said[1].startswith("turned: step, coupling; all else at its tightest (exchange impl")
    assert "step 10 µs, coupling finite is the cheapest" in said[-1]
    assert said[-1].endswith("over 1 ms its error is 0.0001")
    exact.times = [1e-5]  # the settings of the scene are looser in what was not turned
    said = said_of(result)
    assert f"residual {given.residual:g}" in said[-3] and "precision" not in said[-3]


def test_a_study_that_was_cut_short_says_so_and_nothing_that_was_not_measured(tmp_path):
    result = Study(tmp_path, 1.0, 32, cut_short="interrupted")
    assert said_of(result) == ["interrupted before there was a reference: nothing was compared"]
    result = made_study(tmp_path, planned=22, turned=("step",), cut_short="interrupted")
    said = said_of(result)
    assert said[0] == "interrupted after 0 of 22 settings"
    assert said[1] == "trajectories stay comparable over all 1 s" and len(said) == 3
    result.points = [*points(), Point("step", Settings(1e-5), "finished", error=1e-5)]
    said = said_of(result)
    assert said[0] == "interrupted after 5 of 22 settings, 1 of them not timed yet"
    assert "is the cheapest so far" in said[-2] and "settings tried so far" in said[-1]
    assert said[-1].endswith("the least is 0.0009")


def test_the_picture_says_which_settings_are_on_the_front(tmp_path):
    """Each by its knob's value; no text on another."""
    found = points()
    others = (("exchange", "every 4"), ("precision", "single"), ("residual", 1e-2))
    for number, (knob, turned) in enumerate(others):
        settings = dataclasses.replace(Settings(1e-5), **{knob: turned})
        cost, error = 3.9 + number / 100, 8e-4 * 0.9**number
        found.append(Point(knob, settings, "finished", error=error, times=[cost]))
    found += [Point("combined 0.01", Settings(1e-5), "finished", error=0.1, times=[0.5])]
    found += [Point("as given", Settings(1e-5), "finished", error=1e-4, times=[6.0])]
    drawing = picture(made_study(tmp_path, found))
    (axes,) = drawing.axes
    written = [text for text in axes.texts if text.get_text()]
    assert {text.get_text() for text in written} == {value(p) for p in pareto(found)}
    assert {"10 µs", "every 4", "single", "residual 0.01", "for 0.01", "as given"} >= {
        text.get_text() for text in written
    }
    boxes = [text.get_window_extent() for text in written]
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)
    assert all(axes.get_window_extent().contains(*corner) for b in boxes for corner in b.corners())


def test_the_table_has_the_spread_of_the_times(tmp_path):
    timed = Point("step", Settings(1e-5), "finished", times=[1.5, 0.5, 1.0], unit=2.0)
    write(tmp_path, [timed, Point("step", Settings(1e-5), "stopped: too deep")])
    names = [f"{which}seconds_per_simulated_second" for which in ("least_", "", "largest_")]
    found = [[float(row[name]) for name in names] for row in rows(tmp_path)]
    assert found == [[1.0, 2.0, 3.0], [math.inf] * 3]
