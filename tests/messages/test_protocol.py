"""The wire protocol of messages/PROTOCOL.md, spoken with nothing but zmq and msgpack.

Nothing of messages/ or nodes/ is used to talk to the launch; the fixture only starts and ends it.
"""

from __future__ import annotations

import json
import math
import threading
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from messages import codec, topics, types
from messages.transport import requests
from tests.support.launching import running, wait_for

FIELDS: dict[str, dict[str, type | tuple[type, ...]]] = {
    "/device/state": {
        "position": list, "force": list, "mean_force": list, "changed_at": float, "force_seq": int,
        "age": int,
        "response": float, "lateness": float, "missed": int, "overruns": int, "safety": str,
        "energy": float,
        "delay": float, "guard": float, "rebased": int,
    },
    "/environment/proxy": {
        "position": list, "proxy": list, "normal": list, "distance": float, "contact": bool,
        "delay": float,
        "rebased": int, "ease": int,
    },
    "/coupling/force": {"force": list, "law": str, "revision": int},
    "/coupling/receipt": {
        "action": str, "before": str, "after": str, "force_step": float, "ramp": int, "reason": str,
        "revision": int,
    },
    "status": {
        "node": str, "kind": str, "state": str, "pid": int, "ticks": int, "sent": int,
        "received": int, "refused": int,
        "skipped": int, "gaps": int, "denied": int, "reason": str, "memory": float, "cpu": float,
        "clock_offset": float,
        "clock_error": float,
    },
    "event": {"node": str, "kind": str, "reason": str},
}  # fmt: skip
"""Fields of each topic as on the page, repeated here on purpose."""

BY_HAND = """\
summary: A coupling in another language
run: {{rate: 500.0, pace: {pace}, duration: {duration}}}
nodes:
  driver: {{kind: sim_driver,
  parameters: {{device: {{mass: 0.1, damping: 1.0, gravity: 9.81, position: 0.001}}}}}}
  environment: {{kind: environment,
  parameters: {{surface: {{kind: plane, axis: z, position: 0.0, normal: 1}}}}}}
  coupling:
    kind: coupling
    by_hand: true
    parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 1000.0, damping: 3.0}}}}}}
"""


def decode(payload: bytes) -> dict[str, Any]:
    """Unpack a payload as a foreign subscriber would."""
    found = msgpack.unpackb(payload, raw=False, strict_map_key=True)
    assert isinstance(found, dict)
    return found


def check(topic: str, message: dict[str, Any]) -> None:
    """Assert that a message has the page's fields."""
    fields = FIELDS.get(topic) or FIELDS[topic.rsplit("/", 1)[1]]
    assert set(fields) | {"seq", "stamp"} <= set(message), topic
    assert isinstance(message["seq"], int)
    assert message["seq"] >= 0
    assert isinstance(message["stamp"], float)
    for name, kind in fields.items():
        value = message[name]
        assert type(value) is kind, f"{topic} {name}: {value!r}"
        if isinstance(value, list):
            assert len(value) == 3
            assert all(type(item) is float and math.isfinite(item) for item in value)


def test_page_lists_every_field_and_topic() -> None:
    page = (Path(types.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")
    rows = {
        line.split("`")[1]: line
        for line in page.splitlines()
        if line.startswith("| `/")
    }
    kinds: dict[str, type[types.Message]] = {
        **topics.FIXED,
        "/NODE/status": types.NodeStatus,
        "/NODE/event": types.Event,
    }
    for topic, message_type in kinds.items():
        for name in message_type.__struct_fields__:
            row = rows[topic].replace(
                "what `/device/state` has", rows[topics.DEVICE_STATE]
            )
            if name not in ("seq", "stamp"):
                assert f"`{name}`" in row or f"`{name}?`" in row, f"{topic}: {name}"


def test_page_has_the_limits_of_the_code() -> None:
    page = (Path(types.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")
    assert f"at most {codec.MAX_PAYLOAD} bytes" in page
    assert f"Requests and replies are at most {requests.MAX_REQUEST} bytes" in page
    assert requests.MAX_REPLY == requests.MAX_REQUEST


@pytest.mark.process
@pytest.mark.smoke
def test_live_traffic_with_zmq_and_msgpack_only(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0", "rate:=250") as launch:
        nodes = json.loads((launch.run_dir / "run.json").read_bytes())["nodes"]
        seen: dict[str, list[dict[str, Any]]] = {}
        with zmq.Context() as context, context.socket(zmq.SUB) as sub:
            sub.linger = 0
            sub.rcvtimeo = 20_000
            sub.subscribe(b"")
            for node in nodes.values():
                sub.connect(node["listen"] or node["publish"])
            kinds = {
                "/device/state",
                "/environment/proxy",
                "/coupling/force",
                "/driver/status",
                "/coupling/status",
            }
            while not kinds <= set(seen) or len(seen["/device/state"]) < 100:
                name, payload = sub.recv_multipart()
                message = decode(payload)
                check(name.decode(), message)
                seen.setdefault(name.decode(), []).append(message)
        for topic in ("/device/state", "/environment/proxy", "/coupling/force"):
            numbers = [message["seq"] for message in seen[topic]]
            assert numbers == sorted(set(numbers)), (
                f"{topic}: every tick once, in order"
            )
        states = seen["/device/state"]
        # Where a busy machine kept the driver from its ticks, the driver says so.
        skipped = states[-1]["seq"] - states[0]["seq"] + 1 - len(states)
        assert skipped == states[-1]["overruns"] - states[0]["overruns"]
        positions = {
            message["seq"]: message["position"] for message in seen["/device/state"]
        }
        common = [
            message
            for message in seen["/environment/proxy"]
            if message["seq"] in positions
        ]
        assert common
        for message in common:
            assert message["position"] == positions[message["seq"]]
        with zmq.Context() as context, context.socket(zmq.REQ) as req:
            req.linger = 0
            req.rcvtimeo = 20_000
            req.connect(nodes["coupling"]["control"])
            for request, accepted in (
                ({"op": "status", "args": {}}, True),
                ({"op": "fly", "args": {}}, False),
            ):
                req.send(msgpack.packb(request))
                reply = decode(req.recv())
                assert reply["ok"] is accepted
                assert bool(reply["error"]) is not accepted


class ForeignCoupling(threading.Thread):
    """A spring in zmq and msgpack: exactly what the page requires of a foreign node."""

    def __init__(self, setup: dict[str, Any]) -> None:
        super().__init__(daemon=True)
        self.setup = setup
        self.stop_asked = False
        self.answered = 0
        self.repeated = 0
        self.start()

    def run(self) -> None:
        """Answer until asked to stop."""
        with zmq.Context() as context:
            pub, sub, rep = (
                context.socket(zmq.PUB),
                context.socket(zmq.SUB),
                context.socket(zmq.REP),
            )
            for socket in (pub, sub, rep):
                socket.linger = 200
            pub.bind(self.setup["publish"])
            rep.bind(self.setup["control"])
            sub.subscribe("/environment/proxy")
            sub.connect(self.setup["sources"]["/environment/proxy"])
            poller = zmq.Poller()
            poller.register(sub, zmq.POLLIN)
            poller.register(rep, zmq.POLLIN)
            told_end = False
            last, payload = -1, b""
            while not told_end:
                ready = dict(poller.poll(100))
                if sub in ready:
                    proxy = decode(sub.recv_multipart()[1])
                    if proxy["seq"] != last:
                        last = proxy["seq"]
                        force = [
                            0.0,
                            0.0,
                            1000.0 * (proxy["proxy"][2] - proxy["position"][2]),
                        ]
                        payload = msgpack.packb(
                            {"seq": last, "stamp": proxy["stamp"], "force": force}
                        )
                        self.answered += 1
                    else:
                        self.repeated += 1
                    pub.send_multipart([b"/coupling/force", payload])
                if rep in ready:
                    request = decode(rep.recv())
                    state = "finished" if self.stop_asked else "running"
                    if request["op"] == "stop":
                        self.stop_asked = True
                    answers = {"status": {"state": state}, "stop": None}
                    known = request["op"] in answers
                    reply = {
                        "ok": known,
                        "result": answers.get(request["op"]),
                        "error": "" if known else "unknown",
                    }
                    rep.send(msgpack.packb(reply))
                    told_end = state == "finished"
            for socket in (pub, sub, rep):
                socket.close()


@pytest.mark.process
def test_a_coupling_in_nothing_but_zmq_and_msgpack_runs_the_loop(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "foreign.yaml"
    scene.write_text(BY_HAND.format(pace="lockstep", duration=0.4))
    with running(tmp_path, str(scene), ready=False) as launch:
        wait_for(lambda: list(launch.runtime_dir.glob("**/run.json")), "the run")
        wait_for(
            lambda: list(launch.runtime_dir.glob("**/coupling.json")),
            "the setup of the foreign node",
        )
        node = ForeignCoupling(
            json.loads((launch.run_dir / "coupling.json").read_bytes())
        )
        figures = launch.finish()
        node.join(timeout=20.0)
        assert not node.is_alive()
        assert figures["exit_reason"] == "done"
        assert figures["ticks"] == 200
        assert node.answered == 200 + 1  # every tick, and the state after the last one
        # A spring alone holds up the mass: half-way of its swing is m·g/K, and it never falls
        # further than twice that plus the drop; 3 mm is beyond any of it and far above the 1 mm it
        # started from falling free for 0.4 s (0.78 m).
        assert abs(figures["final"]["position_m"]) < 3e-3
        assert "waiting for coupling" in launch.errors
