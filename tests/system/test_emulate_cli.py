"""``camrig emulate`` as its user runs it: a process, a port, Ctrl-C."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import pytest
import serial

from camrig.cli.main import main


class Done(NamedTuple):
    """What a run left."""

    code: object
    out: str
    err: str


@pytest.fixture
def camrig_emulate(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run the program in this process."""

    def run(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["camrig", "emulate", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(ended.value.code, printed.out, printed.err)

    return run


@contextmanager
def running(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the program in the background; yield it and the first line it prints."""
    with subprocess.Popen(
        [sys.executable, "-m", "camrig", "emulate", *arguments],
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert select.select([process.stdout], [], [], 30.0)[0], "no port within 30 s"
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_the_port_serves_it_and_ends_well(number: signal.Signals) -> None:
    with running("pelco-d", "address=3", "baud=2400", "start_pan_deg=-82.13") as (process, port):
        with serial.Serial(port, 2400, timeout=5.0) as opened:
            opened.write(bytes.fromhex("ff030051000054"))
            assert opened.read(7).hex() == "ff030059201591"
        process.send_signal(number)
        assert process.wait(10.0) == 0
        assert not os.path.lexists(port)


def test_a_visca_head_answers_on_a_serial_line() -> None:
    with running("visca", "address=3", "start_pan_deg=-7.5") as (_, port), serial.Serial(port, 9600, timeout=5.0) as it:
        it.write(bytes.fromhex("83090612ff"))
        assert it.read(11).hex() == "b0500000060400000000ff"


@pytest.mark.parametrize("transport", ["udp", "raw-udp"])
def test_a_visca_head_gives_a_url(camrig_emulate: Callable[..., Done], transport: str) -> None:
    done = camrig_emulate("visca", f"transport={transport}", "--seconds", "0.2", "--json")
    first, last = (json.loads(line) for line in done.out.splitlines())
    assert first["port"].startswith("udpout://127.0.0.1:")
    assert last["state"] == "head (address 1): pan +0.00 deg, tilt +0.00 deg, still"


def test_with_json_it_answers_in_lines_and_stops_by_itself(camrig_emulate: Callable[..., Done]) -> None:
    done = camrig_emulate("pelco-d", "heads=2", "--seconds", "0.2", "--json")
    first, last = (json.loads(line) for line in done.out.splitlines())
    assert done.code == 0
    assert first["emulator"] == "pelco-d"
    assert first["port"].endswith("/pelco-d")
    assert last["seconds"] >= 0.2
    assert last["state"].startswith("head1 (address 1): pan +0.00 deg")


def test_the_drone_gives_a_url(camrig_emulate: Callable[..., Done]) -> None:
    done = camrig_emulate(
        "drone", "release=4.6", "script=at 9 reboot; from 1 to 2 wind 3", "--seconds", "0.2", "--json"
    )
    assert done.code == 0
    assert json.loads(done.out.splitlines()[0])["port"].startswith("udpout://127.0.0.1:")
    done = camrig_emulate("drone", "flavour=px4", "transport=tcp", "figures=measured", "--seconds", "0.2", "--json")
    assert json.loads(done.out.splitlines()[0])["port"].startswith("tcp://127.0.0.1:")


@pytest.mark.parametrize(("device", "key"), [("pelco-d", "reply_latency_s"), ("drone", "figures")])
def test_its_settings_are_listed(camrig_emulate: Callable[..., Done], device: str, key: str) -> None:
    done = camrig_emulate(device, "--settings")
    assert done.code == 0
    assert key in done.out


@pytest.mark.parametrize(
    ("arguments", "messages"),
    [
        (["toaster"], ["no driver 'toaster' among the installed emulators; installed: drone, pelco-d, visca"]),
        (
            ["pelco-d", "address=300", "bad=1"],
            ["address: input should be less than or equal to 254; got 300", "unknown"],
        ),
        (["pelco-d", "adress=3"], ["did you mean 'address'?"]),
        (["pelco-d", "address"], ["'address' is no setting: write KEY=VALUE"]),
        (["pelco-d", "address=["], ["'address=[': the value is no YAML"]),
        (["pelco-d", "start_pan_deg=171"], ["start_pan_deg 171 is outside pan_limits_deg -170 to 170"]),
        (["visca", "address=5", "heads=4"], ["4 heads from address 5 upwards go beyond 7"]),
        (["visca", "transport=udp", "heads=2"], ["transport udp carries one head"]),
        (["drone", "transport=serial", "port=5760"], ["a serial port has no number: leave out port"]),
        (["drone", "target=tcp://x"], ["target: 'tcp://x' is no host:port"]),
        (["drone", "release=4.4"], ["release 4.4 of ardupilot is not emulated; there are 4.5, 4.6, 4.7"]),
        (["drone", "params={EKF2_EV_CTRL: 1}"], ["ardupilot has no emulated parameter EKF2_EV_CTRL"]),
        (["drone", "script=at 5 boom"], ["'at 5 boom': 'boom' is none of battery, clear"]),
        (["pelco-d", "address=250", "heads=9"], ["9 heads from address 250 upwards go beyond 254"]),
    ],
)
def test_mistakes_get_a_sentence_and_exit_2(
    camrig_emulate: Callable[..., Done], arguments: list[str], messages: list[str]
) -> None:
    done = camrig_emulate(*arguments)
    assert done.code == 2
    assert done.out == ""
    for message in messages:
        assert message in " ".join(done.err.split())
