"""What every TagDetector must do, whichever library it is: one class, run on each.

Tags are drawn by supersampling, so that their corners are known far better than any detector finds them.
"""

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.interfaces import Plugin, SearchesCoarser, TagDetector
from camrig.messages import TagDetection
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from camrig_emulators.tag_pictures import BLACK, WHITE, tag_cells

BACKENDS = ("pyapriltags", "pupil", "opencv")
SEVERAL_FAMILIES = ("pyapriltags", "opencv")
DECIMATIONS = (1.0, 1.5, 2.0, 3.0, 4.0)
SUPERSAMPLING = 8
TEXELS = 16


def draw(key: TagKey, corners_px: Array, size_px: tuple[int, int] = (320, 240), flip_cell: bool = False) -> GreyImage:
    """Draw a tag with p0..p3 at (4, 2) pixels of OpenCV's convention; ``flip_cell`` inverts one of its bits."""
    cells = tag_cells(key).copy()  # row 0 is the top of an upright tag, one cell of white all round
    if flip_cell:
        cells[4, 4] = WHITE + BLACK - cells[4, 4]
    texture = np.kron(cells, np.ones((TEXELS, TEXELS), np.uint8))
    far = len(texture) - TEXELS
    drawn = np.array([[TEXELS, far], [far, far], [far, TEXELS], [TEXELS, TEXELS]], np.float32) - np.float32(0.5)
    wanted = ((corners_px + 0.5) * SUPERSAMPLING - 0.5).astype(np.float32)
    T_image_texture = cv2.getPerspectiveTransform(drawn, wanted)
    fine_px = (size_px[0] * SUPERSAMPLING, size_px[1] * SUPERSAMPLING)
    fine = cv2.warpPerspective(texture, T_image_texture, fine_px, borderValue=WHITE)
    return np.asarray(cv2.resize(fine, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def square(side_px: float, turn_rad: float = 0.0, centre_px: tuple[float, float] = (160.3, 119.6)) -> Array:
    """Return p0..p3 of a tag turned clockwise in the picture; upright at 0: bottom-left comes first."""
    upright = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * side_px
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.asarray(upright @ np.array([[c, s], [-s, c]]) + centre_px)


def one(detector: TagDetector, image: GreyImage) -> TagDetection:
    (tag,) = detector.detect(image)
    return tag


def with_noise(image: GreyImage, rng: np.random.Generator) -> GreyImage:
    return np.clip(np.round(image + rng.normal(0.0, 2.0, image.shape)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Plugin[TagDetector]:
    if request.param == "pupil":
        pytest.importorskip("pupil_apriltags", reason="pupil-apriltags exists for x86_64 alone")
    return load_plugin("detectors", request.param)


@pytest.fixture(scope="module")
def detector(backend: Plugin[TagDetector]) -> TagDetector:
    return backend.make(backend.section())


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """Let the detectors of a test be used again by the next one."""
    yield
    gc.collect()


class TestEveryDetector:
    @pytest.mark.parametrize("quarter", range(4))
    def test_corners_are_in_apriltags_order_whichever_way_the_tag_is_turned(
        self, detector: TagDetector, quarter: int
    ) -> None:
        corners = square(72.0, np.pi / 2.0 * quarter + 0.1)
        tag = one(detector, draw(TagKey("tag36h11", 7), corners))
        assert tag.key == TagKey("tag36h11", 7)
        assert tag.hamming == 0
        np.testing.assert_allclose(tag.corners_px, corners, atol=0.2)
        np.testing.assert_allclose(tag.centre_px, corners.mean(axis=0), atol=0.1)

    @pytest.mark.parametrize("decimate", [1.0, 1.5, 2.0])
    def test_corners_are_in_opencvs_pixels_without_bias(self, backend: Plugin[TagDetector], decimate: float) -> None:
        detector = backend.make(backend.section(decimate=decimate))
        rng = np.random.default_rng(7)
        errors = []
        for tag_id in range(16):
            ideal = square(rng.uniform(40.0, 90.0), rng.uniform(0.0, 2.0 * np.pi), tuple(rng.uniform(118, 122, 2)))
            corners = ideal + rng.uniform(-2.0, 2.0, (4, 2))
            image = with_noise(draw(TagKey("tag36h11", tag_id), corners), rng)
            errors += [tag.corners_px - corners for tag in detector.detect(image)]
        assert len(errors) == 16
        np.testing.assert_allclose(np.mean(errors, axis=(0, 1)), 0.0, atol=0.03)
        assert np.median(np.linalg.norm(errors, axis=2)) < 0.1

    @pytest.mark.parametrize("decimate", [2.0, 3.0, 4.0])
    def test_one_picture_can_be_searched_coarser_than_the_next(self, detector: TagDetector, decimate: float) -> None:
        assert isinstance(detector, SearchesCoarser)
        corners, small = square(96.0, 0.3), square(14.0, 0.3)
        (tag,) = detector.detect_shrunk(draw(TagKey("tag36h11", 7), corners), decimate)
        np.testing.assert_allclose(tag.corners_px, corners, atol=0.2)
        assert detector.detect_shrunk(draw(TagKey("tag36h11", 7), small), 4.0) == ()
        assert one(detector, draw(TagKey("tag36h11", 7), square(24.0, 0.3))).key.id == 7

    def test_margin_is_about_half_the_contrast(self, detector: TagDetector) -> None:
        assert one(detector, draw(TagKey("tag36h11", 3), square(80.0))).margin == pytest.approx(
            (WHITE - BLACK) / 2.0, rel=0.25
        )

    def test_no_tag_is_found_where_there_is_none(self, detector: TagDetector) -> None:
        noise = np.random.default_rng(3).integers(0, 256, (240, 320), np.uint8)
        assert detector.detect(noise) == ()
        assert detector.detect(np.full((240, 320), 200, np.uint8)) == ()

    def test_the_same_picture_gives_the_same_tags_and_stays_as_it_was(self, detector: TagDetector) -> None:
        image = draw(TagKey("tag36h11", 11), square(60.0, 0.3))
        before = image.copy()
        image.setflags(write=False)
        first, second = one(detector, image), one(detector, image)
        np.testing.assert_array_equal(first.corners_px, second.corners_px)
        np.testing.assert_array_equal(image, before)

    def test_a_wrong_bit_counts_only_where_it_is_allowed(self, backend: Plugin[TagDetector]) -> None:
        image = draw(TagKey("tag36h11", 5), square(80.0), flip_cell=True)
        assert backend.make(backend.section()).detect(image) == ()
        tag = one(backend.make(backend.section(max_hamming=1)), image)
        assert (tag.key.id, tag.hamming) == (5, 1)

    def test_a_faint_tag_counts_only_where_the_margin_allows_it(self, backend: Plugin[TagDetector]) -> None:
        image = draw(TagKey("tag36h11", 5), square(80.0)) // 12 + 100  # black and white differ by 16 levels
        assert backend.make(backend.section()).detect(image) == ()
        tag = one(backend.make(backend.section(min_margin=2.0)), image)
        assert tag.margin == pytest.approx(8.0, rel=0.3)

    @pytest.mark.parametrize("family", ["tag16h5", "tag25h9"])
    def test_other_families_have_the_same_numbers_and_corners(self, backend: Plugin[TagDetector], family: str) -> None:
        detector = backend.make(backend.section(families=(family,)))
        for tag_id in (0, 4, 9):
            corners = square(72.0, 0.2)
            tag = one(detector, draw(TagKey(family, tag_id), corners))
            assert tag.key == TagKey(family, tag_id)
            np.testing.assert_allclose(tag.corners_px, corners, atol=0.2)

    def test_an_unknown_family_is_refused_with_those_it_has(self, backend: Plugin[TagDetector]) -> None:
        with pytest.raises(ValueError, match=r"unknown family 'tag36h12'.*tag36h11"):
            backend.section(families=("tag36h12",))

    @pytest.mark.parametrize(
        ("image", "why"),
        [
            (np.zeros((240, 15), np.uint8), "15x240 px is too small"),
            (np.zeros((0, 0), np.uint8), "too small"),
            (np.zeros((240, 320, 3), np.uint8), r"not \(240, 320, 3\)"),
            (np.zeros((240, 320), np.float32), "float32"),
            (np.zeros((240, 640), np.uint8)[:, ::2], "contiguous"),
            (np.zeros((480, 320), np.uint8).T, "contiguous"),
        ],
    )
    def test_what_is_no_raw_picture_is_refused(self, detector: TagDetector, image: GreyImage, why: str) -> None:
        with pytest.raises(InputError, match=why):
            detector.detect(image)

    @pytest.mark.parametrize("decimate", DECIMATIONS)
    def test_the_smallest_pictures_are_survived(self, backend: Plugin[TagDetector], decimate: float) -> None:
        detector = backend.make(backend.section(decimate=decimate))
        rng = np.random.default_rng(5)
        for height, width in [(16, 16), (16, 17), (19, 16), (16, 400), (400, 16)]:
            for image in (rng.integers(0, 256, (height, width), np.uint8), np.zeros((height, width), np.uint8)):
                detector.detect(image)

    def test_a_shrink_factor_that_would_shift_the_corners_is_refused(self, backend: Plugin[TagDetector]) -> None:
        with pytest.raises(ValueError, match=r"must be one of 1, 1\.5, 2, 3, 4"):
            backend.section(decimate=2.5)

    @pytest.mark.realtime
    def test_other_threads_run_while_it_detects(self, detector: TagDetector) -> None:
        image = np.random.default_rng(1).integers(0, 256, (1080, 1920), np.uint8)
        worker = threading.Thread(target=detector.detect, args=(image,))
        worker.start()
        ticks = 0
        while worker.is_alive():
            time.sleep(0.001)
            ticks += 1
        assert ticks > 10  # holding the GIL would leave one or two

    def test_two_threads_in_one_detector_raise_instead_of_crashing(self, detector: TagDetector) -> None:
        image = np.random.default_rng(1).integers(0, 256, (1080, 1920), np.uint8)
        refused = []
        together = threading.Barrier(2)

        def work() -> None:
            together.wait()
            try:
                detector.detect(image)
            except RuntimeError as error:
                refused.append(str(error))

        threads = [threading.Thread(target=work) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert refused == ["two threads use one tag detector; give each camera its own"]
        assert detector.detect(image) == ()

    def test_memory_does_not_grow(self, detector: TagDetector) -> None:
        picture = draw(TagKey("tag36h11", 1), square(50.0, centre_px=(60.0, 60.0)), (120, 120))
        image = np.ascontiguousarray(np.tile(picture, (2, 2)))  # four tags
        for _ in range(50):
            assert len(detector.detect(image)) == 4
        before_kb = resident_kb()
        for _ in range(300):
            detector.detect(image)
        assert resident_kb() - before_kb < 1500  # 3 kB a tag and call would be 3600

    def test_a_detector_that_nobody_holds_is_used_again(self, backend: Plugin[TagDetector]) -> None:
        def use() -> None:
            backend.make(backend.section(decimate=3.0)).detect(np.zeros((64, 64), np.uint8))
            gc.collect()

        use()
        before_kb = resident_kb()
        for _ in range(20):
            use()
        assert resident_kb() - before_kb < 20_000  # twenty of the C library's would be 740,000


@pytest.mark.parametrize("name", SEVERAL_FAMILIES)
def test_several_families_are_read_in_one_picture(name: str) -> None:
    backend = load_plugin("detectors", name)
    detector = backend.make(backend.section(families=("tag36h11", "tag25h9")))
    tags = [draw(TagKey(family, 6), square(72.0), (320, 240)) for family in ("tag36h11", "tag25h9")]
    found = detector.detect(np.ascontiguousarray(np.hstack(tags)))
    assert {str(tag.key) for tag in found} == {"tag36h11:6", "tag25h9:6"}


def test_the_interpreter_ends_cleanly_with_detectors_alive_and_dropped(tmp_path: Path) -> None:
    """pupil-apriltags' own destructor corrupts the heap: an aborted or killed process has another exit code."""
    installed = [name for name in BACKENDS if name != "pupil" or find_spec("pupil_apriltags")]
    program = tmp_path / "detectors.py"
    program.write_text(
        "import numpy as np\n"
        "from camrig.plugins import load_plugin\n"
        f"for name in {installed!r}:\n"
        "    plugin = load_plugin('detectors', name)\n"
        "    for family in ('tag16h5', 'tag25h9', 'tag36h11'):\n"
        "        plugin.make(plugin.section(families=(family,))).detect(np.zeros((64, 64), np.uint8))\n"
        "    kept = plugin.make(plugin.section())\n"
    )
    ended = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


def resident_kb() -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])
