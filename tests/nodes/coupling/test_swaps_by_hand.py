"""Laws and parameters changed by saving the watched file and by the command line."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest

from nodes.cli.main import main
from tests.support.held import HELD, receipts, recorded
from tests.support.launching import Running, private_runtime_dir, running, wait_for

# -- the watched file
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_saving_the_watched_file_changes_the_running_law_all_or_nothing(
    tmp_path: Path,
) -> None:
    (tmp_path / "watching.yaml").write_text(
        HELD.replace(
            "    kind: coupling\n", "    kind: coupling\n    watch: coupling.yaml\n"
        )
    )
    watched = tmp_path / "coupling.yaml"
    watched.write_text("coupling: {laws: {pd: {stiffness: 510.0}}}\n")

    def now(launch: Running, name: str) -> Any:
        return launch.call("coupling", "param.get", name=name)

    with running(tmp_path, "./watching.yaml") as launch:
        assert now(launch, "laws.pd") == {
            "kind": "pd",
            "stiffness": 510.0,
            "damping": 3.0,
        }
        watched.write_text("coupling: {laws: {pd: {stiffness: 530.0}}, ramp: 5}\n")
        wait_for(
            lambda: now(launch, "laws.pd.stiffness") == 530.0, "the saved stiffness"
        )
        assert now(launch, "ramp") == 5
        assert now(launch, "laws.pd.damping") == 3.0
        for content, told in (
            (
                "laws: {pd: {stiffness: 490.0, damping: -1.0}}",
                "coupling.laws.pd.damping: expected a number of at least 0, got -1.0",
            ),
            ("laws: {pd: {stiffness: 490.0}", "not valid YAML"),
            (
                "laws: {pd: {stiffness: 490.0}, pd: {stiffness: 490.0}}",
                "'pd' stands twice",
            ),
            ("law: nix", "no law is named 'nix'"),
        ):
            watched.write_text(content)
            wait_for(lambda told=told: told in launch.errors, told)  # type: ignore[misc]
            assert now(launch, "laws.pd.stiffness") == 530.0
        # A slow writer: nothing is applied until it has closed the file, then all of it.
        with open(watched, "w", encoding="utf-8") as file:
            file.write("laws: {pd: {stiffness: 54")
            file.flush()
            launch.wait_ticks(250)
            assert now(launch, "laws.pd.stiffness") == 530.0
            file.write("0.0}}\n")
        wait_for(
            lambda: now(launch, "laws.pd.stiffness") == 540.0,
            "the slowly saved stiffness",
        )
        wait_for(
            lambda: (
                "coupling.yaml: laws.pd.stiffness 530.0 → 540.0 from tick "
                in launch.errors
            ),
            "its report",
        )
        figures = launch.finish(signal.SIGINT, code=0)
    found = receipts(recorded(tmp_path, figures))
    assert [json.loads(receipt.after)["stiffness"] for receipt in found] == [
        530.0,
        540.0,
    ]
    refused = [
        event
        for event in recorded(tmp_path, figures).messages("/coupling/event")
        if event.kind == "refused"
    ]
    assert len(refused) == 4
    assert all(
        "the running parameters are untouched" in event.reason for event in refused
    )


# -- the command line
# --------------------------------------------------------------------------------------------------


class Verbs:
    """The command ``haptic`` in this process, without half a second of start-up each time."""

    def __init__(
        self,
        runtime_dir: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(runtime_dir))
        self._capsys = capsys

    def __call__(self, *words: str, code: int = 0) -> tuple[str, str]:
        """Run a command; return standard output and standard error."""
        self._capsys.readouterr()
        try:
            found = main(list(words))
        except SystemExit as end:
            found = int(str(end.code))
        out, err = self._capsys.readouterr()
        assert found == code, err
        return out, err

    def answered(self, *words: str) -> dict[str, Any]:
        """Run a command with --json; return its object."""
        found: dict[str, Any] = json.loads(self(*words, "--json")[0].splitlines()[-1])
        return found


@pytest.mark.process
def test_the_command_line_beside_a_running_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        monkeypatch.chdir(tmp_path)
        haptic = Verbs(launch.runtime_dir, monkeypatch, capsys)
        answered = haptic.answered
        assert "pd_alpha" in launch.haptic("law", "list").stdout

        assert set(answered("node", "list")["nodes"]) == {
            "driver",
            "environment",
            "coupling",
            "logger",
        }
        assert answered("node", "info", "/coupling")["status"]["state"] == "running"
        assert (
            answered("param", "list", "coupling")["nodes"]["coupling"][
                "laws.pd.stiffness"
            ]
            == 1000.0
        )
        assert haptic("param", "get", "/coupling", "laws.pd.stiffness")[0] == "1000.0\n"
        changed = answered(
            "param",
            "set",
            "coupling",
            "laws.pd.stiffness",
            "1500",
            "laws.pd.damping",
            "4",
        )
        assert changed["receipt"]["action"] == "set"
        assert changed["values"] == {"laws.pd.stiffness": 1500, "laws.pd.damping": 4}
        haptic("param", "dump", "coupling", "-o", "dump.yaml")
        assert (
            "File exists"
            in haptic("param", "dump", "coupling", "-o", "dump.yaml", code=1)[1]
        )
        (tmp_path / "designed.yaml").write_text(
            "coupling: {law: designed, laws: {designed: {kind: fir, taps: [2000.0, -1000.0]}}}\n"
        )
        assert (
            answered("param", "load", "coupling", "designed.yaml")["receipt"]["to"]
            == "designed"
        )
        assert answered("law", "list")["active"] == "designed"
        assert answered("law", "show")["taps_n_per_m"] == [2000.0, -1000.0]
        switched = answered("law", "switch", "pd_alpha", "--ramp", "10")
        assert (switched["from"], switched["to"], switched["ramp"]) == (
            "designed",
            "pd_alpha",
            10,
        )
        assert {
            "h1_n_per_m",
            "h_nyquist_n_per_m",
            "pole_radius",
            "f_min_n_s_per_m",
        } <= set(switched["is"])
        assert switched["was"]["taps_n_per_m"] == [2000.0, -1000.0]
        assert answered("param", "get", "coupling", "ramp")["value"] == 0
        assert (
            answered("param", "load", "coupling", "dump.yaml")["receipt"]["to"] == "pd"
        )
        assert haptic("param", "dump", "coupling")[0].splitlines()[:2] == [
            "coupling:",
            "  law: pd",
        ]
        out, err = haptic(
            "param", "set", "coupling", "laws.pd.stiffness", ".nan", "--json", code=1
        )
        assert "nan is not a finite number" in json.loads(out)["error"]
        assert "nan is not a finite number" in err
        for words, told in (
            (("param", "set", "coupling", "ramp"), "'ramp' has no value"),
            (
                ("param", "set", "coupling", "ramp", "1", "ramp", "2"),
                "ramp is given twice",
            ),
            (("param", "set", "coupling", "ramp", "[1"), "not valid YAML"),
            (("param", "get", "copling", "ramp"), "did you mean coupling?"),
            (("param", "load", "coupling", "nix.yaml"), "No such file"),
            (("node", "list", "--run", "nix"), "no run is named 'nix'"),
        ):
            assert told in haptic(*words, code=2)[1]
        for asked in (
            "law switch nix",
            "law show nix",
            "param set driver safety.ramp 1",
        ):
            assert haptic(*asked.split(), code=1)[1].startswith("haptic: ")


def test_laws_are_shown_without_a_running_loop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with private_runtime_dir() as runtime_dir:
        haptic = Verbs(runtime_dir, monkeypatch, capsys)

        def shown(*words: str) -> dict[str, Any]:
            return haptic.answered("law", "show", *words)

        by_flags = shown("pd", "--rate", "500", "--stiffness", "1000", "--gain", "3")
        # Paper, eq. 1 at T = 2 ms: K + B/T and −B/T.
        assert by_flags["taps_n_per_m"] == [2500.0, -1500.0]
        assert (by_flags["h1_n_per_m"], by_flags["h_nyquist_n_per_m"]) == (
            1000.0,
            4000.0,
        )
        assert 0.9 < by_flags["pole_radius"] < 1.0
        assert shown("pd", "stiffness:=1000", "damping:=3") == by_flags
        assert (
            shown("{kind: pd, stiffness: 1000, damping: 3}", "--rate", "500")
            == by_flags
        )
        launched = shown("--launch", "floor_drop")
        for key in ("taps_n_per_m", "h1_n_per_m", "pole_radius", "rate_hz", "law"):
            assert launched[key] == by_flags[key]
        assert (
            shown("multi_term", "--launch", "floor_drop", "stiffness:=1200")[
                "stiffness"
            ]
            == 1200.0
        )
        assert (
            len(
                shown(
                    "paper_optimum", "--rate", "250", "--delay", "1", "--mass", "0.2"
                )["taps_n_per_m"]
            )
            == 4
        )
        assert "pole radius" in haptic("law", "show", "paper_optimum")[0]
        for words in (
            ("nix", "--rate", "500"),
            ("pd", "--rate", "0"),
            ("pd", "--rate", "500"),
            (),
        ):
            haptic("law", "show", *words, code=2)
