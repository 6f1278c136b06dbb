"""Buffers to grey: any size and padding; JPEGs whole and damaged."""

import mmap

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.arrays import GreyImage
from camrig_drivers.v4l2.grey import PixelFormat, decode_jpeg, empty_picture, luma_layout

SIZE_PX = (64, 48)


def random_image(width: int, height: int, seed: int = 0) -> GreyImage:
    return np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)


def lines(pixels: PixelFormat, image: GreyImage, padding: int) -> bytes:
    """Write a picture as a camera does: each line padded, chroma of a value of its own."""
    height, width = image.shape
    if pixels == "YUYV":
        chroma = np.full_like(image, 0xEE)
        data = np.stack([image, chroma], axis=-1).reshape(height, 2 * width)
    else:
        data = image
    padded = np.hstack([data, np.full((height, padding), 0xDD, np.uint8)]).tobytes()
    return padded + bytes([0xEE] * (len(padded) // 2) if pixels == "NV12" else [])


@given(
    pixels=st.sampled_from(["YUYV", "GREY", "NV12"]),
    width=st.integers(1, 40),
    height=st.integers(1, 30),
    padding=st.integers(0, 70),
    seed=st.integers(0, 100),
)
def test_every_pixel_comes_through_whatever_the_padding(
    pixels: PixelFormat, width: int, height: int, padding: int, seed: int
) -> None:
    image = random_image(width, height, seed)
    data = lines(pixels, image, padding)
    layout = luma_layout(pixels, (width, height), width * (2 if pixels == "YUYV" else 1) + padding)
    assert layout is not None
    assert layout.needed_bytes <= len(data)
    copied = np.zeros_like(image)
    with mmap.mmap(-1, layout.needed_bytes) as buffer:
        buffer[:] = data[: layout.needed_bytes]
        layout.copy(layout.view(buffer), copied)
    np.testing.assert_array_equal(copied, image)


@pytest.mark.parametrize(("pixels", "line_bytes"), [("YUYV", 128), ("GREY", 64), ("NV12", 64)])
def test_a_device_that_tells_no_line_length_pads_nothing(pixels: PixelFormat, line_bytes: int) -> None:
    assert luma_layout(pixels, SIZE_PX, 0) == luma_layout(pixels, SIZE_PX, line_bytes)


def test_viewing_copies_nothing_and_keeps_the_buffer_mapped() -> None:
    layout = luma_layout("YUYV", SIZE_PX, 0)
    assert layout is not None
    buffer = mmap.mmap(-1, layout.needed_bytes)
    view = layout.view(buffer)
    buffer[0] = 99
    assert int(view[0, 0]) & 0xFF == 99
    with pytest.raises(BufferError):
        buffer.close()
    del view
    buffer.close()


def jpeg(image: GreyImage) -> bytes:
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    written, data = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert written
    return bytes(data)


def decoded(data: bytes, used_bytes: int | None = None) -> GreyImage | None:
    with mmap.mmap(-1, max(1, len(data))) as buffer:
        buffer[: len(data)] = data
        return decode_jpeg(buffer, len(data) if used_bytes is None else used_bytes, SIZE_PX)


SMOOTH = np.tile(np.linspace(20, 230, 64).astype(np.uint8), (48, 1))


def test_a_jpeg_is_decoded_to_its_luma() -> None:
    image = decoded(jpeg(SMOOTH))
    assert image is not None
    assert image.dtype == np.uint8
    assert np.abs(image.astype(int) - SMOOTH).max() <= 3


def test_padding_after_a_jpeg_is_ignored() -> None:
    """UVC cameras fill up their transfers."""
    image = decoded(jpeg(SMOOTH) + bytes(500))
    assert image is not None
    assert np.abs(image.astype(int) - SMOOTH).max() <= 3


def test_a_jpeg_that_ends_early_is_broken_even_over_the_rest_of_an_older_one() -> None:
    """The end of the frame before still lies in the buffer, behind the used bytes."""
    data = jpeg(SMOOTH)
    assert decoded(data, len(data) - 10) is None


def test_what_is_no_jpeg_of_the_right_size_is_broken() -> None:
    assert decoded(b"") is None
    assert decoded(b"\xff\xd9") is None
    assert decoded(b"no picture at all\xff\xd9") is None
    assert decoded(jpeg(np.zeros((48, 32), np.uint8))) is None


@given(st.binary(max_size=200), st.integers(0, 400))
def test_garbage_never_raises(garbage: bytes, cut: int) -> None:
    data = bytearray(jpeg(SMOOTH))
    data[cut : cut + len(garbage)] = garbage
    image = decoded(bytes(data))
    assert image is None or image.shape == SMOOTH.shape


@pytest.mark.parametrize("size_px", [(1, 1), (641, 479), (3840, 2160)])
def test_a_picture_to_be_filled_begins_on_a_huge_page(size_px: tuple[int, int]) -> None:
    picture = empty_picture(size_px)
    assert picture.shape == size_px[::-1]
    assert picture.flags.c_contiguous
    assert picture.ctypes.data % (1 << 21) == 0
    picture[-1, -1] = 1  # it is ours to the last pixel
