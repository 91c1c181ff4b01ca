"""ROS bags of others, and our own exports, as recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest

from nodes.cli.main import main
from nodes.recording.export_ros2 import export_ros2
from nodes.recording.import_table import import_table
from nodes.recording.reader import Recording
from nodes.recording.table import read
from nodes.recording.writer import RecordError, RecordWriter
from tests.support.recorded import PERIOD, drop

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
STORE: Any = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
BEGIN = 1_700_000_000_123_456_789  # [ns]
STEP = 4_000_000  # 250 Hz [ns]
N = 80

Bag = Callable[..., Path]


def stamp(at: int) -> Any:
    kinds = STORE.types
    time = kinds["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
    return kinds["std_msgs/msg/Header"](stamp=time, frame_id="world")


def vector(kind: str, x: float, y: float, z: float) -> Any:
    return STORE.types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def pose(at: int, x: float) -> Any:
    kinds = STORE.types
    turn = kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    place = kinds["geometry_msgs/msg/Pose"](
        position=vector("Point", x, 2 * x, 0), orientation=turn
    )
    return kinds["geometry_msgs/msg/PoseStamped"](header=stamp(at), pose=place)


def wrench(at: int, x: float) -> Any:
    none = vector("Vector3", 0.0, 0.0, 0.0)
    pushed = STORE.types["geometry_msgs/msg/Wrench"](
        force=vector("Vector3", x, 0, -x), torque=none
    )
    return STORE.types["geometry_msgs/msg/WrenchStamped"](
        header=stamp(at), wrench=pushed
    )


def place(k: int) -> float:
    return 1e-3 * k


@pytest.fixture(params=["MCAP", "SQLITE3"])
def bag(tmp_path: Path, request: pytest.FixtureRequest) -> Bag:
    """Return a function that writes an arm's pose at 250 Hz and its sensor's force at 1 kHz."""

    def write(*poses: str, shift: int = 0) -> Path:
        folder = tmp_path / "bag"
        plugin = getattr(rosbag2.StoragePlugin, request.param)
        with rosbag2.Writer(folder, version=8, storage_plugin=plugin) as writer:
            for topic, message, count, step in (
                *((name, pose, N, STEP) for name in poses or ("/arm/pose",)),
                ("/ft/wrench", wrench, 4 * N, STEP // 4),
            ):
                line = writer.add_connection(
                    topic, message(0, 0.0).__msgtype__, typestore=STORE
                )
                for k in range(count):
                    at = BEGIN + k * step + (shift if message is wrench else 0)
                    raw = STORE.serialize_cdr(message(at, place(k)), line.msgtype)
                    # Received later, and unevenly.
                    writer.write(line, at + 500_000 + 300_000 * (k % 3), raw)
        return folder

    return write


def test_position_and_force_are_those_of_the_stamps(bag: Bag, tmp_path: Path) -> None:
    """The force of a row is the last before it, of the sensor's own rate."""
    found = import_table(bag(shift=STEP // 8), tmp_path / "out.mcap")
    table = read(found.path)
    assert found.samples.period == STEP * 1e-9
    # The sensor begins an eighth of a tick late: the first pose has no force yet.
    k = np.arange(1, N)
    np.testing.assert_array_equal(table["position"][:, 0], 1e-3 * k)
    np.testing.assert_array_equal(table["position"][:, 1], 2e-3 * k)
    # (4 k − 1) whole steps of the sensor lie before tick k.
    np.testing.assert_array_equal(table["force"][:-1, 0], (1e-3 * (4 * k - 1))[:-1])
    np.testing.assert_array_equal(table["force"][:-1, 2], (-1e-3 * (4 * k - 1))[:-1])
    assert "/arm/pose.pose.position.x" in found.text


def test_topics_and_fields_are_chosen(bag: Bag, tmp_path: Path) -> None:
    folder = bag("/left/pose", "/right/pose")
    out = tmp_path / "out.mcap"
    with pytest.raises(
        RecordError, match="several topics may be the position: /left/pose, /right"
    ):
        import_table(folder, out)
    for columns in (
        {"position": ["/right/pose"]},
        {"position": [f"/right/pose.pose.position.{axis}" for axis in "xyz"]},
    ):
        found = import_table(folder, out, columns=columns, overwrite=True)
        assert read(found.path)["position"][9, 1] == 2 * place(9)
    alone = import_table(
        folder,
        out,
        columns={
            "position": ["/left/pose.pose.position.y"],
            "force": ["/ft/wrench.wrench.force.z"],
        },
        axis="y",
        overwrite=True,
    )
    assert alone.samples.axes == "y"
    np.testing.assert_array_equal(
        read(out)["position"][:, 1], [2 * place(k) for k in range(N)]
    )
    for columns, words in (
        ({"position": ["/left/pos"]}, "no topic '/left/pos'.*did you mean /left/pose"),
        ({"position": ["/left/pose.pose.x"]}, "no '/left/pose.pose.x'"),
        ({"position": ["/ft/wrench"]}, "/ft/wrench has no position as a vector"),
        ({"time": ["/left/pose"]}, "'time' is not chosen of a bag"),
    ):
        with pytest.raises(RecordError, match=words):
            import_table(folder, out, columns=columns, overwrite=True)


def test_a_bag_is_read_from_python(bag: Bag) -> None:
    found = haptic.read(bag())
    assert found["position"].shape == (N, 3)
    assert found.scenario == "bag"


def test_a_damaged_bag_is_refused_by_its_name(bag: Bag, tmp_path: Path) -> None:
    folder = bag()
    for file in folder.iterdir():
        if file.name != "metadata.yaml":
            file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(RecordError, match="bag: cannot be read as a ROS bag"):
        import_table(folder, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def states(ticks: int) -> Iterator[tuple[str, Any]]:
    """Yield a drop of which two states are lost."""
    for topic, message in drop(ticks):
        if not (type(message).__name__ == "DeviceState" and message.seq in (50, 51)):
            yield topic, message


def test_our_own_bag_returns_what_it_holds(tmp_path: Path) -> None:
    source = tmp_path / "drop.mcap"
    manifest = {"rate_hz": repr(1 / PERIOD), "axes": "z", "pace": "lockstep"}
    with RecordWriter(source, manifest) as writer:
        for topic, message in states(90):
            writer.write(topic, message, message.stamp)
    export_ros2(Recording(source), tmp_path / "bag")
    # A folder of a bag opens as what it is, and imports as what it was.
    with pytest.raises(
        RecordError, match="topics of a ROS bag are imported: haptic bag import"
    ):
        Recording(tmp_path / "bag").require_ticks()
    found = import_table(tmp_path / "bag", tmp_path / "again.mcap")
    assert found.samples.period == PERIOD
    was, now = read(source), read(found.path)
    for column in ("seq", "stamp", "time", "position", "force", "proxy", "force_asked"):
        np.testing.assert_array_equal(was[column], now[column], err_msg=column)


def test_a_folder_that_is_no_bag_and_a_broken_one_are_refused_in_one_line(
    tmp_path: Path,
) -> None:
    with pytest.raises(
        RecordError, match=r"without metadata\.yaml, so it is no ROS bag; [^\n]*$"
    ):
        import_table(tmp_path, tmp_path / "out.mcap")
    (tmp_path / "metadata.yaml").write_text(":\n- [", encoding="utf-8")
    with pytest.raises(
        RecordError, match=r"^[^\n]* cannot be read as a ROS bag: [^\n]*$"
    ):
        import_table(tmp_path, tmp_path / "out.mcap")


def test_a_file_of_a_bag_is_its_bag_and_is_never_written(
    bag: Bag, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = bag()
    (stored,) = (one for one in folder.iterdir() if one.name != "metadata.yaml")
    before = stored.read_bytes()
    found = import_table(stored, tmp_path / "out.mcap")
    np.testing.assert_array_equal(
        found.samples.position,
        import_table(folder, tmp_path / "whole.mcap").samples.position,
    )
    read_back = haptic.read(stored)["position"]
    np.testing.assert_array_equal(read_back, found.samples.position)
    for source in (stored, folder):
        with pytest.raises(RecordError, match=r"is what is imported; .*--out"):
            import_table(source, stored, overwrite=True)
    assert main(["bag", "import", str(stored)]) == 0
    assert (tmp_path / "bag.mcap").exists()
    monkeypatch.chdir(folder)
    assert main(["bag", "import", ".", "--force"]) == 0
    assert stored.read_bytes() == before
    assert sorted(one.name for one in folder.iterdir()) == [
        stored.name,
        "metadata.yaml",
    ]
    table = tmp_path / "rig.csv"
    table.write_text("t,x\n0.0,0\n0.001,0\n", encoding="utf-8")
    with pytest.raises(RecordError, match="is what is imported"):
        import_table(table, table, overwrite=True)


def test_a_bag_without_its_metadata_is_its_file(bag: Bag, tmp_path: Path) -> None:
    """As of a recording that was killed, or of one file that was sent."""
    folder = bag()
    known = import_table(folder, tmp_path / "known.mcap").samples
    (folder / "metadata.yaml").unlink()
    (stored,) = folder.iterdir()
    before = stored.read_bytes()
    for source in (stored, folder):
        assert main(["bag", "import", str(source)]) == 0
        np.testing.assert_array_equal(haptic.read(source)["position"], known.position)
    written = f"{stored.stem}{'_imported' if stored.suffix == '.mcap' else ''}.mcap"
    assert {one.name for one in folder.iterdir()} == {stored.name, written}
    for out in (folder / written, tmp_path / "bag.mcap"):
        np.testing.assert_array_equal(read(out)["position"], known.position)
    assert stored.read_bytes() == before
    with pytest.raises(RecordError, match=r"haptic bag import .*bag/bag"):
        Recording(stored).require_ticks()
    # A recording of ours is none of others, and two files are no bag.
    with pytest.raises(RecordError, match="is no table and no ROS bag; open it with"):
        import_table(tmp_path / "bag.mcap", tmp_path / "none.mcap")
    for number in (1, 2):
        (folder / f"bag_{number}{stored.suffix}").write_bytes(before)
    with pytest.raises(RecordError, match="import one of its files, or write metadata"):
        import_table(folder, tmp_path / "none.mcap")
    # Cut within its only block, as by a crash, it is refused by its name.
    stored.write_bytes(before[: len(before) // 2])
    with pytest.raises(RecordError, match=rf"{stored.name}: (is no|cannot be read)"):
        import_table(stored, tmp_path / "none.mcap")


def test_joints_are_columns_by_their_names(tmp_path: Path) -> None:
    kind = STORE.types["sensor_msgs/msg/JointState"]
    names = ["hip", "knee"]
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        line = writer.add_connection("/joints", kind.__msgtype__, typestore=STORE)
        for k in range(N):
            at = BEGIN + k * STEP
            values = np.array([place(k), -place(k)])
            message = kind(
                header=stamp(at),
                name=names,
                position=values,
                velocity=np.array([]),
                effort=3 * values,
            )
            writer.write(line, at, STORE.serialize_cdr(message, line.msgtype))
    columns = {"position": ["/joints.position.knee"], "force": ["/joints.effort.hip"]}
    found = import_table(tmp_path / "bag", tmp_path / "out.mcap", columns=columns)
    rows = np.arange(N)
    np.testing.assert_array_equal(found.samples.position[:, 0], -1e-3 * rows)
    assert found.samples.force is not None
    np.testing.assert_array_equal(found.samples.force[:, 0], 3 * (1e-3 * rows))
    columns = {"position": ["/joints.position.kne"]}
    with pytest.raises(RecordError, match=r"did you mean /joints\.position\.knee"):
        import_table(tmp_path / "bag", tmp_path / "o.mcap", columns=columns)
