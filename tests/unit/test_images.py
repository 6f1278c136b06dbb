"""Pictures from disk: which files, what is skipped, and when each is due."""

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from camrig import pictures
from camrig.clock import ManualClock
from camrig.errors import EndOfInput, HardwareError, InputError
from camrig.geometry.lens import BrownLens
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.images import ImagesCamera, ImagesSection

Damage = Callable[[bytes], bytes]

SPEC = CameraSpec("cam", BrownLens((64, 48), (60.0, 60.0), (31.5, 23.5)), FreeMount())


def write(folder: Path, *names: str, size_px: tuple[int, int] = (64, 48)) -> None:
    """Write pictures whose grey is their number in the list."""
    for number, name in enumerate(names):
        image = np.full((size_px[1], size_px[0]), number, np.uint8)
        assert cv2.imwrite(str(folder / name), image)


def write_video(path: Path, frames: int, size_px: tuple[int, int] = (64, 48)) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, size_px)
    for number in range(frames):
        writer.write(np.full((size_px[1], size_px[0], 3), 10 * number, np.uint8))
    writer.release()


def camera(path: Path | str, clock: ManualClock | None = None, **keys: object) -> ImagesCamera:
    section = ImagesSection.model_validate({"path": str(path), **keys})
    return ImagesCamera(SPEC, section, clock or ManualClock(100.0))


def all_frames(cam: ImagesCamera, clock: ManualClock, step_s: float = 0.05) -> list[Frame]:
    """Open and read to the end, the clock advancing where nothing is due."""
    frames: list[Frame] = []
    cam.open()
    for _ in range(1000):
        try:
            frame = cam.read(0.0)
        except EndOfInput:
            return frames
        if frame is None:
            clock.advance(step_s)
        else:
            frames.append(frame)
    raise AssertionError("no end of input")


class TestFiles:
    def test_a_folder_gives_its_pictures_in_the_order_of_their_numbers(self, tmp_path: Path) -> None:
        write(tmp_path, "f10.png", "f9.png", "f1.JPG")
        (tmp_path / "notes.txt").write_text("no picture")
        (tmp_path / "inner").mkdir()
        assert [path.name for path in pictures.find(str(tmp_path))] == ["f1.JPG", "f9.png", "f10.png"]

    def test_a_glob_and_a_single_file(self, tmp_path: Path) -> None:
        write(tmp_path, "a1.png", "a2.png", "b1.png")
        assert [path.name for path in pictures.find(f"{tmp_path}/a*.png")] == ["a1.png", "a2.png"]
        assert pictures.find(f"{tmp_path}/b1.png") == (tmp_path / "b1.png",)

    @pytest.mark.parametrize(
        ("place", "why"),
        [("", "holds no picture"), ("gone", "no such file or folder"), ("*.png", "no such file or folder")],
    )
    def test_a_place_without_pictures_is_refused(self, tmp_path: Path, place: str, why: str) -> None:
        with pytest.raises(InputError, match=why):
            pictures.find(str(tmp_path / place) if place else str(tmp_path))

    def test_an_unreadable_folder_is_refused(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(_path: Path) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "iterdir", refuse)  # a super-user may read every folder
        with pytest.raises(InputError, match="cannot be read: Permission denied"):
            pictures.find(str(tmp_path))

    def test_a_picture_is_decoded_as_it_is_stored_whatever_its_exif_orientation(self, tmp_path: Path) -> None:
        image = np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8)
        _, jpeg = cv2.imencode(".jpg", image)
        turned_90_deg = bytes.fromhex("4578696600004d4d002a00000008000101120003000000010006000000000000")
        exif = b"\xff\xe1" + (len(turned_90_deg) + 2).to_bytes(2, "big") + turned_90_deg
        path = tmp_path / "a.jpg"
        path.write_bytes(jpeg[:2].tobytes() + exif + jpeg[2:].tobytes())
        assert np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)).shape == (64, 48), "the tag is not understood"
        (picture,) = pictures.read([path])
        assert picture.image is not None
        assert picture.image.shape == (48, 64)

    def test_a_pipe_named_like_a_picture_or_video_does_not_block(self, tmp_path: Path) -> None:
        for name in ("a.png", "a.mp4"):
            os.mkfifo(tmp_path / name)
            (picture,) = pictures.read([tmp_path / name])
            assert picture.image is None

    @settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        suffix=st.sampled_from([".jpg", ".png", ".bmp", ".pgm", ".tif", ".webp"]),
        damage=st.one_of(
            st.binary(max_size=400).map(lambda junk: lambda _data: junk),
            st.integers(0, 95).map(lambda percent: lambda data: data[: len(data) * percent // 100]),
            st.binary(min_size=10, max_size=100).map(lambda junk: lambda data: data[:20] + junk),
        ),
    )
    def test_a_damaged_file_is_a_fault_in_words_and_never_an_exception(
        self, tmp_path: Path, suffix: str, damage: Damage
    ) -> None:
        image = np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8)
        data = cv2.imencode(suffix, image)[1].tobytes()
        path = tmp_path / f"a{suffix}"
        path.write_bytes(damage(data))
        (picture,) = pictures.read([path])
        assert (picture.image is None) == bool(picture.fault)
        if picture.image is not None:
            assert picture.image.ndim == 2

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".bmp", ".pgm", ".tif", ".webp"])
    @pytest.mark.parametrize("percent", [5, 50, 95])
    def test_a_file_that_ends_early_is_no_picture(self, tmp_path: Path, suffix: str, percent: int) -> None:
        image = np.random.default_rng(0).integers(0, 256, (480, 640), np.uint8)
        data = cv2.imencode(suffix, image)[1].tobytes()
        path = tmp_path / f"a{suffix}"
        path.write_bytes(data[: len(data) * percent // 100])
        (picture,) = pictures.read([path])
        assert picture.image is None
        assert picture.fault

    def test_a_header_that_promises_ten_gigapixels_is_a_fault(self, tmp_path: Path) -> None:
        (tmp_path / "a.pgm").write_bytes(b"P5 100000 100000 255\n" + bytes(100))
        (picture,) = pictures.read([tmp_path / "a.pgm"])
        assert picture.image is None


class TestTime:
    def test_frames_come_at_the_declared_rate_stamped_from_the_opening(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png", "2.png")
        clock = ManualClock(100.0)
        cam = camera(tmp_path, clock, fps=4.0)
        cam.open()
        first = cam.read(0.0)
        assert first is not None
        assert (first.stamp_s, first.sequence, first.source) == (100.0, 0, str(tmp_path / "0.png"))
        assert cam.read(0.0) is None
        clock.advance(0.24)
        assert cam.read(0.0) is None
        clock.advance(0.01)
        second = cam.read(0.0)
        assert second is not None
        assert (second.stamp_s, second.sequence, int(second.image[0, 0])) == (100.25, 1, 1)

    def test_a_slow_reader_gets_every_frame_with_its_own_stamp(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png", "2.png")
        clock = ManualClock(100.0)
        cam = camera(tmp_path, clock)
        cam.open()
        clock.advance(60.0)
        assert [frame.stamp_s for frame in (cam.read(0.0), cam.read(0.0), cam.read(0.0)) if frame] == pytest.approx(
            [100.0, 100.1, 100.2]
        )
        with pytest.raises(EndOfInput, match="read to its end"):
            cam.read(0.0)
        with pytest.raises(EndOfInput):
            cam.read(0.0)

    def test_a_loop_goes_on_in_time_and_numbers(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png")
        clock = ManualClock(100.0)
        cam = camera(tmp_path, clock, fps=2.0, loop=True)
        cam.open()
        clock.advance(10.0)
        frames = [frame for frame in (cam.read(0.0) for _ in range(5)) if frame]
        assert [frame.stamp_s for frame in frames] == [100.0, 100.5, 101.0, 101.5, 102.0]
        assert [frame.sequence for frame in frames] == [0, 1, 2, 3, 4]
        assert [int(frame.image[0, 0]) for frame in frames] == [0, 1, 0, 1, 0]

    def test_a_loop_over_stamps_waits_a_typical_step_between_rounds(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png", "2.png")
        (tmp_path / "stamps.txt").write_text("5.0\n5.5\n6.5\n")
        clock = ManualClock(0.0)
        cam = camera(tmp_path, clock, stamps=str(tmp_path / "stamps.txt"), loop=True)
        cam.open()
        clock.advance(60.0)
        assert [frame.stamp_s for frame in (cam.read(0.0) for _ in range(4)) if frame] == [0.0, 0.5, 1.5, 2.5]

    def test_stamps_by_name_may_stand_in_any_order_under_a_header(self, tmp_path: Path) -> None:
        write(tmp_path, "a.png", "b.png")
        (tmp_path / "stamps.csv").write_text("filename,seconds\nb.png,1000.75\na.png,1000.5\nunused.png,3\n")
        clock = ManualClock(0.0)
        frames = all_frames(camera(tmp_path, clock, stamps=str(tmp_path / "stamps.csv")), clock)
        assert [frame.stamp_s for frame in frames] == [0.0, 0.25]

    @pytest.mark.parametrize(
        ("text", "why"),
        [
            ("0.0\n", r"holds 1 stamps for 2 pictures"),
            ("0.0\n0.1\n0.2\n", r"holds 3 stamps for 2 pictures"),
            ("0.2\n0.1\n", r"stamps must ascend; picture 2 is 0.1 s before"),
            ("0.1\n0.1\n", r"stamps must ascend"),
            ("0.1\nsoon\n", r"stamps:2: 'soon' is no number"),
            ("0.1\nnan\n", r"'nan' is no number"),
            ("a.png,0.1\n", r"no stamp for b.png"),
            ("a.png,0.1\na.png,0.2\n", r"stamps:2: a.png stands twice"),
            ("a.png,0.1,7\nb.png,0.2,7\n", r"stamps:1: a line is 'filename,seconds'"),
            ("", r"holds no stamp"),
            ("seconds\n", r"holds no stamp"),
            ("\x00", r"stamp"),
        ],
    )
    def test_stamps_that_do_not_fit_are_refused(self, tmp_path: Path, text: str, why: str) -> None:
        write(tmp_path, "a.png", "b.png")
        (tmp_path / "stamps").write_text(text)
        with pytest.raises(InputError, match=why):
            camera(tmp_path, stamps=str(tmp_path / "stamps")).open()

    def test_stamps_that_are_missing_or_no_text_are_refused(self, tmp_path: Path) -> None:
        write(tmp_path, "a.png")
        with pytest.raises(InputError, match=r"stamps .*gone cannot be read: No such file"):
            camera(tmp_path, stamps=str(tmp_path / "gone")).open()
        with pytest.raises(InputError, match="is no text"):
            camera(tmp_path, stamps=str(tmp_path / "a.png")).open()

    def test_a_rate_and_stamps_together_are_refused(self) -> None:
        with pytest.raises(ValidationError, match="not both"):
            ImagesSection(path="x", fps=5.0, stamps="y")

    @given(st.lists(st.floats(0.001, 10.0), min_size=1, max_size=20))
    @settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    def test_stamps_keep_their_distances(self, tmp_path: Path, steps_s: list[float]) -> None:
        stamps_s = np.cumsum([1e6, *steps_s])
        names = [f"{number}.png" for number in range(len(stamps_s))]
        for old in tmp_path.iterdir():
            old.unlink()
        write(tmp_path, *names)
        (tmp_path / "stamps").write_text("\n".join(f"{stamp:.9f}" for stamp in stamps_s))
        clock = ManualClock(50.0)
        cam = camera(tmp_path, clock, stamps=str(tmp_path / "stamps"))
        cam.open()
        clock.advance(1000.0)
        frames = [frame for frame in (cam.read(0.0) for _ in names) if frame]
        np.testing.assert_allclose([frame.stamp_s - 50.0 for frame in frames], stamps_s - stamps_s[0], atol=1e-6)


class TestFaults:
    def test_what_cannot_be_read_is_skipped_named_and_leaves_a_gap(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        write(tmp_path, "0.png", "1.png", "3.png")
        (tmp_path / "2.png").write_bytes((tmp_path / "1.png").read_bytes()[:40])
        (tmp_path / "4.png").write_text("hello")
        clock = ManualClock(0.0)
        cam = camera(tmp_path, clock)
        frames = all_frames(cam, clock)
        assert [frame.sequence for frame in frames] == [0, 1, 3]
        assert [frame.stamp_s for frame in frames] == pytest.approx([0.0, 0.1, 0.3])
        assert cam.skipped == [f"{tmp_path}/2.png is damaged or ends early", f"{tmp_path}/4.png is no picture"]
        assert [record.message for record in caplog.records] == [f"camera cam: skipped: {what}" for what in cam.skipped]

    def test_a_loop_names_a_bad_file_once(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png")
        (tmp_path / "1.png").write_bytes(b"")
        clock = ManualClock(0.0)
        cam = camera(tmp_path, clock, loop=True)
        cam.open()
        clock.advance(100.0)
        assert all(cam.read(0.0) for _ in range(5))
        assert cam.skipped == [f"{tmp_path}/1.png is empty"]

    def test_a_loop_over_bad_files_alone_does_not_go_on_for_ever(self, tmp_path: Path) -> None:
        (tmp_path / "1.png").write_bytes(b"junk")
        with pytest.raises(HardwareError, match=r"none of the pictures .* can be used"):
            camera(tmp_path, loop=True).open()

    def test_pictures_of_another_size_than_the_lens_are_refused_with_both_sizes(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png", size_px=(80, 60))
        with pytest.raises(HardwareError, match=r"0\.png is 80x60 px, the lens 64x48 px"):
            camera(tmp_path).open()

    def test_a_single_picture_of_another_size_is_skipped(self, tmp_path: Path) -> None:
        write(tmp_path, "0.png", "1.png")
        write(tmp_path, "2.png", size_px=(48, 64))
        clock = ManualClock(0.0)
        cam = camera(tmp_path, clock)
        assert len(all_frames(cam, clock)) == 2
        assert cam.skipped == [f"{tmp_path}/2.png is 48x64 px, the lens 64x48 px"]


class TestVideo:
    def test_a_video_is_read_frame_by_frame(self, tmp_path: Path) -> None:
        write_video(tmp_path / "a.avi", 6)
        clock = ManualClock(0.0)
        frames = all_frames(camera(tmp_path / "a.avi", clock, fps=20.0), clock)
        assert [frame.sequence for frame in frames] == list(range(6))
        np.testing.assert_allclose([frame.stamp_s for frame in frames], np.arange(6) / 20.0)
        np.testing.assert_allclose([frame.image.mean() for frame in frames], 10.0 * np.arange(6), atol=3.0)

    def test_stamps_of_a_video_are_lines_and_what_goes_beyond_them_is_named(self, tmp_path: Path) -> None:
        write_video(tmp_path / "a.avi", 6)
        (tmp_path / "stamps").write_text("0.0\n0.5\n0.75\n")
        clock = ManualClock(0.0)
        cam = camera(tmp_path / "a.avi", clock, stamps=str(tmp_path / "stamps"))
        assert [frame.stamp_s for frame in all_frames(cam, clock)] == [0.0, 0.5, 0.75]
        assert cam.skipped == [f"{tmp_path}/a.avi goes on after its 3 stamps; the rest is left out"]

    def test_names_in_the_stamps_of_a_video_are_refused(self, tmp_path: Path) -> None:
        write_video(tmp_path / "a.avi", 2)
        (tmp_path / "stamps").write_text("a,0.0\nb,0.5\n")
        with pytest.raises(InputError, match="a video's stamps are lines"):
            camera(tmp_path / "a.avi", stamps=str(tmp_path / "stamps")).open()

    def test_a_video_that_ends_early_says_so_after_what_could_be_read(self, tmp_path: Path) -> None:
        write_video(tmp_path / "a.avi", 20, size_px=(640, 480))
        data = (tmp_path / "a.avi").read_bytes()
        (tmp_path / "a.avi").write_bytes(data[: len(data) // 2])
        *read, last = pictures.read([tmp_path / "a.avi"])
        assert 0 < len(read) < 20
        assert last.fault == f"ends early: {len(read)} of 20 frames could be read"

    @pytest.mark.parametrize("data", [b"", b"junk" * 1000])
    def test_what_is_no_video_is_a_fault(self, tmp_path: Path, data: bytes) -> None:
        (tmp_path / "a.mp4").write_bytes(data)
        (picture,) = pictures.read([tmp_path / "a.mp4"])
        assert picture.fault == "is no video that can be decoded"

    def test_closing_before_the_end_lets_go_of_the_file(self, tmp_path: Path) -> None:
        write_video(tmp_path / "a.avi", 6)
        cam = camera(tmp_path / "a.avi")
        cam.open()
        assert str(tmp_path / "a.avi") in open_files()
        cam.close()
        assert str(tmp_path / "a.avi") not in open_files()


def open_files() -> set[str]:
    return {os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.is_symlink()}
