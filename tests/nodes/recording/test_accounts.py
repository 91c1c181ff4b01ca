"""Losses, omissions and misses: nothing unrecordable counts, and nothing twice."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from messages.topics import DEVICE_STATE, PROXY, event, status, within
from messages.types import ZERO, DeviceState, Event, Message, NodeStatus, Proxy
from nodes.cli.main import main
from nodes.recording import reader
from nodes.recording.accounts import accounts, completeness, overruns
from nodes.recording.logger import open_writer
from nodes.recording.reader import Recording
from nodes.recording.summary import summarise
from nodes.recording.writer import Ended, RecordWriter, write_ended

PERIOD = 0.002
BEGUN = 7.0
"""Stamp of tick 0 [s]."""


def state(seq: int, begun: float = BEGUN, **told: Any) -> DeviceState:
    return DeviceState(seq=seq, stamp=begun + seq * PERIOD, position=ZERO, **told)


def ticks(
    chain: str = "", count: int = 300, skipped: Iterable[int] = ()
) -> Iterator[tuple[str, Message]]:
    """Publish like driver and environment: an event, ticks, and a status every 50.

    `skipped`: ticks that the environment omits.
    """
    sent = {"driver": 0, "environment": 0}

    def told(node: str, topic: str, message: Message) -> tuple[str, Message]:
        sent[node] += 1
        return within(chain, topic), message

    for node in sent:
        name = within(chain, f"/{node}")[1:]
        yield told(
            node,
            event(node),
            Event(seq=0, stamp=BEGUN - 1.0, node=name, kind="x", reason="y"),
        )
    for seq in range(count):
        yield told("driver", DEVICE_STATE, state(seq))
        if seq not in skipped:
            yield told(
                "environment",
                PROXY,
                Proxy(seq=seq, stamp=BEGUN + seq * PERIOD, position=ZERO, proxy=ZERO),
            )
        if seq % 50 == 49:
            for node in sent:
                name, at = within(chain, f"/{node}")[1:], BEGUN + seq * PERIOD
                message = NodeStatus(
                    seq=seq,
                    stamp=at,
                    node=name,
                    kind=node,
                    state="running",
                    pid=1,
                    sent=sent[node],
                )
                yield told(node, status(node), message)


def recorded(
    path: Path, sent: Iterable[tuple[str, Message]], chains: Iterable[str] = ("",)
) -> Path:
    publishes = {
        within(chain, f"/{node}")[1:]: [within(chain, topic)]
        for chain in chains
        for node, topic in (("driver", DEVICE_STATE), ("environment", PROXY))
    }
    with RecordWriter(
        path, {"publishes": json.dumps(publishes)}, overwrite=True
    ) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp)
    return path


def lost(path: Path) -> dict[str, int]:
    return {
        node: account.lost
        for node, account in completeness(Recording(path)).nodes.items()
    }


# -- losses
# --------------------------------------------------------------------------------------------------


def test_what_a_node_skipped_before_and_while_a_late_logger_listened_is_not_lost(
    tmp_path: Path,
) -> None:
    late = [
        (topic, message)
        for topic, message in ticks(skipped=(60, 150, 151))
        if message.seq >= 40
    ]
    assert lost(recorded(tmp_path / "r.mcap", late)) == {"driver": 0, "environment": 0}
    # What was sent and did not come is.
    gone = [
        (topic, message)
        for topic, message in late
        if not (topic == PROXY and message.seq == 200)
    ]
    assert lost(recorded(tmp_path / "r.mcap", gone)) == {"driver": 0, "environment": 1}


def test_several_chains_are_judged_each_by_its_own_beginning(tmp_path: Path) -> None:
    chains = ("left", "right")

    def sent(left: int, right: int) -> list[tuple[str, Message]]:
        both = [*ticks("left", skipped=(250,)), *ticks("right")]
        since = {"left": left, "right": right}
        kept = [
            (topic, message)
            for topic, message in both
            if message.seq >= since[topic.split("/")[1]]
        ]
        return sorted(kept, key=lambda one: one[1].seq)

    for since in ((0, 0), (120, 130), (0, 130)):
        verdict = completeness(
            Recording(recorded(tmp_path / "r.mcap", sent(*since), chains))
        )
        assert verdict.text == "complete, nothing lost"
        assert [verdict.nodes[f"{chain}/driver"].since for chain in chains] == list(
            since
        )
        assert verdict.left_out == 0


@pytest.mark.parametrize("chains", [("",), ("left",), ("left", "right")])
@pytest.mark.parametrize(
    "words",
    [
        ["cut", "--to", "0.35"],
        ["cut", "--from", "0.15", "--to", "0.5"],
        ["filter", "-x", "/driver/event$"],
    ],
)
def test_what_was_cut_is_not_lost(
    tmp_path: Path, chains: tuple[str, ...], words: list[str]
) -> None:
    sent = sorted(
        (one for chain in chains for one in ticks(chain, skipped=(110,))),
        key=lambda one: one[1].stamp,
    )
    path = recorded(tmp_path / "r.mcap", sent, chains)
    part, again = tmp_path / "part.mcap", tmp_path / "again.mcap"
    assert main(["bag", words[0], str(path), *words[1:], "--out", str(part)]) == 0
    assert main(["bag", "cut", str(part), "--to", "0.3", "--out", str(again)]) == 0
    wanted = [
        within(chain, f"/{node}")[1:]
        for chain in chains
        for node in ("driver", "environment")
    ]
    for file in (part, again):
        # Of a node without all its topics there is nothing to compare.
        left = [
            node for node in wanted if words[0] == "cut" or not node.endswith("driver")
        ]
        assert lost(file) == dict.fromkeys(left, 0)
    assert reader.EXTRACT in Recording(again).metadata


def test_a_recording_of_some_topics_accounts_for_the_nodes_that_are_there_whole(
    tmp_path: Path,
) -> None:
    path, chosen = (
        tmp_path / "r.mcap",
        [
            DEVICE_STATE,
            status("driver"),
            PROXY,
            status("environment"),
            event("environment"),
        ],
    )
    publishes = json.dumps({"driver": [DEVICE_STATE], "environment": [PROXY]})
    with open_writer(str(path), {"publishes": publishes}, False, chosen) as writer:
        for topic, message in ticks():
            if topic in chosen:
                writer.write(topic, message, message.stamp)
    assert lost(path) == {"environment": 0}


def test_a_cut_recording_of_several_chains_tells_the_ticks_after_its_end(
    tmp_path: Path,
) -> None:
    sent = sorted(
        (one for chain in ("left", "right") for one in ticks(chain)),
        key=lambda one: one[1].stamp,
    )
    path = recorded(tmp_path / "r.mcap", sent, ("left", "right"))
    path.write_bytes(path.read_bytes()[:-100])
    write_ended(path, Ended(400, "ended with SIGKILL"))
    verdict = completeness(Recording(path))
    assert (
        verdict.missing_ticks
        == 400 - Recording(path).topics["/left/device/state"].last_seq
        > 0
    )


# -- a driver that was started again
# ---------------------------------------------------------------------------------


def test_a_driver_that_was_started_again_counts_on(tmp_path: Path) -> None:
    first = [
        state(seq, missed=seq // 10, overruns=seq // 50, response=1e-4)
        for seq in range(20, 200)
    ]
    second = [
        state(seq, BEGUN + 1.0, missed=seq // 20, response=1e-4) for seq in range(60)
    ]
    # A later one left out its first ticks, too, which no gap shows.
    third = [
        state(seq, BEGUN + 2.0, missed=4, overruns=3 + (seq > 20), response=1e-4)
        for seq in range(3, 40)
    ]
    path = recorded(
        tmp_path / "r.mcap", [(DEVICE_STATE, one) for one in (*first, *second, *third)]
    )
    recording = Recording(path)
    summary = summarise(recording)
    # In real time it goes on with the ticks, and counts what it leaves out anew.
    follows = [
        state(seq, overruns=(seq > 280) + (seq > 290)) for seq in range(260, 300)
    ]
    live = Recording(
        recorded(
            tmp_path / "live.mcap", [(DEVICE_STATE, one) for one in (*first, *follows)]
        )
    )
    assert summarise(live).overruns == overruns(live) == 3 + 2
    assert (summary.ticks, summary.missed) == (179 + 59 + 36, 17 + 2 + 0)
    assert (
        summary.overruns
        == overruns(recording)
        == completeness(recording).left_out
        == 3 + 0 + 1
    )
    # While a driver ticked, at 500 Hz; from the first state to the last. Stamps are rounded to
    # 2^-50 s.
    assert summary.rate_hz == pytest.approx(1.0 / PERIOD, rel=1e-9)
    assert summary.duration_s == pytest.approx(
        2.0 + 39 * PERIOD - 20 * PERIOD, abs=1e-8
    )


# -- what is not known
# -----------------------------------------------------------------------------------------------


def test_without_states_nothing_is_told_of_ticks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(
        tmp_path / "r.mcap", [one for one in ticks() if one[0] != DEVICE_STATE]
    )
    summary = summarise(Recording(path))
    assert (summary.missed, summary.overruns, summary.age_ticks_max) == (
        None,
        None,
        None,
    )
    assert main(["bag", "info", str(path), "--json"]) == 0
    assert (
        msgspec.json.decode(capsys.readouterr().out.splitlines()[-1])["overruns"]
        is None
    )


def test_damaged_metadata_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.mcap"
    with RecordWriter(path, {"publishes": '{"driver": 1}'}) as writer:
        for topic, message in ticks():
            writer.write(topic, message, message.stamp)
    assert main(["bag", "info", str(path)]) == 1
    assert "r.mcap: damaged metadata manifest.publishes" in capsys.readouterr().err


def test_a_recording_is_gone_through_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recorded(tmp_path / "r.mcap", [one for one in ticks() if one[1].seq >= 40])
    passes: list[Recording] = []
    raw = Recording.raw

    def counted(recording: Recording) -> Iterator[Any]:
        passes.append(recording)
        return raw(recording)

    monkeypatch.setattr(Recording, "raw", counted)
    recording = Recording(path)
    assert completeness(recording).nodes == accounts(recording)
    assert len(passes) == 2
