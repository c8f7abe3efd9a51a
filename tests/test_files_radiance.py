"""Environment maps: every variant reads exactly, every damage is refused in words."""

from __future__ import annotations

import builtins
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.radiance import read_radiance, require_equirectangular

ENVIRONMENTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "environments"
SCANLINE = OpenEXR.scanlineimage


def random_image(height: int = 40, width: int = 80, seed: int = 1) -> NDArray[np.float32]:
    return (np.random.default_rng(seed).random((height, width, 3)) * 4).astype(np.float32)


def write(path: Path, channels: dict[str, Any], compression: str = "ZIP", **header: Any) -> Path:
    header.setdefault("type", SCANLINE)
    header["compression"] = getattr(OpenEXR, f"{compression}_COMPRESSION")
    OpenEXR.File(header, dict(channels)).write(str(path))  # it replaces the arrays in the dict it is given
    return path


def tiles() -> Any:
    description = OpenEXR.TileDescription()
    description.xSize = description.ySize = 16
    return description


def write_hdr(path: Path, image: NDArray[np.float32]) -> Path:
    oiio = pytest.importorskip("OpenImageIO")
    out = oiio.ImageOutput.create(str(path.with_suffix(".hdr")))
    assert out.open(str(path), oiio.ImageSpec(image.shape[1], image.shape[0], 3, "float"))
    assert out.write_image(image)
    out.close()
    return path


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_scanline_is_exact(tmp_path: Path, compression: str, dtype: type) -> None:
    image = random_image().astype(dtype)
    read, notes = read_radiance(write(tmp_path / "a.exr", {"RGB": image}, compression))
    assert read.dtype == np.float32 and read.flags.c_contiguous
    np.testing.assert_array_equal(read, image.astype(np.float32))
    assert notes == []


def test_tiled_is_exact(tmp_path: Path) -> None:
    image = random_image()
    path = write(tmp_path / "a.exr", {"RGB": image}, type=OpenEXR.tiledimage, tiles=tiles())
    np.testing.assert_array_equal(read_radiance(path)[0], image)


def test_alpha_is_ignored_and_types_may_differ(tmp_path: Path) -> None:
    image = random_image()
    planes = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    planes["G"] = planes["G"].astype(np.float16)
    planes["A"] = np.full(image.shape[:2], np.nan, dtype=np.float32)
    read, notes = read_radiance(write(tmp_path / "a.exr", planes))
    np.testing.assert_array_equal(read[..., 0], planes["R"])
    np.testing.assert_array_equal(read[..., 1], planes["G"].astype(np.float32))
    assert notes == []


@pytest.mark.parametrize("name", ["Y", "Z", "light.intensity"])
def test_single_channel_is_grey(tmp_path: Path, name: str) -> None:
    plane = np.ascontiguousarray(random_image()[..., 0])
    read, notes = read_radiance(write(tmp_path / "a.exr", {name: plane, "A": plane * 0}))
    for channel in range(3):
        np.testing.assert_array_equal(read[..., channel], plane)
    assert len(notes) == 1 and f"'{name}'" in notes[0]


def test_layers_only_without_plain_rgb(tmp_path: Path) -> None:
    image = random_image()
    planes = [np.ascontiguousarray(image[..., i]) for i in range(3)]
    layer = {f"diffuse.{letter}": plane for letter, plane in zip("RGB", planes, strict=True)}
    read, notes = read_radiance(write(tmp_path / "a.exr", layer))
    np.testing.assert_array_equal(read, image)
    assert "diffuse" in notes[0]
    plain = {letter: plane * 2 for letter, plane in zip("RGB", planes, strict=True)}
    read, notes = read_radiance(write(tmp_path / "b.exr", layer | plain))
    np.testing.assert_array_equal(read, image * 2)
    assert notes == []


def test_colour_is_found_in_a_later_part(tmp_path: Path) -> None:
    image = random_image()
    depth = OpenEXR.Part({"name": "depth"}, {"Z": image[..., 0].copy(), "id": image[..., 1].copy()})
    OpenEXR.File([depth, OpenEXR.Part({"name": "rgb"}, {"RGB": image})]).write(str(tmp_path / "a.exr"))
    read, notes = read_radiance(tmp_path / "a.exr")
    np.testing.assert_array_equal(read, image)
    assert "part 2 of 2" in notes[0]


def test_hdr_and_pic_are_exact_to_their_format(tmp_path: Path) -> None:
    image = random_image()
    path = write_hdr(tmp_path / "a.hdr", image)
    read, notes = read_radiance(path)
    # The shared exponent leaves 8 bits below the largest channel of the pixel.
    assert np.all(np.abs(read - image) <= image.max(axis=2, keepdims=True) / 128)
    assert notes == []
    (tmp_path / "a.pic").write_bytes(path.read_bytes())
    np.testing.assert_array_equal(read_radiance(tmp_path / "a.pic")[0], read)


def test_hdr_upside_down_exposure_and_columns(tmp_path: Path) -> None:
    data = write_hdr(tmp_path / "a.hdr", random_image()).read_bytes()
    upright, _ = read_radiance(tmp_path / "a.hdr")
    (tmp_path / "b.hdr").write_bytes(data.replace(b"-Y 40 +X 80", b"+Y 40 +X 80"))
    np.testing.assert_array_equal(read_radiance(tmp_path / "b.hdr")[0], upright[::-1])
    (tmp_path / "c.hdr").write_bytes(data.replace(b"\n\n", b"\nEXPOSURE=2.5\n\n", 1))
    read, notes = read_radiance(tmp_path / "c.hdr")
    np.testing.assert_array_equal(read, upright)
    assert "2.5" in notes[0]
    (tmp_path / "d.hdr").write_bytes(data.replace(b"-Y 40 +X 80", b"+X 40 -Y 80"))
    with pytest.raises(InputError):
        read_radiance(tmp_path / "d.hdr")


def test_hdr_without_the_optional_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n")
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "OpenImageIO":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"a\.hdr: .*\bhdr\b.*run: pip install openimageio$") as caught:
        read_radiance(tmp_path / "a.hdr")
    assert len(str(caught.value).splitlines()) == 1


def make_missing(folder: Path) -> Path:
    return folder / "no.exr"


def make_folder(folder: Path) -> Path:
    return folder


def make_extension(folder: Path) -> Path:
    (folder / "a.jpeg").write_bytes(b"x")
    return folder / "a.jpeg"


def make_bare(folder: Path) -> Path:
    (folder / "a").write_bytes(b"x")
    return folder / "a"


def make_empty(folder: Path) -> Path:
    (folder / "a.exr").touch()
    return folder / "a.exr"


def make_text(folder: Path) -> Path:
    (folder / "a.exr").write_text("hello, this is no image")
    return folder / "a.exr"


def make_text_hdr(folder: Path) -> Path:
    (folder / "a.hdr").write_text("hello, this is no image")
    return folder / "a.hdr"


def make_png_hdr(folder: Path) -> Path:
    (folder / "a.hdr").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    return folder / "a.hdr"


def make_colourless(folder: Path) -> Path:
    plane = np.ones((4, 8), dtype=np.float32)
    return write(folder / "a.exr", {"N.X": plane, "N.Y": plane.copy()})


def make_chroma(folder: Path) -> Path:
    plane = np.ones((4, 8), dtype=np.float32)
    return write(folder / "a.exr", {"Y": plane, "RY": plane.copy(), "BY": plane.copy()})


def make_integers(folder: Path) -> Path:
    return write(folder / "a.exr", {"Y": np.ones((4, 8), dtype=np.uint32)})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (make_missing, "no such file"),
        (make_folder, "folder"),
        (make_extension, r"'\.jpeg'.*\.exr, \.hdr, \.pic"),
        (make_bare, "no extension"),
        (make_empty, "empty"),
        (make_text, "expected an EXR image"),
        (make_text_hdr, "expected a Radiance picture"),
        (make_png_hdr, "expected a Radiance picture"),
        (make_colourless, r"no colour channels.*N\.X, N\.Y"),
        (make_chroma, "no colour channels"),
        (make_integers, "uint32"),
    ],
)
def test_refusals(tmp_path: Path, make: Callable[[Path], Path], words: str) -> None:
    path = make(tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        read_radiance(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and message.count("\n") <= 1


@pytest.mark.parametrize(
    ("value", "kind"),
    [(np.nan, "1 NaN"), (np.inf, "1 infinite"), (-1.0, "1 negative"), (-np.inf, "1 negative")],
)
def test_impossible_radiance(tmp_path: Path, value: float, kind: str) -> None:
    image = random_image()
    image[3, 5, 1] = value
    path = write(tmp_path / "a.exr", {"RGB": image})
    with pytest.raises(InputError, match=f"{kind} of 9600.*row 3, column 5, channel G") as caught:
        read_radiance(path)
    assert "--repair" in str(caught.value)
    read, notes = read_radiance(path, repair=True)
    expected = image.copy()
    expected[3, 5, 1] = 0
    if value == np.inf:
        expected[3, 5, 1] = expected.max()
    np.testing.assert_array_equal(read, expected)
    assert len(notes) == 1 and "1 " in notes[0]


def test_repair_counts_each_kind_and_all_infinite(tmp_path: Path) -> None:
    image = random_image(4, 8)
    image[0, :3, 0] = np.nan
    image[1, :2, 0] = -2
    image[2, :4, 0] = np.inf
    _, notes = read_radiance(write(tmp_path / "a.exr", {"RGB": image}), repair=True)
    assert notes[0] == "replaced 3 NaN and 2 negative values by 0"
    assert notes[1].startswith("replaced 4 infinite")
    read, _ = read_radiance(write(tmp_path / "b.exr", {"RGB": np.full_like(image, np.inf)}), repair=True)
    np.testing.assert_array_equal(read, 0)


def test_equirectangular() -> None:
    require_equirectangular(np.zeros((4, 8, 3), dtype=np.float32), "a.exr")
    with pytest.raises(InputError, match="9x4"):
        require_equirectangular(np.zeros((4, 9, 3), dtype=np.float32), "a.exr")


def test_smallest_image(tmp_path: Path) -> None:
    read, _ = read_radiance(write(tmp_path / "a.exr", {"RGB": np.ones((1, 1, 3), dtype=np.float32)}))
    assert read.shape == (1, 1, 3)


@pytest.mark.parametrize("kind", ["NO", "ZIP", "PIZ", "DWAA", "tiled"])
def test_truncation_is_always_found(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    if kind == "tiled":
        write(path, {"RGB": random_image()}, type=OpenEXR.tiledimage, tiles=tiles())
    else:
        write(path, {"RGB": random_image()}, kind)
    data = path.read_bytes()
    rng = np.random.default_rng(2)
    for length in [*rng.integers(1, len(data), 40), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            read_radiance(path)
    assert capfd.readouterr() == ("", "")  # nothing from the C++ library beside our message


def test_unwritten_blocks_are_not_black(tmp_path: Path) -> None:
    """A renderer that dies leaves zeros in the offset table, or blocks that were never written."""
    data = bytearray(write(tmp_path / "a.exr", {"RGB": random_image()}, "ZIP").read_bytes())
    table = next(i for i in range(8, len(data)) if struct.unpack_from("<Q", data, i)[0] == i + 8 * 3)
    for offset in (0, len(data) + 10, 2**63):
        damaged = data.copy()
        struct.pack_into("<Q", damaged, table + 8, offset)
        (tmp_path / "b.exr").write_bytes(damaged)
        with pytest.raises(InputError, match="1 of its 3 blocks"):
            read_radiance(tmp_path / "b.exr")


def test_damaged_pixels_are_not_dropped(tmp_path: Path) -> None:
    """The library leaves out a part it cannot decode, and says so only on standard output."""
    image = np.round(
        random_image()
    )  # compressible: blocks that are not are stored raw, and any bytes are valid
    parts = [OpenEXR.Part({"name": name}, {"RGB": image.copy()}) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    data = bytearray((tmp_path / "a.exr").read_bytes())
    data[-200:-100] = bytes(100)  # inside the last block
    (tmp_path / "b.exr").write_bytes(data)
    with pytest.raises(InputError, match="pixels cannot be decoded"):
        read_radiance(tmp_path / "b.exr")


@pytest.mark.parametrize("kind", ["exr", "tiled", "hdr"])
def test_fuzz_reads_or_refuses(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("a.hdr" if kind == "hdr" else "a.exr")
    image = random_image(24, 32)
    if kind == "hdr":
        write_hdr(path, image)
    elif kind == "tiled":
        write(path, {"RGB": image}, type=OpenEXR.tiledimage, tiles=tiles())
    else:
        write(path, {"RGB": image.astype(np.float16)}, "PIZ")
    data = path.read_bytes()
    rng = np.random.default_rng(3)
    outcomes = {"read": 0, "refused": 0}
    for turn in range(300):
        changed = bytearray(data)
        reach = len(data) if turn % 2 else min(len(data), 400)  # every other time in the header
        for _ in range(rng.integers(1, 4)):
            changed[rng.integers(0, reach)] = rng.integers(0, 256)
        if turn % 5 == 0:
            changed = changed[: rng.integers(1, len(data))]
        path.write_bytes(changed)
        try:
            read, _ = read_radiance(path, repair=True)
            assert read.ndim == 3 and np.isfinite(read).all() and (read >= 0).all()
            outcomes["read"] += 1
        except InputError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 10, outcomes


def test_real_environments() -> None:
    if not ENVIRONMENTS.is_dir():
        pytest.skip("no ../shared/data/environments; test_scanline_is_exact is the twin")
    # From the README beside them: the smallest and largest value over all channels.
    known = {"lebombo": (0.003906, 41.25), "modern_buildings_2": (0.00238, 6.861e4)}
    for name, (low, high) in known.items():
        radiance, notes = read_radiance(ENVIRONMENTS / f"{name}.exr")
        require_equirectangular(radiance, name)
        assert radiance.shape == (512, 1024, 3) and notes == []
        assert radiance.min() == pytest.approx(low, rel=1e-3)
        assert radiance.max() == pytest.approx(high, rel=1e-3)
