"""RGL's .bsdf: the container, the evaluation against Mitsuba's and closed forms, colours of spectra, damaged files."""

from __future__ import annotations

import re
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bsdf_files import ggx_fields, write_tensors
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.factors.adaptive import LEAST_COSINE, Adaptive, to_rgb
from prtcl.factors.material import Material
from prtcl.factors.measured_files import read
from prtcl.files.rgl import read_rgl
from prtcl.files.tensor_file import read_tensors

Array = NDArray[np.float64]


def written(folder: Path, **change: Any) -> Path:
    fields = {key: value for key, value in {**ggx_fields(), **change}.items() if value is not None}
    write_tensors(folder / "made.bsdf", fields)
    return folder / "made.bsdf"


def pairs(count: int = 1000, seed: int = 0) -> tuple[Array, Array]:
    d = np.random.default_rng(seed).normal(size=(2, count, 3))
    d[..., 2] = np.abs(d[..., 2])
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return d[0], d[1]


# --- evaluation ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fields", [{}, {"alpha": 0.05, "seed": 2}, {"alpha": 0.9, "side": 5, "seed": 3}])
def test_it_is_what_mitsuba_evaluates(tmp_path: Path, fields: dict[str, Any]) -> None:
    """Mitsuba's BSDFs return f cos θ_o, in float32."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = written(tmp_path, **ggx_fields(**fields))
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    i, o = pairs()
    theirs = np.empty((1000, 3))
    for row, (one, other) in enumerate(zip(i.tolist(), o.tolist(), strict=True)):
        at = mi.SurfaceInteraction3f()
        at.wi = mi.Vector3f(*one)
        theirs[row] = np.array(bsdf.eval(mi.BSDFContext(), at, mi.Vector3f(*other)))
    ours = Adaptive(read_rgl(path))(i, o) * o[:, 2:]
    # Its cumulative sums of some 800 numbers, and angles, are of float32; it takes nearly even cells for even ones.
    np.testing.assert_allclose(theirs, ours, rtol=2e-3, atol=2e-4 * float(ours.max()))
    assert np.median(np.abs(theirs / ours - 1)) < 2e-6


def test_an_even_square_is_not_warped(tmp_path: Path) -> None:
    """Of an even density the warp is the identity: S itself is found at u of the half vector's angles."""
    side = 9
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    colours = np.stack([0.1 + u, 0.2 + v, 1 + u * v])[None, None].repeat(5, axis=1)
    path = written(
        tmp_path,
        vndf=np.ones((1, 5, 7, 6), np.float32), jacobian=np.zeros(1, np.uint8), rgb=colours.astype(np.float32),
    )  # fmt: skip
    i, o = pairs()
    h = (i + o) / np.linalg.norm(i + o, axis=1, keepdims=True)
    x = np.sqrt(np.arccos(h[:, 2]) * 2 / np.pi)
    y = (np.arctan2(h[:, 1], h[:, 0]) - np.arctan2(i[:, 1], i[:, 0]) + np.pi) / (2 * np.pi) % 1
    expected = np.stack([0.1 + x, 0.2 + y, 1 + x * y], axis=1) / o[:, 2:]
    np.testing.assert_allclose(Adaptive(read_rgl(path))(i, o), expected, rtol=1e-6)  # tables are float32


def test_the_warp_is_the_cumulative_distribution(tmp_path: Path) -> None:
    """Density 2u along rows and (1 + v)·⅔ across them: u² and (v + v²/2)·⅔, exact on any grid of linear cells."""
    u, v = np.meshgrid(np.linspace(0, 1, 8), np.linspace(0, 1, 5))
    density = np.broadcast_to(2 * u * (1 + v), (1, 5, 5, 8)) * np.array([1, 3, 2, 7, 5])[:, None, None]
    x, y = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
    colours = np.stack([x, y, 0 * x + 1])[None, None].repeat(5, axis=1)
    path = written(
        tmp_path,
        vndf=np.ascontiguousarray(density, np.float32), jacobian=np.zeros(1, np.uint8), rgb=colours.astype(np.float32),
    )  # fmt: skip
    i, o = pairs()
    h = (i + o) / np.linalg.norm(i + o, axis=1, keepdims=True)
    a = np.arccos(h[:, 2]) * 2 / np.pi
    b = (np.arctan2(h[:, 1], h[:, 0]) - np.arctan2(i[:, 1], i[:, 0]) + np.pi) / (2 * np.pi) % 1
    got = Adaptive(read_rgl(path))(i, o) * o[:, 2:]
    np.testing.assert_allclose(got[:, 0], a, atol=1e-6)
    np.testing.assert_allclose(got[:, 1], (b + b**2 / 2) * 2 / 3, atol=1e-6)


def test_it_is_isotropic(tmp_path: Path) -> None:
    f, (i, o) = Adaptive(read_rgl(written(tmp_path))), pairs()
    turn = np.array([[np.cos(1.1), np.sin(1.1), 0], [-np.sin(1.1), np.cos(1.1), 0], [0, 0, 1]])
    np.testing.assert_allclose(f(i @ turn, o @ turn), f(i, o), rtol=1e-9)


def test_two_azimuths_are_averaged(tmp_path: Path) -> None:
    one, two = ggx_fields(phis=2, seed=8), ggx_fields(phis=2, seed=8)
    i, o = pairs()
    found = Adaptive(read_rgl(written(tmp_path, **one)))(i, o)
    each = []
    for k in (0, 1):
        for key in ("phi_i", "vndf", "luminance", "rgb"):
            two[key] = np.ascontiguousarray(one[key][k : k + 1])
        each.append(Adaptive(read_rgl(written(tmp_path, **two)))(i, o))
    np.testing.assert_allclose(found, np.mean(each, axis=0), rtol=1e-12)


def test_a_material_is_read_on_merls_nodes(tmp_path: Path) -> None:
    path = written(tmp_path)
    own, f = read(path), Adaptive(read_rgl(path))
    i, o = pairs()
    i, o = (d[(i[:, 2] > 0.3) & (o[:, 2] > 0.3)] for d in (i, o))
    expected = (f(i, o) + f(o, i)) / 2
    error = np.sqrt(((own.evaluate(i, o) - expected) ** 2).mean()) / expected.mean()
    assert error < 0.03  # the tables' own colours are random from cell to cell
    assert own.valid.mean() < 0.76 and pytest.approx(np.cos(np.radians(88))) == LEAST_COSINE
    material = Material.parse(f"rgl:{path}")
    assert material.kind == "measured"
    assert re.search(r"f\(i, o\) and f\(o, i\) differ by [0-9.]+ %", material.notes[0])
    assert Material.parse(f"rgl:{path},angles=2").kind == "table"


# --- spectra ------------------------------------------------------------------------------------------------


def test_without_colour_science_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "colour", None)
    write_tensors(tmp_path / "made.bsdf", ggx_fields(channels=41))
    with pytest.raises(InputError, match=r"pip install prtcl\[spectral\]"):
        read(tmp_path / "made.bsdf")


def test_even_spectra_are_grey_and_others_have_their_colour(tmp_path: Path) -> None:
    pytest.importorskip("colour")
    fields = ggx_fields(channels=41)
    path = tmp_path / "made.bsdf"
    fields["spectra"] = np.full_like(fields["spectra"], 0.25)
    write_tensors(path, fields)
    rgb = to_rgb(read_rgl(path), "made").spectra
    np.testing.assert_allclose(rgb, 0.25, rtol=1e-12)
    nm = fields["wavelengths"]
    for band, channel in (((600, 700), 0), ((520, 560), 1), ((430, 470), 2)):
        inside = (nm >= band[0]) & (nm <= band[1])
        fields["spectra"][:] = inside[:, None, None]
        write_tensors(path, fields)
        assert np.argmax(to_rgb(read_rgl(path), "made").spectra[0, 0, :, 0, 0]) == channel
    fields["wavelengths"] = np.linspace(450, 700, 41, dtype=np.float32)
    write_tensors(path, fields)
    with pytest.raises(InputError, match="wavelengths expected from 410 to 680 nm"):
        to_rgb(read_rgl(path), "made")


# --- what is wrong ------------------------------------------------------------------------------------------


BASE = ggx_fields()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"phi_i": np.linspace(0, 3, 4, dtype=np.float32)}, "is anisotropic (4 azimuths of incidence)"),
        ({"vndf": None}, "no field vndf"),
        ({"rgb": None}, "no field spectra, wavelengths"),
        ({"theta_i": BASE["theta_i"][::-1].copy()}, "lists of ascending angles"),
        ({"theta_i": np.degrees(BASE["theta_i"])}, "theta_i expected from 0 to pi/2"),
        ({"theta_i": BASE["theta_i"][:-1]}, "fields do not fit phi_i[1], theta_i[4]"),
        ({"rgb": BASE["rgb"][:, :, :2].copy()}, "fields do not fit"),
        ({"ndf": BASE["ndf"][:1]}, "fields do not fit"),
        ({"ndf": BASE["ndf"] * np.nan}, "ndf holds NaN"),
        ({"sigma": -BASE["sigma"]}, "expected densities"),
        ({"vndf": BASE["vndf"] * 0}, "expected densities"),
        ({"rgb": BASE["rgb"] * np.inf}, "rgb holds NaN, infinite"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with np.errstate(invalid="ignore"):
        path = written(tmp_path, **change)
    with pytest.raises(InputError) as caught:
        read_rgl(path)
    assert str(caught.value).startswith(str(path)) and words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_what_a_header_claims_is_held_against_the_file(tmp_path: Path) -> None:
    """Shapes of 2^63 elements, offsets beyond the end, four billion fields: refused before memory is taken."""
    path = tmp_path / "bad.bsdf"
    head = b"tensor_file\0" + bytes([1, 0])
    for body, words in (
        (struct.pack("<I", 2**32 - 1), "its index is cut off"),
        (struct.pack("<IH3sHBQ2Q", 1, 3, b"ndf", 2, 10, 18, 2**63, 2**63), "ends beyond the file"),
        (struct.pack("<IH3sHBQQ", 1, 3, b"ndf", 1, 10, 2**63, 4), "ends beyond the file"),
        (struct.pack("<IH3sHBQQ", 1, 3, b"ndf", 1, 99, 0, 4), "unknown type 99"),
        (struct.pack("<IH3sHBQ", 1, 3, b"ndf", 65535, 10, 0) + bytes(8 * 65535), "65535 dimensions"),
    ):
        path.write_bytes(head + body)
        with pytest.raises(InputError, match=words):
            read_tensors(path, ("ndf",), (".bsdf",), "a test")
    path.write_bytes(b"tensor_file\0" + bytes([2, 0]) + bytes(100))
    with pytest.raises(InputError, match=r"version 2\.0"):
        read_tensors(path, ("ndf",), (".bsdf",), "a test")


def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    """Two thousand files cut off, flipped or random: an InputError that names the file, or tables that give numbers."""
    small = {
        **ggx_fields(side=3),
        "vndf": np.ones((1, 5, 3, 4), np.float32),
        "ndf": np.ones((3, 4), np.float32),
    }
    whole = written(tmp_path, **small).read_bytes()
    path, rng = tmp_path / "fuzz.bsdf", np.random.default_rng(0)
    i, o = pairs(20)
    outcomes = {"read": 0, "refused": 0}
    for turn in range(2000):
        data = bytearray(whole)
        if turn % 3 == 0:
            data = data[: int(rng.integers(0, len(data)))]
        elif turn % 3 == 1:
            for at in rng.integers(0, 330 if turn % 2 else len(data), rng.integers(1, 4)):
                data[at] ^= int(rng.integers(1, 256))
        else:
            at = int(rng.integers(0, 330))
            data[at : at + 8] = rng.bytes(8)
        path.write_bytes(data)
        try:
            tables = read_rgl(path)
        except InputError as error:
            assert str(path) in str(error) and len(str(error).splitlines()) == 1
            outcomes["refused"] += 1
        else:
            with np.errstate(over="ignore"):
                assert not np.isnan(Adaptive(tables)(i, o)).any()
            outcomes["read"] += 1
    assert min(outcomes.values()) > 100, outcomes
