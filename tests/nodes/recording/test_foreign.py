"""Foreign recordings: invalid manifests and parameters, and texts with escape codes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from messages.topics import DEVICE_STATE
from messages.types import DeviceState, Receipt
from nodes.base.printable import printable
from nodes.recording.export import export_csv
from nodes.recording.facts import (
    axes_of,
    parameters_of,
    period_of,
    refuse_foreign_files,
)
from nodes.recording.plot import plot
from nodes.recording.reader import Recording
from nodes.recording.recover import recover
from nodes.recording.writer import RecordError, RecordWriter
from nodes.view.foxglove_scene import export_foxglove
from nodes.view.replay import ReplayPages
from tests.support.launching import typed_in
from tests.support.recorded import PUBLISHES, drop

MANIFEST = {
    "rate_hz": "500",
    "axes": "x,y,z",
    "pace": "lockstep",
    "publishes": PUBLISHES,
    "scenario": "drop",
}
SENT = list(drop(60, switch=20))
COUPLING = {
    "law": "pd",
    "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}},
}
TRIANGLE = "v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nf 1 2 3\n"

ODD = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-3, 2**70)
    | st.floats()
    | st.sampled_from(["", "x", "nan", "pd", "../x", "\x1b]0;t\a"]),
    lambda inside: (
        st.lists(inside, max_size=3)
        | st.dictionaries(
            st.sampled_from(["kind", "file", "delay"]), inside, max_size=3
        )
    ),
    max_leaves=6,
)
"""Values of wrong types."""


def written(
    path: Path, manifest: dict[str, str], parameters: dict[str, Any], sent: Any = SENT
) -> Path:
    texts = {
        node: text if isinstance(text, str) else json.dumps(text)
        for node, text in parameters.items()
    }
    with RecordWriter(path, manifest, parameters=texts, overwrite=True) as writer:
        for topic, message in sent:
            writer.write(topic, message, message.stamp + 1e-4)
    return path


def read_all(path: Path) -> list[str]:
    """Read a recording in every way; return the refusals."""
    recording = Recording(path)
    refused = []
    ways: list[Any] = [
        lambda: ReplayPages(path),
        lambda: export_foxglove(
            recording, path.with_suffix(".fox.mcap"), overwrite=True
        ),
        lambda: export_csv(recording, path.with_suffix(".csv"), overwrite=True),
        lambda: recover(path, path.with_suffix(".again.mcap"), overwrite=True),
    ]
    for way in ways:
        try:
            way()
        except RecordError as error:
            refused.append(str(error))
    return refused


@pytest.mark.parametrize(
    "rate", ["nan", "inf", "0", "-500", "1e-320", "1e400", "fast", "", "5e5", "\x1b[2J"]
)
def test_a_rate_that_is_none_is_refused_by_its_name(tmp_path: Path, rate: str) -> None:
    path = written(tmp_path / "r.mcap", {**MANIFEST, "rate_hz": rate}, {})
    with pytest.raises(
        RecordError, match=r"manifest.rate_hz is .* expected 1 to 100000 Hz"
    ):
        period_of(Recording(path))
    refused = read_all(path)
    assert len(refused) == 2
    assert all("manifest.rate_hz" in text for text in refused)


@pytest.mark.parametrize("axes", ["", "x,x", "w", "x;y", "x,y,z,x"])
def test_axes_that_are_none_are_refused_by_their_name(
    tmp_path: Path, axes: str
) -> None:
    path = written(tmp_path / "r.mcap", {**MANIFEST, "axes": axes}, {})
    with pytest.raises(
        RecordError, match=r"manifest.axes is .* expected some of x, y, z"
    ):
        axes_of(Recording(path))
    assert any("manifest.axes" in text for text in read_all(path))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "5",
        "{",
        '{"a": ' + "[" * 2000 + "]" * 2000 + "}",
        '{"a": ' + "[" * 50 + "]" * 50 + "}",
    ],
)
def test_parameters_that_are_none_are_refused_by_their_node(
    tmp_path: Path, text: str
) -> None:
    path = written(tmp_path / "r.mcap", MANIFEST, {"left/coupling": text})
    with pytest.raises(RecordError, match=r"parameters.left/coupling"):
        parameters_of(Recording(path))
    assert read_all(path)


@pytest.mark.parametrize("publishes", ["[]", "{", '{"driver": 5}', "[" * 5000])
def test_publishers_that_are_none_are_refused(tmp_path: Path, publishes: str) -> None:
    path = written(tmp_path / "r.mcap", {**MANIFEST, "publishes": publishes}, {})
    assert any("manifest.publishes" in text for text in read_all(path))


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    surface=ODD,
    device=ODD,
    laws=ODD,
    plant=ODD,
    after=ODD,
    manifest=st.dictionaries(st.sampled_from(list(MANIFEST)), st.text(max_size=8)),
)
def test_odd_parameters_raise_nothing_but_a_record_error(
    tmp_path: Path,
    surface: Any,
    device: Any,
    laws: Any,
    plant: Any,
    after: Any,
    manifest: dict[str, str],
) -> None:
    parameters = {
        "environment": {"surface": surface},
        "driver": {"device": device},
        "coupling": {**COUPLING, "laws": laws, "plant": plant},
    }
    odd = Receipt(
        seq=59, stamp=0.118, action="switch", before="{}", after=json.dumps(after)[:200]
    )
    read_all(
        written(
            tmp_path / "r.mcap",
            {**MANIFEST, **manifest},
            parameters,
            [*SENT, ("/coupling/receipt", odd)],
        )
    )


@pytest.mark.parametrize("seqs", [(0, 1), (0, 2**53 - 1), (5, 3)])
@pytest.mark.parametrize("stamps", [(0.0, 1e15), (1.0, -1e15)])
def test_numbers_beyond_any_run_are_read(
    tmp_path: Path, seqs: tuple[int, int], stamps: tuple[float, float]
) -> None:
    states = [
        DeviceState(seq=seq, stamp=stamp, position=(0.0, 0.0, 0.0))
        for seq, stamp in zip(seqs, stamps, strict=True)
    ]
    path = written(
        tmp_path / "r.mcap", MANIFEST, {}, [(DEVICE_STATE, state) for state in states]
    )
    read_all(path)
    # Its picture once: it takes a second.
    if (seqs, stamps) == ((5, 3), (1.0, -1e15)):
        plot(Recording(path), tmp_path / "r.png")


def test_a_file_is_opened_below_the_recording_and_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A foreign manifest could open any file, or block on a pipe."""
    folder, outside, work = (
        tmp_path / "recordings",
        tmp_path / "outside",
        tmp_path / "work",
    )
    for place in (folder, outside, work):
        place.mkdir()
        (place / "t.obj").write_text(TRIANGLE, encoding="ascii")
    os.mkfifo(folder / "pipe.obj")
    (folder / "link.obj").symlink_to(outside / "t.obj")
    monkeypatch.chdir(work)
    for file, opened in (
        (str(folder / "t.obj"), True),
        (str(work / "t.obj"), True),
        ("t.obj", True),
        (str(outside / "t.obj"), False),
        ("../outside/t.obj", False),
        (str(folder / "link.obj"), False),
        (str(folder / "pipe.obj"), False),
        ("/dev/zero", False),
        ("~/t.obj", False),
        ("nothing.obj", False),
    ):
        surface = {
            "kind": "union",
            "shapes": [{"kind": "mesh", "file": file, "sides": "both"}],
        }
        path = written(
            folder / "r.mcap", MANIFEST, {"environment": {"surface": surface}}
        )
        recording = Recording(path)
        pages = json.loads(ReplayPages(path).hello)
        (out,) = export_foxglove(recording, folder / "out.mcap", overwrite=True)
        left_out = Recording(out).metadata.get("scene", {}).get("left_out", "")
        if opened:
            assert pages["shape"]["parts"]
            assert (pages["notice"], left_out) == ("", "")
        else:
            assert not pages["shape"]
            assert "is not opened; copy it there" in pages["notice"]
            assert "is not opened; copy it there" in left_out
            with pytest.raises(
                RecordError, match=r"parameters.environment names the file"
            ):
                refuse_foreign_files(recording, {"surface": surface}, "environment")
    # At the root of all, nothing lies outside.
    monkeypatch.chdir("/")
    with pytest.raises(RecordError, match="is not opened"):
        refuse_foreign_files(
            recording, {"scene": str(outside / "t.obj")}, "environment"
        )


HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\r\x7f"


def test_what_a_terminal_obeys_is_not_printed(tmp_path: Path) -> None:
    topic = f"/{HOSTILE}"
    state = DeviceState(seq=0, stamp=0.0, position=(0.0, 0.0, 0.0))
    path = written(
        tmp_path / "r.mcap",
        {**MANIFEST, "scenario": HOSTILE, "run": HOSTILE},
        {},
        [*SENT, (topic, state)],
    )
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:-40])
    (tmp_path / "two.mcap").write_bytes(path.read_bytes())
    for words in (
        ("bag", "info", "r.mcap"),
        ("bag", "recover", "cut.mcap"),
        ("bag", "filter", "r.mcap", "--out", "f.mcap"),
        ("bag", "filter", "r.mcap", "/none"),
        ("bag", "cut", "r.mcap", "--from", "0", "--to", "0.1"),
        (
            "bag",
            "play",
            "r.mcap",
            "--rate",
            "inf",
            "--endpoint",
            f"ipc://{tmp_path}/play",
        ),
        (
            "bag",
            "play",
            "r.mcap",
            "--topics",
            "/none",
            "--endpoint",
            f"ipc://{tmp_path}/play",
        ),
        ("bag", "export", "r.mcap"),
        ("bag", "plot", "r.mcap", "two.mcap"),
    ):
        done = typed_in(tmp_path, *words, code=None)
        for sign in set(HOSTILE) - {
            "]",
            "0",
            ";",
            "o",
            "w",
            "n",
            "e",
            "d",
            "[",
            "2",
            "J",
            "3",
            "1",
            "m",
        }:
            assert sign not in done.stdout + done.stderr, (words, sign)


def test_our_own_colours_and_words_stay() -> None:
    ours = "\x1b[31mhaptic:\x1b[0m 2 µm\t− 3 °, “so”\u2009\u00a0\n"
    assert printable(ours) == ours
    assert printable("\x1b[5m\x1b[31m\x1b[38m") == "\ufffd[5m\x1b[31m\ufffd[38m"


def test_a_name_with_formulas_is_drawn_as_it_stands(tmp_path: Path) -> None:
    for name in ("a", "b"):
        written(
            tmp_path / f"{name}.mcap",
            {**MANIFEST, "scenario": r"$\frac{$ and $x^$"},
            {},
        )
    typed_in(tmp_path, "bag", "plot", "a.mcap", "b.mcap")
