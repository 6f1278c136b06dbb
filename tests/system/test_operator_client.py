"""The operator's end of the socket: which daemon is meant, and what becomes of its answers."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from camrig.errors import HardwareError, InputError, PartialError
from camrig.runtime.operator_client import ask, find_socket
from camrig.runtime.operator_socket import claimed
from tests.operator_desk import Desk, serving_at


def test_the_only_daemon_need_not_be_named(socket_folder: Path) -> None:
    with pytest.raises(HardwareError, match=r"no camrig daemon is running .*start one with 'camrig run'"):
        find_socket(None, [socket_folder])
    with serving_at(socket_folder, Desk().operator()) as path:
        (socket_folder / "stale.sock").touch()
        assert find_socket(None, [socket_folder]) == path
        assert find_socket("lab", [socket_folder]) == path
        with pytest.raises(HardwareError, match=r"no daemon runs rig 'attic' .*; running: lab"):
            find_socket("attic", [socket_folder])
        with serving_at(socket_folder, Desk().operator(), "second") as second:
            assert find_socket("second", [socket_folder]) == second
            with pytest.raises(InputError, match=r"several rigs are running \(lab, second\): name one with --rig"):
                find_socket(None, [socket_folder])


def test_an_answer_that_is_an_error_is_raised_as_what_it_was(socket_folder: Path) -> None:
    desk = Desk(failing={"pt1": "port went away"})
    with serving_at(socket_folder, desk.operator()) as path:
        with pytest.raises(PartialError, match="pt1: port went away"):
            ask(path, {"command": "hold"})
        with pytest.raises(InputError, match="its drones are d1"):
            ask(path, {"command": "arm", "drone": "d2"})


@pytest.mark.parametrize(
    ("answer", "says"),
    [(None, "did not answer within 0.2 s"), (b"", "no daemon answers"), (b"{}\n", "another language")],
)
def test_what_is_no_daemon_is_named(socket_folder: Path, answer: bytes | None, says: str) -> None:
    with claimed("lab", socket_folder) as listener:
        listener.listen()
        accept: Callable[[], tuple[socket.socket, object]] = listener.accept

        def pretend() -> None:
            channel, _ = accept()
            with channel:
                channel.recv(4096)
                if answer is None:
                    channel.recv(1)  # until the client gives up
                else:
                    channel.sendall(answer)

        thread = threading.Thread(target=pretend)
        thread.start()
        with pytest.raises(HardwareError, match=says):
            ask(socket_folder / "lab.sock", {"command": "status"}, timeout_s=0.2 if answer is None else 5.0)
        thread.join()
