"""The rig drawn in a terminal: every target where it is, nothing beyond its width, whatever is known."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation
from camrig.geometry.pose import transform
from camrig.messages import CameraPose, LinkStatus, TargetStatus
from camrig.report.terminal_map import COLUMNS, ROWS, SHADES, RigSnapshot, floor_map, rig_view
from camrig.rig import Anchor, Space, TagKey
from tests.runtime_parts import one_head_rig, target

LOST, UNSEEN = TargetStatus.LOST, TargetStatus.UNSEEN


def looking(pan_deg: float, tilt_deg: float, x: float = 2.5) -> CameraPose:
    R = aim_rotation(math.radians(pan_deg), math.radians(tilt_deg)) @ R_MOUNT_OPTICAL
    return CameraPose("north", 0.0, transform(R, np.array([x, 1.5, 2.8])), np.zeros((6, 6)))


def snapshot() -> RigSnapshot:
    anchor = Anchor(TagKey("tag36h11", 100), 0.2, transform(np.eye(3), np.array([4.6, 2.7, 0.0])))
    return RigSnapshot(
        rig=replace(one_head_rig(), anchors=(anchor,)),
        targets=(
            target("robot1", (1.0, 2.0, 0.1)),
            target("robot2", (4.0, 0.5, 0.1), LOST),
            target("robot3", status=UNSEEN),
        ),
        truth={"robot1": np.array([1.0, 2.03, 0.1]), "robot2": np.array([3.0, 1.0, 0.1])},
        camera_poses={"north": looking(0.0, -90.0)},
        links={"north": LinkStatus.UP, "pt1": LinkStatus.LOST},
        plan=None,
        status="tracking: 1 of 3 targets; lost: pt1",
    )


def rows(picture: RigSnapshot) -> list[str]:
    return floor_map(picture).plain.splitlines()


def drawn(picture: RigSnapshot, width: int) -> list[str]:
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    console.print(rig_view(picture, "camrig demo"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_the_map_has_the_floors_shape() -> None:
    found = rows(snapshot())
    assert {len(row) for row in found} == {COLUMNS}
    assert len(found) == round(COLUMNS * 3.0 / 5.0 / 2.0)  # a character is twice as high as it is wide


@pytest.mark.parametrize(("size_m", "columns", "high"), [((2.0, 12.0), 11, ROWS), ((40.0, 1.0), COLUMNS, 8)])
def test_a_long_floor_still_fits_a_screen(size_m: tuple[float, float], columns: int, high: int) -> None:
    picture = snapshot()
    found = rows(replace(picture, rig=replace(picture.rig, space=Space(((0.0, 0.0), size_m)))))
    assert ({len(row) for row in found}, len(found)) == ({columns}, high)


def test_everything_stands_where_it_is_with_north_up() -> None:
    found = rows(snapshot())

    def near(x_m: float, y_m: float) -> str:
        column, row = math.floor(x_m / 5.0 * COLUMNS), math.floor((1.0 - y_m / 3.0) * len(found))
        return "".join(line[column - 1 : column + 2] for line in found[row - 1 : row + 2])

    assert "1" in near(1.0, 2.0)
    assert "2" in near(4.0, 0.5)
    assert "o" in near(3.0, 1.0)
    assert "#" in near(4.6, 2.7)
    assert "N" in near(2.5, 1.5)
    assert "3" not in "".join(found)  # it was never seen: it is nowhere


def test_a_target_is_green_while_it_is_tracked_and_red_once_it_is_lost() -> None:
    drawn_text = floor_map(snapshot())
    styles = {drawn_text.plain[span.start : span.end]: span.style for span in drawn_text.spans}
    assert (styles["1"], styles["2"]) == ("bold green", "bold red")


def test_what_lies_outside_the_floor_is_not_drawn() -> None:
    picture = replace(
        snapshot(),
        targets=(target("robot1", (-3.0, 2.0, 0.1)),),
        truth={},
        camera_poses={"north": looking(0, -90, x=9)},
    )
    assert set("".join(rows(picture))) <= {" ", "#", "."}


@pytest.mark.parametrize(("count", "shade"), [(0, SHADES[0]), (1, SHADES[1]), (3, SHADES[3]), (7, SHADES[-1])])
def test_a_shade_says_how_many_cameras_see_a_place(count: int, shade: str) -> None:
    picture = replace(snapshot(), targets=(), truth={})
    camera = picture.rig.cameras["north"]
    names = [f"n{k}" for k in range(count)]
    rig = replace(picture.rig, anchors=(), cameras={name: replace(camera, id=name) for name in names})
    found = "".join(rows(replace(picture, rig=rig, camera_poses=dict.fromkeys(names, looking(0.0, -90.0)))))
    assert set(found) - {"N"} == {" ", shade}


def test_a_camera_that_sees_no_floor_shades_nothing() -> None:
    found = "".join(rows(replace(snapshot(), targets=(), truth={}, camera_poses={"north": looking(0.0, 60.0)})))
    assert set(found) == {" ", "#", "N"}


def test_the_table_tells_sigma_and_error_of_what_is_tracked_and_the_state_of_the_rest() -> None:
    found = "\n".join(drawn(snapshot(), 130))
    assert re.search(r"1 . robot1 . north +. 34\.6 +. 30\.0", found)
    assert re.search(r"2 . robot2 . lost ", found)
    assert re.search(r"3 . robot3 . unseen ", found)
    assert re.search(r"pt1 +. lost", found)
    assert "camrig demo" in found
    assert "tracking: 1 of 3 targets; lost: pt1" in found


@pytest.mark.parametrize("width", [40, 66, 80, 130, 200])
def test_it_stays_within_the_width_of_the_screen(width: int) -> None:
    found = drawn(snapshot(), width)
    assert {len(line) for line in found} == {width}
    assert sum("..." in line for line in found) == sum("..." in row for row in rows(snapshot()))  # no row is broken


def test_a_rig_of_which_nothing_is_known_is_drawn_too() -> None:
    empty = RigSnapshot(one_head_rig(), (), {}, {}, {}, None, "scanning: 0 of 3 targets")
    assert set("".join(rows(empty))) == {" "}
    assert drawn(empty, 80)
