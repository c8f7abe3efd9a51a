"""Written images hold what was given: EXR to the bit, PNG by the sRGB curve."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image

from prtcl import __version__
from prtcl.errors import InputError, PrtclError
from prtcl.files.image import read_image, srgb, write_exr, write_png


def random_image(channels: int = 4) -> NDArray[np.float32]:
    return np.random.default_rng(5).normal(1, 2, (7, 11, channels)).astype(np.float32)


def test_exr_round_trip_is_exact(tmp_path: Path) -> None:
    image = random_image()
    image[0, 0] = (np.inf, -np.inf, 1e38, 0.5)  # nothing may be clipped or repaired
    write_exr(tmp_path / "a.exr", image, {"prtcl:material": "gold, α=0.1"})
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), image)
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    assert set(file.channels()) == {"R", "G", "B", "A"}
    assert {channel.pixels.dtype for channel in file.channels().values()} == {np.dtype(np.float32)}
    header = file.header()
    assert header["prtcl:material"] == "gold, α=0.1"
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["type"] == OpenEXR.scanlineimage
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.exr"]


def test_exr_of_a_strided_view(tmp_path: Path) -> None:
    image = random_image()[::-1, ::2]
    write_exr(tmp_path / "a.exr", image, None)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), image)


def test_image_without_alpha_reads_opaque(tmp_path: Path) -> None:
    rgb = random_image(3)
    OpenEXR.File({}, {"RGB": rgb}).write(str(tmp_path / "a.exr"))
    image = read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(image[..., :3], rgb)
    np.testing.assert_array_equal(image[..., 3], 1)


@pytest.mark.parametrize("name", ["channels", "dataWindow", "type", "", "n" * 256])
def test_reserved_metadata_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="metadata"):
        write_exr(tmp_path / "a.exr", random_image(), {name: "x"})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 2), (0, 4, 4), (4, 0, 4)])
def test_wrong_shapes_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    image = np.zeros(shape, dtype=np.float32)
    with pytest.raises(InputError, match="expected shape"):
        write_exr(tmp_path / "a.exr", image, None)
    with pytest.raises(InputError, match="expected shape"):
        write_png(tmp_path / "a.png", image)


def test_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.png").write_text("old")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", fail)
    with pytest.raises(PrtclError, match="No space left"):
        write_png(tmp_path / "a.png", random_image())
    assert (tmp_path / "a.png").read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def test_srgb_against_the_standard() -> None:
    # Levels of 8-bit sRGB whose linear values are known by the inverse formula of IEC 61966-2-1.
    levels = np.arange(256) / 255
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(srgb(linear), levels, atol=1e-6)
    assert srgb(np.array(0.0)) == 0 and srgb(np.array(1.0)) == pytest.approx(1)
    assert srgb(np.array(0.18)) == pytest.approx(0.461356, abs=1e-6)


def test_png_values_alpha_and_text(tmp_path: Path) -> None:
    image = np.zeros((2, 2, 4), dtype=np.float32)
    image[0, 0] = (0.18, 0.0031308 / 2, 5.0, 1.0)
    image[0, 1] = (0.09, 0.045, 0.0, 0.5)  # premultiplied: colour 0.18, 0.09
    image[1, 0] = (3.0, 1.0, 1.0, 0.0)  # invisible
    image[1, 1] = (np.nan, np.inf, -1.0, 2.0)
    write_png(tmp_path / "a.png", image)
    with Image.open(tmp_path / "a.png") as png:
        assert png.mode == "RGBA"
        assert png.text == {"exposure": "0 stops", "Software": f"prtcl {__version__}"}
        pixels = np.asarray(png)
    np.testing.assert_array_equal(pixels[0, 0], (118, 5, 255, 255))
    np.testing.assert_array_equal(pixels[0, 1], (118, 85, 0, 128))
    assert pixels[1, 0, 3] == 0
    np.testing.assert_array_equal(pixels[1, 1], (0, 255, 0, 255))


def test_png_exposure_in_stops_and_no_alpha(tmp_path: Path) -> None:
    image = np.full((1, 1, 3), 0.09, dtype=np.float32)
    write_png(tmp_path / "a.png", image, exposure=1.0)
    with Image.open(tmp_path / "a.png") as png:
        assert png.mode == "RGB"
        assert png.text["exposure"] == "1 stops"
        assert png.getpixel((0, 0)) == (118, 118, 118)
    np.testing.assert_array_equal(image, np.float32(0.09))


@pytest.mark.parametrize("exposure", [float("nan"), float("inf"), 1e6])
def test_impossible_exposure_is_refused(tmp_path: Path, exposure: float) -> None:
    with pytest.raises(InputError, match="exposure"):
        write_png(tmp_path / "a.png", random_image(), exposure)


def test_read_image_refuses_other_files(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", random_image())
    with pytest.raises(InputError, match=r"\.exr"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("room", [0, 100, -10])
def test_an_exr_that_finds_no_room_is_refused(tmp_path: Path, room: int) -> None:
    """OpenEXR's own writer says nothing of its last bytes."""
    write_exr(tmp_path / "a.exr", random_image())
    size = (tmp_path / "a.exr").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # an OpenCL driver may have put a handler there
    resource.setrlimit(resource.RLIMIT_FSIZE, (room if room >= 0 else size + room, hard))
    try:
        with pytest.raises(PrtclError, match=r"b\.exr: writing the EXR failed"):
            write_exr(tmp_path / "b.exr", random_image())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN if before is None else before)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
