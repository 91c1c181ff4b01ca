"""Files of studies: earlier results are not overwritten; figures can be read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from nodes.cli.main import main
from sim import results
from sim.axes import legend_below, name_points, plain_log
from sim.cli.drill import table
from sim.drill.drill import DrillOutcome
from sim.lab.charts.chart_page import draw
from sim.lab.charts.points import Group, Point, with_front
from sim.results import EARLIER, fresh
from tests.support.overlap import drawn_texts, overlaps


def test_an_earlier_file_is_set_aside_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "studies" / "deep"
    for number in range(3):
        fresh(folder / "a.png").write_text(f"a {number}")
        fresh(folder / "b.json").write_text(f"b {number}")
    assert (folder / "a.png").read_text() == "a 2"
    kept = sorted((folder / EARLIER).glob("*/a.png"))
    assert sorted(path.read_text() for path in kept) == ["a 0", "a 1"]
    # What one run set aside stays together.
    assert [
        path.with_name("b.json").read_text().replace("b", "a") for path in kept
    ] == [p.read_text() for p in kept]
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert said[0] == f"{folder}: files of an earlier run are kept in {kept[0].parent}"


def test_a_study_that_runs_again_keeps_what_was_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "_moved", {})
    out = tmp_path / "studies"
    for taps in ("4", "6"):
        assert main(["lab", "fig3", "--out-dir", str(out), "--taps", taps]) == 0
    assert "kept in" in capsys.readouterr().err
    (earlier,) = out.glob(f"{EARLIER}/*/fig3.json")
    assert json.loads(earlier.read_text()) != json.loads(
        (out / "fig3.json").read_text()
    )
    assert earlier.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_front_of_a_chart_is_named_however_crowded(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    costs, errors = rng.lognormal(0.0, 0.3, (2, 60)).tolist()
    crowd = [
        Point(f"a_choice_with_a_long_name {i}", costs[i], errors[i], f"family {i % 9}")
        for i in range(60)
    ]
    front = [
        Point(f"on_the_front {i}", 0.2 * 1.02**i, 0.2 / 1.05**i, "front")
        for i in range(8)
    ]
    group = with_front(
        Group("g", "a chart", "cost [µs]", "error [1]", (*crowd, *front))
    )
    figures: list[Figure] = []
    save = Figure.savefig

    def keep(self: Figure, *words: Any, **options: Any) -> None:
        figures.append(self)
        save(self, *words, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", keep)
        draw(group, tmp_path)
    written = {text.get_text() for text in drawn_texts(figures[0])}
    assert {p.name for p in group.points if p.on_front} <= written
    assert overlaps(figures[0]) == []


def test_names_without_room_are_left_out_unless_they_must_be_there() -> None:
    figure = Figure(figsize=(3.0, 3.0), layout="constrained")
    axes = figure.add_subplot(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    points = [(f"name {i}", 0.5, 0.5) for i in range(12)]
    name_points(axes, points, [], must=False, size=7.0, color="k")
    few = len(axes.texts)
    assert 0 < few < len(points)
    assert overlaps(figure) == []
    name_points(
        axes,
        [("must", 0.5, 0.5)],
        [t.get_window_extent() for t in axes.texts],
        must=True,
        size=7.0,
        color="k",
    )
    assert axes.texts[-1].get_text() == "must"
    assert overlaps(figure) == []


@pytest.mark.parametrize(
    ("low", "high"), [(0.025, 0.4), (0.9, 1.3), (1.0, 60.0), (1e-3, 1e4)]
)
def test_logarithmic_axes_are_labelled_with_plain_numbers(
    low: float, high: float
) -> None:
    figure = Figure(figsize=(5.0, 4.0), layout="constrained")
    axes = figure.add_subplot(xscale="log", xlim=(low, high))
    axes.plot([low, high], [0.0, 1.0], label="a line")
    plain_log(axes.xaxis, low, high)
    legend_below(figure, [axes])
    assert overlaps(figure) == []
    labels = [text.get_text() for text in drawn_texts(figure)]
    assert any(
        low <= float(label) <= high
        for label in labels
        if label.replace(".", "").replace("e-", "").isdigit()
    )


def test_drill_prints_columns_and_markdown_where_asked() -> None:
    outcomes = [
        DrillOutcome(
            fault="kill coupling",
            what="SIGKILL, respawned",
            safe_ticks=19,
            lost_ticks=3,
            window_ticks=180,
            passed=True,
        ),
        DrillOutcome(
            fault="flood",
            what="300 old forces",
            safe_ticks=40,
            reasons=["40 ticks, limit 27"],
        ),
        DrillOutcome(
            fault="full disk", what="no room under the logger", skipped="not root"
        ),
    ]
    lines = table(outcomes).splitlines()
    assert not any("|" in line for line in lines)
    assert lines[0].split("  ")[0] == "fault"
    # Columns begin where their heads do, or end there for numbers.
    assert all(
        line.index("SIGKILL") == lines[0].index("what was done") for line in lines[1:2]
    )
    assert lines[1].index("3 of 180") + len("3 of 180") == lines[0].index(
        "ticks lost"
    ) + len("ticks lost")
    assert lines[2].endswith("FAILED")
    assert lines[3].endswith("skipped")
    assert (
        lines[-1] == "flood: 40 ticks, limit 27"
        or "full disk: skipped: not root" in lines
    )
    markdown = table(outcomes, markdown=True).splitlines()
    assert all(line.count("|") == 8 for line in markdown[:5])
    assert set(markdown[1]) <= set("|-: ")
