"""Runs beside each other: what differs, what came of it, in either system of units, as tables, text and pictures."""

import pandas as pd
import pytest

from halfshaft import Cycle, InputError, Result, Vehicle, run
from halfshaft.studies.bars import plot_bars
from halfshaft.studies.compare import compare

US06 = Cycle.load("us06")


@pytest.fixture(scope="module")
def both():
    car = Vehicle.load("small-car-electric")
    return compare(car, car.with_values({"body.m": 1500}), Vehicle.load("small-car-series"), cycle=US06)


def test_what_differs_is_how_runs_were_made_their_parts_and_the_numbers_of_parts_that_are_the_same(both):
    found = {row.name: (row.unit, row.values) for row in both.differences()}
    assert found["vehicle"][1] == ("small-car-electric", "small-car-electric", "small-car-series")
    assert found["engine"][1] == (None, None, "si-41kw")
    assert found["body.m"] == ("kg", (1144.0, 1500.0, 1373.0))
    assert "cycle" not in found
    assert not [name for name in found if name.startswith("engine.")]
    more = {row.name: row.values for row in both.differences(all_parameters=True)}
    assert more["engine.J"][:2] == (None, None)
    assert more.keys() > found.keys()


def test_runs_that_are_the_same_differ_in_nothing():
    car = Vehicle.load("small-car-electric")
    same = compare(car, car, cycle=US06)
    assert same.differences() == []
    assert same.labels == ("(1)", "(2)")
    other = compare(car, car, cycle=US06.scaled(0.5), labels=["a", "b"])
    assert compare(same.results[0], other.results[0]).differences()[0].name == "cycle"


def test_a_cycle_of_the_same_name_with_other_points_is_told():
    from dataclasses import replace

    car = Vehicle.load("small-car-electric")
    one, other = run(car, US06), run(car, replace(US06, speed=US06.speed * 0.9))
    assert [row.name for row in compare(one, other).differences()] == ["cycle, by its points"]


def test_the_numbers_are_those_of_the_summaries_in_the_units_of_a_reader(both):
    table = both.to_pandas("us")
    assert isinstance(table, pd.DataFrame)
    assert list(table.columns) == list(both.labels)
    figures = [r.figures for r in both.results]
    assert table.loc["consumption [Wh/mi]"].iloc[0] == pytest.approx(figures[0]["energy_Wh_per_km"] * 1.609344)
    assert table.loc["economy, fuel alone [mpg]"].iloc[2] == pytest.approx(figures[2]["fuel_economy_mpg"])
    assert table.loc["economy [MPGe]"].iloc[1] == pytest.approx(figures[1]["energy_MPGe"])
    assert table.loc["fuel [gal]"].isna().tolist() == [True, True, False]
    metric = both.to_pandas()
    assert metric.loc["distance [km]"].iloc[0] == pytest.approx(table.loc["distance [mi]"].iloc[0] * 1.609344)
    assert "economy [MPGe]" not in metric.index


def test_the_text_tells_by_how_much_a_run_differs_from_the_first(both):
    _, found = both.tables()
    rows = {row[0]: row[1:] for row in found}
    one, two = (r.figures["energy_Wh_per_km"] for r in both.results[:2])
    assert rows["consumption"] == (f"{one:.1f} Wh/km", f"{two:.1f} Wh/km (+{100 * (two / one - 1):.1f} %)", "-")
    assert rows["duration"] == ("600.0 s",) * 3


def test_saved_runs_are_compared_too(both, tmp_path):
    read = Result.load(both.results[0].save(tmp_path / "a.nc"))
    again = compare(read, both.results[1], labels=both.labels[:2])
    assert again.differences() == compare(*both.results[:2], labels=both.labels[:2]).differences()


def test_a_notebook_shows_tables_and_a_picture(both):
    html = both._repr_html_()
    assert html.count("<table>") == 2
    assert "data:image/png;base64" in html
    assert "body.m [kg]" in html
    assert repr(both) == f"<Comparison of {', '.join(both.labels)}: {len(both.differences())} differences>"


def test_pictures_are_drawn_of_any_output_of_numbers_and_of_points(both, tmp_path):
    figure = both.plot(["speed", "battery.T"], units="us", path=tmp_path / "a.png")
    assert [ax.get_ylabel() for ax in figure.axes] == ["speed [mph]", "battery.T [\u00b0F]"]
    assert figure.axes[1].lines[0].get_ydata()[-1] == pytest.approx((both.results[0]["battery.T"][-1] - 273.15) * 1.8 + 32)
    bars = both.plot_metrics(path=tmp_path / "b.png")
    titles = [ax.get_title(loc="left") for ax in bars.axes]
    assert "consumption [Wh/km]" in titles
    ax = bars.axes[titles.index("consumption [Wh/km]")]
    assert [bar.get_width() for bar in ax.patches] == [pytest.approx(r.figures["energy_Wh_per_km"] or 0.0) for r in both.results]
    assert [text.get_text() for text in ax.texts][2] == "\u2013"
    assert both.plot_points(["motor"]).axes


def test_negative_numbers_have_bars_to_the_left():
    (ax,) = plot_bars([("battery gave [kWh]", [-1.0, 2.0])], ["a", "b"]).axes
    assert [bar.get_width() for bar in ax.patches] == [-1.0, 2.0]
    assert ax.get_xlim() == (-1.0, 2.0)


def test_what_cannot_be_compared_is_said_at_once():
    car = Vehicle.load("small-car-electric")
    with pytest.raises(InputError) as e:
        compare(car, labels=["a", "b"])
    assert e.value.problems == ("1 to compare, must be at least 2", "a vehicle needs a cycle to run over", "2 labels for 1 runs")
    with pytest.raises(InputError, match="must be vehicles or results, not str"):
        compare("a", "b")
