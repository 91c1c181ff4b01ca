"""Bins lose no spike, wait for late messages, and are bounded in number."""

from __future__ import annotations

import math
import struct
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Force, Proxy
from nodes.view.feed import HEAD, Feed


def fill(feed: Feed, positions: list[float], first: int = 0) -> None:
    for seq, x in enumerate(positions, first):
        feed.take(DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(x, 0.0, 0.0)))
        feed.take(
            PROXY,
            Proxy(seq=seq, stamp=0.0, position=(x, 0.0, 0.0), proxy=(0.0, 0.0, 0.0)),
        )
        feed.take(FORCE, Force(seq=seq, stamp=0.0, force=(-x, 0.0, 0.0)))


def unpack(
    frame: bytes, feed: Feed
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Decode a frame as the page does: times, smallest and largest values by series."""
    kind, count, series, _ = struct.unpack_from("<4I", frame)
    assert (kind, series) == (1, len(feed.names))
    assert len(frame) == HEAD.size + 8 * count + 8 * series * count
    times = np.frombuffer(frame, "<f8", count, HEAD.size)
    values = np.frombuffer(
        frame, "<f4", 2 * series * count, HEAD.size + 8 * count
    ).reshape(2 * series, count)
    return (
        times,
        dict(zip(feed.names, values[:series], strict=True)),
        dict(zip(feed.names, values[series:], strict=True)),
    )


@given(
    st.lists(st.floats(-1.0, 1.0, width=32), min_size=1, max_size=300),
    st.sampled_from([1, 2, 4, 20]),
)
def test_every_bin_holds_the_least_and_the_largest_value_of_its_ticks(
    values: list[float], ticks: int
) -> None:
    feed = Feed(["x"], 1.0 / (500.0 * ticks))
    assert feed.per_bin == ticks
    fill(feed, values)
    feed.file(all_of_them=True)
    times, low, high = unpack(feed.frame(0, feed.head), feed)
    parts = [values[i : i + ticks] for i in range(0, len(values), ticks)]
    assert low["position.x"].tolist() == [min(part) for part in parts]
    assert high["position.x"].tolist() == [max(part) for part in parts]
    assert high["law_force.x"].tolist() == [-min(part) for part in parts]
    # Times are exact multiples of the bin's length.
    assert times.tolist() == [i * ticks * feed._period for i in range(len(parts))]


def test_a_slow_rate_keeps_every_tick() -> None:
    assert Feed(["x"], 1.0 / 500.0).per_bin == 1
    assert Feed(["x"], 1.0 / 501.0).per_bin == 2
    assert Feed(["x"], 1.0 / 50.0).per_bin == 1


def test_a_bin_waits_for_all_topics_and_is_given_up_when_one_stays_away() -> None:
    feed = Feed(["x"], 0.002)
    for seq in range(3):
        feed.take(
            DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.1, 0.0, 0.0))
        )
    feed.file()
    assert feed.head == 0
    for seq in range(3, 60):
        feed.take(
            DEVICE_STATE, DeviceState(seq=seq, stamp=0.0, position=(0.1, 0.0, 0.0))
        )
    feed.file()
    # Just inside and just outside the grace of 30 bins: the newest is 59.
    assert feed.head == 60 - 30
    _, low, _ = unpack(feed.frame(0, feed.head), feed)
    assert np.isnan(low["proxy.x"]).all()
    assert not np.isnan(low["position.x"]).any()
    feed.take(
        PROXY, Proxy(seq=5, stamp=0.0, position=(0.0, 0.0, 0.0), proxy=(0.0, 0.0, 0.0))
    )
    assert feed.late == 1


def test_what_is_kept_is_bounded_however_much_comes() -> None:
    feed = Feed(["x", "y", "z"], 0.002, seconds=1.0)
    fill(feed, [0.001] * 600)
    feed.file()
    before = feed._values.nbytes + feed._times.nbytes
    for first in range(600, 20_000, 100):
        fill(feed, [0.001] * 100, first)
        feed.file()
    assert feed._values.nbytes + feed._times.nbytes == before
    assert len(feed._open) <= 2
    assert feed.oldest() == feed.head - 500
    # A page that asks for what is gone gets what there is.
    times, _, _ = unpack(feed.frame(0, feed.head), feed)
    assert len(times) == 500
    assert feed.until(times[10]) == feed.oldest() + 11


def test_a_loop_that_explodes_is_still_a_picture() -> None:
    feed = Feed(["x"], 0.002)
    fill(feed, [sys.float_info.max, -sys.float_info.max])
    feed.file(all_of_them=True)
    _, low, high = unpack(feed.frame(0, feed.head), feed)
    assert np.isfinite(high["position.x"]).all()
    assert np.isfinite(low["position.x"]).all()
    assert all(map(math.isfinite, feed.now()[1:4]))


@given(
    st.lists(st.floats(-1.0, 1.0, width=32), min_size=1, max_size=300),
    st.integers(1, 400),
)
def test_all_of_a_recording_in_few_bins_loses_no_spike(
    heights: list[float], most: int
) -> None:
    feed = Feed(["x"], 0.002)
    fill(feed, heights)
    feed.file(all_of_them=True)
    frame = feed.overview(most)
    kind, bins, series, *_ = HEAD.unpack_from(frame)
    times = np.frombuffer(frame, "<f8", bins, HEAD.size)
    values = np.frombuffer(frame, "<f4", 2 * series * bins, HEAD.size + 8 * bins)
    low, high = values.reshape(2, series, bins)[:, feed.names.index("position.x")]
    together = -(-len(heights) // most)
    groups = [heights[k : k + together] for k in range(0, len(heights), together)]
    assert (kind, bins) == (2, len(groups))
    assert bins <= most
    assert times.tolist() == [k * together * 0.002 for k in range(bins)]
    assert low.tolist() == [min(group) for group in groups]
    assert high.tolist() == [max(group) for group in groups]
