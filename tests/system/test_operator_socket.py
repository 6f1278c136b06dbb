"""The operator's socket over real sockets and processes: who gets in, what strangers can do to it, whose it is."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from camrig.errors import HardwareError, InputError
from camrig.runtime.operator_client import ask
from camrig.runtime.operator_server import MAX_CLIENTS, Peer, serving
from camrig.runtime.operator_socket import MAX_LINE_BYTES, claimed, runtime_folder, socket_path
from tests.operator_desk import Desk, rig, serving_at

STATUS = b'{"command": "status"}\n'
PROMPT_S = 1.0
"""Far more than an answer takes, far less than any time-out."""


@contextmanager
def connected(path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX) as channel:
        channel.settimeout(5.0)
        channel.connect(str(path))
        yield channel


def lines(channel: socket.socket) -> list[dict[str, object]]:
    """Return every answer up to the connection's end."""
    received = b""
    with suppress(ConnectionResetError):  # ended with some of what we sent unread: the answers came before
        while data := channel.recv(65536):
            received += data
    return [json.loads(line) for line in received.splitlines()]


def served(path: Path) -> bool:
    began_s = time.monotonic()
    return ask(path, {"command": "status"})["rig"] == "lab" and time.monotonic() < began_s + PROMPT_S


# --- whose socket it is ---------------------------------------------------------------------------------------


def test_the_socket_is_for_its_user_and_group_and_is_gone_afterwards(socket_folder: Path) -> None:
    with serving_at(socket_folder, Desk().operator()) as path:
        mode = path.stat().st_mode
        assert stat.S_ISSOCK(mode)
        assert stat.S_IMODE(mode) == 0o660
        assert not socket_folder.stat().st_mode & stat.S_IRWXO
        assert served(path)
    assert not path.exists()
    with serving_at(socket_folder, Desk().operator()) as path:
        assert served(path)


def test_a_second_daemon_is_refused_by_name_and_leaves_the_first_alone(socket_folder: Path) -> None:
    with serving_at(socket_folder, Desk().operator()) as path:
        says = rf"rig 'lab' is already run .* process {os.getpid()}: stop"
        with pytest.raises(HardwareError, match=says), claimed("lab", socket_folder):
            pytest.fail("two daemons have one rig")
        assert served(path)
        with serving_at(socket_folder, Desk(rig=rig("other")).operator(), "other") as other:
            assert ask(other, {"command": "status"})["rig"] == "other"


def test_what_a_killed_daemon_leaves_is_replaced(socket_folder: Path) -> None:
    script = (
        "import sys, pathlib, camrig.runtime.operator_socket as s\n"
        "with s.claimed('lab', pathlib.Path(sys.argv[1])) as listener: print(flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", script, str(socket_folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        try:
            with pytest.raises(HardwareError, match=f"process {holder.pid}"), claimed("lab", socket_folder):
                pytest.fail("the holder still lives")
        finally:
            holder.kill()
    assert (socket_folder / "lab.sock").is_socket()
    with pytest.raises(HardwareError, match="no daemon answers"):
        ask(socket_folder / "lab.sock", {"command": "hold"})
    with serving_at(socket_folder, Desk().operator()) as path:
        assert served(path)


@pytest.mark.parametrize("name", ["a/b", "", "..", ".hidden", "a\nb", "x" * 200])
def test_a_name_that_no_socket_can_have_is_refused_before_anything_is_made(socket_folder: Path, name: str) -> None:
    with pytest.raises(InputError), claimed(name, socket_folder):
        pytest.fail("claimed")
    assert not socket_folder.exists()


def test_a_folder_that_others_may_write_is_not_used(socket_folder: Path) -> None:
    socket_folder.mkdir()
    socket_folder.chmod(0o777)
    with pytest.raises(InputError, match="not a folder of this user alone"), claimed("lab", socket_folder):
        pytest.fail("claimed")
    socket_folder.rmdir()
    elsewhere = socket_folder.with_name("elsewhere")
    elsewhere.mkdir()
    socket_folder.symlink_to(elsewhere)
    with pytest.raises(InputError, match="not a folder of this user alone"), claimed("lab", socket_folder):
        pytest.fail("claimed")
    with pytest.raises(InputError, match="No such file"), claimed("lab", socket_folder / "absent" / "deep"):
        pytest.fail("claimed")


def test_the_folder_is_systemds_or_the_sessions_or_one_in_tmp() -> None:
    session = {"XDG_RUNTIME_DIR": "/run/user/7"}
    assert runtime_folder({**session, "RUNTIME_DIRECTORY": "/run/camrig:/run/more"}) == Path("/run/camrig")
    assert runtime_folder(session) == Path("/run/user/7/camrig")
    assert runtime_folder({}) == Path(f"/tmp/camrig-{os.geteuid()}")
    assert socket_path(Path("/run/camrig"), "lab a-1.2") == Path("/run/camrig/lab a-1.2.sock")


# --- who gets in ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("peer", "allowed"),
    [
        (Peer(1, 0, frozenset({0})), True),
        (Peer(1, 500, frozenset({100})), True),
        (Peer(1, 501, frozenset({101, 44})), True),
        (Peer(1, 501, frozenset({101})), False),
    ],
)
def test_root_the_daemons_user_and_its_group_may_command(peer: Peer, allowed: bool) -> None:
    assert peer.may_command(500, 44) is allowed


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be somebody else")
@pytest.mark.parametrize(("groups", "allowed"), [([], False), ([os.getegid()], True)])
def test_a_stranger_is_told_so_and_a_member_of_the_group_is_not(
    socket_folder: Path, groups: list[int], allowed: bool
) -> None:
    script = """\
import contextlib, os, socket, sys
channel = socket.socket(socket.AF_UNIX)
os.setgroups([int(group) for group in sys.argv[2:]])
os.setgid(65534)
os.setuid(65534)
channel.connect(sys.argv[1])
with contextlib.suppress(BrokenPipeError):
    channel.sendall(b'{"command": "hold"}\\n')
print(channel.makefile().readline())
"""
    desk = Desk()
    with serving_at(socket_folder, desk.operator()) as path:
        socket_folder.chmod(0o755)
        path.chmod(0o666)  # what the mode lets in, the credentials must still keep out
        command = [sys.executable, "-c", script, str(path), *map(str, groups)]
        done = subprocess.run(command, stdout=subprocess.PIPE, timeout=20, check=True)
    answer = json.loads(done.stdout)
    assert answer["ok"] is allowed
    assert desk.done == ([("hold", ())] if allowed else [])
    assert allowed or "user 65534 may not command this rig" in answer["error"]


# --- what strangers can do to it ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "garbage",
    [
        b"hello\n",
        b"\n",
        b"\xff\xfe\x00\n",
        b"[1, 2]\n",
        b"3" * 5000 + b"\n",
        b"[" * 20000 + b"\n",
        b'{"command": "hold"' + b" " * MAX_LINE_BYTES + b"}\n",
        b"x" * (MAX_LINE_BYTES + 1),
    ],
    ids=["word", "nothing", "binary", "list", "huge number", "deep", "long line", "endless line"],
)
def test_garbage_gets_one_line_and_the_end(socket_folder: Path, garbage: bytes) -> None:
    desk = Desk()
    with serving_at(socket_folder, desk.operator()) as path:
        with connected(path) as channel:
            channel.sendall(garbage)
            with suppress(BrokenPipeError):
                channel.sendall(b'{"command": "hold"}\n')
            answers = lines(channel)
        assert [answer["exit_code"] for answer in answers] == [2]
        assert served(path)
    assert desk.done == []


def test_a_wrong_command_is_answered_and_the_connection_goes_on(socket_folder: Path) -> None:
    with serving_at(socket_folder, Desk().operator()) as path, connected(path) as channel:
        channel.sendall(b'{"command": "fly"}\n' + STATUS)
        channel.shutdown(socket.SHUT_WR)
        assert [answer["ok"] for answer in lines(channel)] == [False, True]


def test_requests_in_pieces_and_in_heaps_are_answered_in_order(socket_folder: Path) -> None:
    desk = Desk()
    orders = [{"command": "resume", "heads": [f"pt{1 + number % 2}"]} for number in range(300)]
    with serving_at(socket_folder, desk.operator()) as path, connected(path) as channel:
        sent = b"".join(json.dumps(order).encode() + b"\n" for order in orders)
        for start in range(0, len(sent), 997):
            channel.sendall(sent[start : start + 997])
        channel.shutdown(socket.SHUT_WR)
        assert [answer["heads"] for answer in lines(channel)] == [order["heads"] for order in orders]
    assert len(desk.done) == len(orders)


def test_who_sends_much_and_reads_nothing_delays_nobody(socket_folder: Path) -> None:
    with serving_at(socket_folder, Desk().operator()) as path, connected(path) as greedy, connected(path) as slow:
        slow.sendall(b'{"command"')
        greedy.setblocking(False)
        with suppress(BlockingIOError):  # until every buffer on the way is full
            while True:
                greedy.send(STATUS * 500)
        assert served(path)
        assert ask(path, {"command": "hold"})["heads"] == ["pt1", "pt2"]


def test_who_hoards_connections_keeps_nobody_out(socket_folder: Path) -> None:
    with serving_at(socket_folder, Desk().operator()) as path, ExitStack() as stack:
        hoard = [stack.enter_context(connected(path)) for _ in range(MAX_CLIENTS)]
        hoard[0].sendall(STATUS)
        assert hoard[0].recv(4096)
        assert served(path)
        assert hoard[1].recv(1) == b""  # the one that was quiet longest had to go
        hoard[0].sendall(STATUS)
        assert hoard[0].recv(4096)


def test_a_failure_in_the_handler_is_a_bug_that_ends_the_daemon(socket_folder: Path) -> None:
    class Broken(Desk):
        def rescan(self) -> None:
            raise RuntimeError("a bug")

    asked = threading.Event()

    def run() -> None:
        with claimed("lab", socket_folder) as listener, serving(listener, Broken().operator(), asked.set):
            with pytest.raises(HardwareError, match="no daemon answers"):
                ask(socket_folder / "lab.sock", {"command": "scan"})
            assert asked.wait(5.0)

    with pytest.raises(RuntimeError, match="a bug"):
        run()
