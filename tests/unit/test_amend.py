"""Single values of a hand-written file changed: the rest stays, and what is read afterwards is what was meant."""

import copy
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from camrig.config.amend import amend_rig, amended, check_amendable
from camrig.config.kept_file import former, replace, write
from camrig.errors import InputError

EXAMPLE = Path(__file__).parents[2] / "configs" / "demo.yaml"
HAND_WRITTEN = """\
# our lab
rig: lab       # since May
lenses:
  lab: {model: brown, fx: 800,  # printed on it
        size_px: [640, 480]}
  wide:          # borrowed
    fx: 400
    # fy to be found

    note: |
      two
      lines
heads:
- id: pt1       # left
  axes:
    pan: {sign: -1, scale: 1.0,}
- {id: pt2, axes: {}}
empty:
shared: &twice {a: 1}
again: *twice
merged:
  <<: *twice
  b: *twice
around: {named: &alone 1, inner: &inner {deep: {x: 1}}}
merges: {<<: [*inner]}
block: &block
  key: 1
last: [1, 2]   # end"""


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        (("rig",), "hall", "rig: hall       # since May"),
        (("lenses", "lab", "fx"), 827.7, "  lab: {model: brown, fx: 827.7,  # printed on it"),
        (("lenses", "lab", "fy"), 827.9, "        size_px: [640, 480], fy: 827.9}"),
        (("lenses", "wide", "fx"), 401, "    fx: 401"),
        (("lenses", "wide", "fy"), 402, "    fy: 402"),
        (("lenses", "wide"), {"fx": 1}, "  wide: {fx: 1}"),
        (("lenses", "tele"), {"fx": 1}, "  tele: {fx: 1}"),
        (("heads", "pt1", "axes", "pan", "offset_deg"), -3.5, "    pan: {sign: -1, scale: 1.0, offset_deg: -3.5}"),
        (("heads", "pt1", "axes", "tilt", "sign"), 1, "    tilt: {sign: 1}"),
        (("heads", "pt1", "port"), "/dev/x", "  port: /dev/x"),
        (("heads", "pt2", "axes", "pan"), {"sign": 1}, "- {id: pt2, axes: {pan: {sign: 1}}}"),
        (("heads", 2), {"id": "pt3"}, "- {id: pt3}"),
        (("empty",), 3, "empty: 3"),
        (("empty", "key"), 3, "empty: {key: 3}"),
        (("merged", "a"), 2, "  a: 2"),
        (("block", "new"), 3, "  new: 3"),
        (("last", 0), 7, "last: [7, 2]   # end"),
        (("last", 2), 3, "last: [1, 2, 3]   # end"),
        (("items", 0), {"id": 1}, "items: [{id: 1}]"),
        (("new", "key"), [1.5, None, "a: b"], "new: {key: [1.5, null, 'a: b']}"),
    ],
)
def test_one_place_changes_and_the_rest_stays(path: tuple[str | int, ...], value: Any, line: str) -> None:
    text = amended(HAND_WRITTEN, {path: value})

    assert line in text.splitlines()
    assert yaml.safe_load(text) == _with(yaml.safe_load(HAND_WRITTEN), path, value)
    gone = set(HAND_WRITTEN.splitlines()) - set(text.splitlines())
    assert len(gone) <= (8 if path == ("lenses", "wide") else 1)


@pytest.mark.parametrize(
    ("path", "about"),
    [
        (("again", "a"), "shared"),
        (("merged", "b"), "shared"),
        (("heads", "pt9", "port"), "no such place"),
        (("rig", "name"), "no such place"),
        (("last", 5), "no such place"),
        (("shared", "a"), "line 19"),
        (("shared",), "line 19"),
        (("around",), "shared"),
        (("around", "named"), "&anchor, which would be lost"),
        (("around", "inner", "deep", "x"), "shared"),
        (("merges", "deep", "x"), "merged from elsewhere"),
    ],
)
def test_a_place_that_is_not_there_is_named(path: tuple[str | int, ...], about: str) -> None:
    with pytest.raises(InputError, match=about):
        amended(HAND_WRITTEN, {path: 1})


def test_one_head_does_not_change_another_through_its_anchor() -> None:
    text = "heads: [&pt {id: pt1, axes: {pan: {sign: 1}}}, {<<: *pt, id: pt2}]\n"

    for head in ("pt1", "pt2"):
        with pytest.raises(InputError, match=f"heads.{head}.axes.pan.sign: stands in what is"):
            amended(text, {("heads", head, "axes", "pan", "sign"): -1})


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text("ab: #'\"{}[],&*-?|>%@é\n", max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc: #-", max_size=3), inner, max_size=3),
    max_leaves=6,
)


@given(
    data=st.dictionaries(st.sampled_from("abcdef"), VALUES, min_size=1, max_size=4),
    flow=st.sampled_from([None, True, False]),
    steps=st.lists(st.integers(0, 3), max_size=3),
    value=VALUES,
)
def test_what_is_read_is_what_was_meant(data: dict[str, Any], flow: bool | None, steps: list[int], value: Any) -> None:
    path, inside = list[Any](), data
    for step in steps:
        keys: list[Any] = (
            [*inside] if isinstance(inside, dict) else [*range(len(inside))] if isinstance(inside, list) else []
        )
        keys += ["new"] if isinstance(inside, dict) else []
        if not keys:
            break
        path.append(keys[step % len(keys)])
        if path[-1] == "new":
            break
        inside = inside[path[-1]]
    if not path:
        return

    text = amended(
        yaml.safe_dump(data, default_flow_style=flow, sort_keys=False, allow_unicode=True), {tuple(path): value}
    )

    assert yaml.safe_load(text) == _with(data, tuple(path), value)


def test_a_rig_is_amended_through_its_link_and_its_former_version_kept(tmp_path: Path) -> None:
    real, link = tmp_path / "real.yaml", tmp_path / "rig.yaml"
    real.write_text(EXAMPLE.read_text())
    real.chmod(0o640)
    link.symlink_to(real)

    amend_rig(link, {("lenses", "lab", "fx"): 1201.5, ("heads", "pt1", "position_m"): [0.5, 4.25, 2.8]})

    assert link.is_symlink()
    assert "fx: 1201.5" in real.read_text()
    assert real.stat().st_mode & 0o777 == 0o640
    assert former(real).read_text() == EXAMPLE.read_text()


def test_what_would_not_load_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(EXAMPLE.read_text())

    with pytest.raises(InputError, match=r"left as it is.*\n.*fx"):
        amend_rig(path, {("lenses", "lab", "fx"): -1.0})

    assert path.read_text() == EXAMPLE.read_text()
    assert [*tmp_path.iterdir()] == [path]


def test_a_folder_that_may_not_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write(tmp_path / "none" / "rig.yaml", "rig: a\n")


def test_a_file_that_nobody_may_write_stays_even_for_root(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("rig: a\n")
    path.chmod(0o444)

    with pytest.raises(InputError, match=r"rig\.yaml cannot be written: it is read-only"):
        write(path, "rig: b\n")
    with pytest.raises(InputError, match=r"rig\.yaml cannot be written: it is read-only"):
        replace(path, b"rig: b\n")

    assert path.read_text() == "rig: a\n"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_a_file_stays_its_owners(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("rig: a\n")
    os.chown(path, 1234, 1235)

    write(path, "rig: b\n")

    for each in (path, former(path)):
        assert (each.stat().st_uid, each.stat().st_gid) == (1234, 1235)


def test_whether_a_file_takes_changes_is_known_before(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("a: &a {b: 1}\nc: *a\nd: [1]\n")

    check_amendable(path, [("d", 1), ("new", "key")])
    with pytest.raises(InputError, match=r"rig\.yaml cannot take what --write would set: a\.b"):
        check_amendable(path, [("a", "b")])
    path.chmod(0o444)
    with pytest.raises(InputError, match="read-only"):
        check_amendable(path, [("d", 1)])


WRITER = """
import sys
from pathlib import Path
from camrig.config.kept_file import write
print("on", flush=True)
for k in range(10**9):
    write(Path(sys.argv[1]), f"{k}\\n" * 20_000)
"""


def test_a_kill_at_any_moment_leaves_whole_files(tmp_path: Path) -> None:
    path, rng = tmp_path / "rig.yaml", np.random.default_rng(1)
    for _ in range(100):
        with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.03))
            os.kill(writer.pid, signal.SIGKILL)
        for each in (path, former(path)):
            lines = each.read_text().splitlines() if each.exists() else []
            assert len(lines) in {0, 20_000}
            assert len({*lines}) <= 1


def _with(data: Any, path: tuple[str | int, ...], value: Any) -> Any:
    data = copy.deepcopy(data)
    inside = data
    for place, step in enumerate(path):
        key = step if not isinstance(inside, list) or isinstance(step, int) else _index(inside, step)
        if place == len(path) - 1:
            if isinstance(inside, list) and key == len(inside):
                inside.append(value)
            else:
                inside[key] = value
        else:
            if isinstance(inside, dict) and inside.get(key) is None:
                inside[key] = [] if path[place + 1] == 0 else {}
            inside = inside[key]
    return data


def _index(items: list[Any], name: str) -> int:
    return next(k for k, item in enumerate(items) if item["id"] == name)
