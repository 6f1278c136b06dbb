"""Pictures of a board taken by a camera of the rig while somebody holds it; the terminal says what to do next."""

from __future__ import annotations

import math

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from camrig.calibrate.boards import AprilGrid, Board, board_word, scaled
from camrig.calibrate.find_boards import find_board
from camrig.calibrate.live import MOST, Collector
from camrig.calibrate.recognise import recognise
from camrig.calibrate.shots import CELLS, Shot, edge_width_px
from camrig.cli.board_shots import BoardShots, tag_detector
from camrig.cli.console import people
from camrig.clock import Clock, RealClock
from camrig.config.rig_file import RigConfig
from camrig.errors import EndOfInput, HardwareError, InputError
from camrig.interfaces import Camera
from camrig.messages import Frame
from camrig.runtime.build import make_devices
from camrig.runtime.steady_focus import check_focus

_PATIENCE_S = 5.0
_BOARD_S = 60.0
"""How long to wait for a board, and for the next picture of it."""
_REAL_CLOCK = RealClock()


def live_shots(
    config: RigConfig, camera: str, board: Board | None, square_m: float | None, *, hidden: bool
) -> BoardShots:
    """Take pictures with a camera of the rig. Raises InputError where it focuses by itself, or the rig is emulated;
    HardwareError where it gives no pictures.
    """
    if config.world is not None:
        raise InputError("the cameras of an emulated rig are there only while it runs: use --from-images")
    device: Camera = make_devices(config, "cameras")[camera]
    try:
        device.open()
        check_focus(config, camera)
        return collect(device, config.rig.cameras[camera].lens.size_px, board, square_m, hidden=hidden)
    finally:
        device.close()


def collect(
    camera: Camera,
    size_px: tuple[int, int],
    board: Board | None,
    square_m: float | None,
    *,
    hidden: bool,
    clock: Clock = _REAL_CLOCK,
) -> BoardShots:
    """Take pictures with an open camera until they are enough, or its input ends.

    Raises HardwareError where no picture comes, InputError where no board does.
    """
    screen = None if hidden or not people.is_terminal else people
    with Live(
        Text("looking for a board"), console=screen or Console(quiet=True), transient=True, auto_refresh=False
    ) as shown:
        known = board or _recognised(camera, square_m, clock)
        tags = tag_detector() if isinstance(known, AprilGrid) else None
        collector = Collector(known, size_px)
        deadline_s = clock.now_s() + _BOARD_S
        while not collector.is_enough:
            frame = _next(camera)
            if frame is None:
                break
            view = find_board(frame.image, known, tags)
            edge_px = math.inf if view is None else edge_width_px(frame.image, view, known)
            if collector.take(view, edge_px, frame.stamp_s):
                deadline_s = clock.now_s() + _BOARD_S
            elif clock.now_s() > deadline_s:
                break
            shown.update(_panel(collector), refresh=True)
    if not collector.shots:
        raise InputError(f"no picture of {board_word(known)} was taken: {collector.says}")
    return BoardShots(known, size_px, tuple(collector.shots), (), ())


def _next(camera: Camera) -> Frame | None:
    """Return the next frame, None where the input has ended."""
    try:
        frame = camera.read(_PATIENCE_S)
    except EndOfInput:
        return None
    if frame is None:
        raise HardwareError(f"the camera gave no picture within {_PATIENCE_S:.0f} s")
    return frame


def _recognised(camera: Camera, square_m: float | None, clock: Clock) -> Board:
    deadline_s = clock.now_s() + _BOARD_S
    while clock.now_s() < deadline_s and (frame := _next(camera)) is not None:
        board = recognise([frame.image])
        if board is not None:
            return board if square_m is None else scaled(board, square_m)
    raise InputError(f"no board was recognised within {_BOARD_S:.0f} s: hold it nearer, or name it with --board")


def _panel(collector: Collector) -> Group:
    covered = collector.gauges
    fit = collector.fit
    lines = [
        f"next: {collector.next_pose}",
        f"pictures {_bar(len(collector.shots) / MOST)} {len(collector.shots)}",
        f"coverage {_bar(covered.coverage)} {100.0 * covered.coverage:.0f} %",
        f"tilts    {_bar(covered.sides / 4.0)} to {covered.sides} of 4 sides",
        f"sizes    {_bar((covered.size_ratio - 1.0) / 0.4)} 1 : {covered.size_ratio:.1f}",
    ]
    if fit is not None and collector.sigmas_px:
        lines.append(f"focal length {fit.numbers[0]:.1f} ± {collector.sigmas_px[-1]:.2f} px, rms {fit.rms_px:.2f} px")
    return Group(Text(collector.says, style="bold"), Text("\n".join(lines)), _map(collector.shots, collector.size_px))


def _bar(share: float, width: int = 20) -> str:
    full = round(width * min(max(share, 0.0), 1.0))
    return "█" * full + "·" * (width - full)


def _map(shots: list[Shot], size_px: tuple[int, int]) -> Text:
    """Draw the picture's cells, full where the board was."""
    columns, rows = CELLS
    seen = {
        (min(int(y * rows / size_px[1]), rows - 1), min(int(x * columns / size_px[0]), columns - 1))
        for shot in shots
        for x, y in shot.view.corners_px
    }
    return Text(
        "\n".join("".join("██" if (row, column) in seen else "··" for column in range(columns)) for row in range(rows))
    )
