"""MERL's .binary: layout, scales, round trips, and what is wrong with a file."""

from __future__ import annotations

import re
import struct
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.factors.bivariate import directions, merl_nodes
from prtcl.factors.material import Material
from prtcl.factors.measured import merl_layout, turns
from prtcl.files import merl

Array = NDArray[np.float64]


@lru_cache(maxsize=1)
def made() -> tuple[Array, NDArray[np.bool_]]:
    """Reproducible values, and bins of which some are missing."""
    rng = np.random.default_rng(2)
    return rng.uniform(0.1, 2.0, (*merl.SHAPE, 3)), rng.random(merl.SHAPE) > 0.01


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("merl") / "made.binary"
    merl.write_merl(path, *made())
    return path.read_bytes()


def test_what_is_written_is_read_back(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "a.binary"
    path.write_bytes(whole)
    values, valid = merl.read_merl(path)
    wanted, mask = made()
    assert (valid == mask).all() and 0.98 < valid.mean() < 1
    # Divided by the scale and multiplied again: two roundings.
    assert (np.abs(values[mask] / wanted[mask] - 1) <= 2 * 2.0**-53).all()
    assert (values[~mask] < 0).all()


def test_the_layout_is_merls(tmp_path: Path, whole: bytes) -> None:
    """One stored number of each channel, found by the index formula; φ_d runs fastest, channels slowest."""
    assert struct.unpack("<3i", whole[:12]) == (90, 90, 180) and len(whole) == 12 + 3 * 90 * 90 * 180 * 8
    stored, h, d, p = bytearray(whole), 17, 60, 121
    for channel in range(3):
        struct.pack_into(
            "<d", stored, 12 + 8 * (p + 180 * (d + 90 * (h + 90 * channel))), 300.0 * (channel + 1)
        )
    path = tmp_path / "a.binary"
    path.write_bytes(stored)
    values, _ = merl.read_merl(path)
    np.testing.assert_allclose(values[h, d, p], [0.2, 600 * 1.15 / 1500, 900 * 1.66 / 1500], rtol=1e-15)


def test_a_bin_is_found_from_its_directions(tmp_path: Path, whole: bytes) -> None:
    """MERL's own look-up: the bin of √(θ_h/90°)·90, θ_d and φ_d in degrees; here at the bins' centres."""
    h, d = merl_nodes()
    rng = np.random.default_rng(3)
    at = np.stack([rng.integers(0, n, 200) for n in merl.SHAPE])
    i, o = directions(h[at[0]], d[at[1]], turns(180)[at[2]])
    values, mask = made()
    good = (i[:, 2] > 0) & (o[:, 2] > 0) & mask[tuple(at)]
    f = merl_layout(values, mask).evaluate(i, o)
    assert good.sum() > 100
    np.testing.assert_allclose(
        f[good], values[tuple(at)][good], rtol=2e-5
    )  # neighbours' weights are rounding
    assert (np.floor(np.sqrt(h / (np.pi / 2)) * 90) == np.arange(90)).all()
    assert (np.floor(np.degrees(d)) == np.arange(90)).all()


def test_a_material_says_what_was_left_out_and_what_two_angles_cost(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "a,b.binary"
    path.write_bytes(whole)
    missing = int((~made()[1]).sum())
    three, two = (Material.parse(f"merl:{path}{end}") for end in ("", ",angles=2"))
    assert (three.kind, two.kind) == ("measured", "table")
    assert three.spec == f"merl:{path}" and two.spec == f"merl:{path},angles=2"
    for material in (three, two):
        assert f"{missing} of 1458000 samples are negative, " in material.notes[0]
        assert " of them above the horizon; they are left out" in material.notes[0]
    assert re.search(
        r"two angles would change it by [0-9.]+ % .*; angles=2 makes it editable", three.notes[1]
    )
    assert re.search(r"two angles change it by [0-9.]+ %", two.notes[-1])
    assert not three.grey and not three.black
    assert Material.parse(f"merl:{path},angles=3").kind == "measured"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b[:11], "got 11 bytes"),
        (lambda b: b[:-1], "is cut off: expected 34992012 bytes, got 34992011"),
        (lambda b: b[:12], "is cut off"),
        (lambda b: b + b"\0", "is too long: expected 34992012 bytes, got 34992013"),
        (lambda b: struct.pack("<3i", 90, 180, 90) + b[12:], "of 90 x 90 x 180 bins, got 90 x 180 x 90"),
        (lambda b: struct.pack("<3i", 2**30, 2**30, 2**30) + b[12:], "90 x 90 x 180 bins, got 1073741824 x"),
        (lambda b: struct.pack("<3i", -90, -90, 180) + b[12:], "got -90 x -90 x 180"),
        (lambda b: b[:12] + struct.pack("<d", np.nan) + b[20:], "infinite, the first in channel 0, bin (0, 0, 0)"),
        (lambda b: b[:-8] + struct.pack("<d", -np.inf), "the first in channel 2, bin (89, 89, 179)"),
        (lambda b: b[:-8] + struct.pack("<d", 1.7e308), ""),
        (lambda b: b"", "got an empty file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, whole: bytes, change, words: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "bad.binary"
    path.write_bytes(change(whole))
    if not words:  # a huge number is a number
        assert np.isfinite(merl.read_merl(path)[0]).all()
        return
    with pytest.raises(InputError) as caught:
        merl.read_merl(path)
    assert str(caught.value).startswith(str(path)) and words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_file_without_a_valid_sample_is_refused(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "none.binary"
    path.write_bytes(whole[:12] + np.full(3 * 90 * 90 * 180, -1.0).tobytes())
    with pytest.raises(InputError, match="no sample is valid"):
        Material.parse(f"merl:{path}")


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    values, valid = made()
    with pytest.raises(InputError, match=r"takes values \(90, 90, 180, 3\)"):
        merl.write_merl(tmp_path / "a.binary", values[:5], valid[:5])
    bad = values.copy()
    bad[0, 0, 0, 0] = np.nan
    with pytest.raises(InputError, match="finite reflectance"):
        merl.write_merl(tmp_path / "a.binary", bad)
    assert not list(tmp_path.iterdir())


def test_damaged_files_are_refused_or_read(tmp_path: Path, whole: bytes) -> None:
    """Cut, flipped and random bytes of the head; in the data any bit pattern is a number, NaN or infinite."""
    rng, path = np.random.default_rng(0), tmp_path / "fuzz.binary"
    for _ in range(300):
        data = bytearray(whole[:200])
        for at in rng.integers(0, 12, rng.integers(1, 4)):
            data[at] ^= int(rng.integers(1, 256))
        path.write_bytes(data[: rng.integers(0, 200)])
        with pytest.raises(InputError, match=re.escape(str(path))):
            merl.read_merl(path)
    path.write_bytes(whole)
    for _ in range(10):
        with path.open("r+b") as file:
            file.seek(int(rng.integers(12, len(whole) - 8)))
            file.write(rng.bytes(8))
        try:
            values, valid = merl.read_merl(path)
        except InputError as error:
            assert "NaN or infinite" in str(error) or "too large" in str(error)
            path.write_bytes(whole)
        else:
            assert np.isfinite(values).all() and valid.any()
