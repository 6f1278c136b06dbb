"""The operator's end of the socket: find the daemon of a rig, and ask it. See operator_socket for the protocol."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from camrig.errors import CamrigError, HardwareError, InputError, PartialError
from camrig.runtime.operator_socket import SYSTEM_FOLDER, is_trusted, runtime_folder, socket_path

ANSWER_TIMEOUT_S = 5.0
_ERRORS: dict[object, type[CamrigError]] = {kind.exit_code: kind for kind in (InputError, HardwareError, PartialError)}


def find_socket(rig: str | None, folders: Iterable[Path] | None = None) -> Path:
    """Return the socket of the running daemon of ``rig``, or of the only one that runs on this host.

    Raises HardwareError where there is none, InputError where several run and none is named.
    """
    places = list(dict.fromkeys(folders or (runtime_folder(), SYSTEM_FOLDER)))
    running = [
        path for folder in places if is_trusted(folder) for path in sorted(folder.glob("*.sock")) if _answers(path)
    ]
    looked = " and ".join(map(str, places))
    if rig is not None:
        wanted = {socket_path(folder, rig) for folder in places}
        found = [path for path in running if path in wanted]
        if not found:
            others = f"; running: {_names(running)}" if running else ""
            raise HardwareError(f"no daemon runs rig '{rig}' (looked in {looked}){others}; start it with 'camrig run'")
        return found[0]
    if not running:
        raise HardwareError(f"no camrig daemon is running (looked in {looked}); start one with 'camrig run'")
    if len(running) > 1:
        raise InputError(f"several rigs are running ({_names(running)}): name one with --rig")
    return running[0]


def ask(path: Path, request: Mapping[str, object], timeout_s: float = ANSWER_TIMEOUT_S) -> dict[str, object]:
    """Send one request and return its answer without ``ok``; an error in it is raised as the CamrigError it was.

    Raises HardwareError where nothing answers within ``timeout_s`` and InputError where this user may not ask.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
            channel.settimeout(timeout_s)
            channel.connect(str(path))
            with suppress(BrokenPipeError):  # refused before it was asked: the answer that says so is there to be read
                channel.sendall(json.dumps(request).encode() + b"\n")
            with channel.makefile("rb") as lines:
                line = lines.readline()
        answer: object = json.loads(line)
    except TimeoutError as error:
        raise HardwareError(f"the daemon at {path} did not answer within {timeout_s:g} s; look at its log") from error
    except PermissionError as error:
        raise InputError(
            f"{path} may be used by the daemon's user and group alone: join the group, or be root"
        ) from error
    except (OSError, ValueError) as error:  # an empty line is no JSON: the connection ended
        raise HardwareError(
            f"no daemon answers at {path}; start one with 'camrig run', or wait until it is up"
        ) from error
    return _content(answer, path)


def _content(answer: object, path: Path) -> dict[str, object]:
    match answer:
        case {"ok": True, **content}:
            return {str(key): value for key, value in content.items()}
        case {"ok": False, "error": str(text), "exit_code": code}:
            raise _ERRORS.get(code, HardwareError)(text)
    raise HardwareError(f"{path} is no camrig daemon's: it answered in another language")


def _answers(path: Path) -> bool:
    """Tell whether somebody listens there, even if not to this user."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
        channel.settimeout(ANSWER_TIMEOUT_S)
        try:
            channel.connect(str(path))
        except PermissionError:
            return True
        except OSError:
            return False
    return True


def _names(paths: Iterable[Path]) -> str:
    return ", ".join(path.stem for path in paths)
