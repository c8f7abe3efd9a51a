"""UTIA's .bin: layout, the mean over the turn, the anisotropy that it loses, and what is wrong with a file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.factors.measured_files import read
from prtcl.factors.turned import Turned
from prtcl.files.utia import BYTES, SHAPE, STEP_PHI, STEP_THETA, read_utia

Array = NDArray[np.float64]


def written(path: Path, values: Array) -> Path:
    path.write_bytes(np.moveaxis(values, -1, 0).astype("<f8").tobytes())
    return path


def directions(theta: Array, phi: Array) -> Array:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def isotropic() -> Array:
    """Linear in each θ's node number and in the cosine of the azimuths' difference."""
    ti, pi, to, po = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    f = 1 + 0.1 * ti + 0.1 * to + 0.3 * np.cos((po - pi) * STEP_PHI)
    return np.stack([f, 0.5 * f, 2 * f], axis=-1)


def test_the_layout_is_utias(tmp_path: Path) -> None:
    """The index formula: channel, then row 48 θ_i + φ_i, then column 48 θ_o + φ_o."""
    values = np.random.default_rng(0).random((*SHAPE, 3))
    path = written(tmp_path / "a.bin", values)
    assert path.stat().st_size == BYTES == 1990656
    flat = np.frombuffer(path.read_bytes(), "<f8")
    ti, pi, to, po, c = 3, 17, 5, 40, 2
    assert flat[288 * 288 * c + 288 * (48 * ti + pi) + 48 * to + po] == values[ti, pi, to, po, c]
    np.testing.assert_array_equal(read_utia(path), values)


def test_an_isotropic_table_loses_nothing_and_gives_its_nodes() -> None:
    turned = Turned(isotropic(), "made")
    assert turned.loss < 1e-12 and turned.negative == 0
    rng = np.random.default_rng(1)
    ti, pi, to, po = (rng.integers(0, n, 300) for n in SHAPE)
    keep = (ti > 0) & (to > 0)  # the normal has no azimuth
    ti, pi, to, po = (x[keep] for x in (ti, pi, to, po))
    i, o = directions(ti * STEP_THETA, pi * STEP_PHI), directions(to * STEP_THETA, po * STEP_PHI)
    np.testing.assert_allclose(turned(i, o), isotropic()[ti, pi, to, po], rtol=1e-9)
    half = turned(directions((ti - 0.5) * STEP_THETA, pi * STEP_PHI), o)
    np.testing.assert_allclose(half[:, 0], isotropic()[ti, pi, to, po, 0] - 0.05, rtol=1e-9)


def test_the_anisotropy_lost_is_that_put_in() -> None:
    """f (1 + a cos 2φ_i) has the mean f over the turn, and loses a/√2 of its root mean square."""
    a = 0.2
    turn = 1 + a * np.cos(2 * np.arange(48) * STEP_PHI)
    values = np.ones((*SHAPE, 3)) * turn[:, None, None, None]
    turned = Turned(values, "made")
    np.testing.assert_allclose(turned.table, 1.0, rtol=1e-12)
    assert turned.loss == pytest.approx(a / np.sqrt(2), rel=1e-9)


def test_negative_samples_are_left_out() -> None:
    values = isotropic()
    values[2, 5, 3, 9, 1] = -7.0
    turned = Turned(values, "made")
    assert turned.negative == 1
    np.testing.assert_allclose(turned.table, Turned(isotropic(), "made").table, rtol=1e-12)
    with pytest.raises(InputError, match="made: some pairs of directions have no sample"):
        Turned(-values, "made")


def test_a_material_is_read_on_merls_nodes(tmp_path: Path) -> None:
    path = written(tmp_path / "a.bin", isotropic())
    own = read(path)
    rng = np.random.default_rng(2)
    theta, phi = rng.uniform(0.1, np.radians(65), (2, 400)), rng.uniform(0, 2 * np.pi, (2, 400))
    i, o = (directions(t, p) for t, p in zip(theta, phi, strict=True))
    turned = Turned(read_utia(path), "made")
    expected = (turned(i, o) + turned(o, i)) / 2
    np.testing.assert_allclose(own.evaluate(i, o), expected, rtol=0.02)
    material = Material.parse(f"utia:{path}")
    assert material.kind == "measured" and "is anisotropic" in material.notes[0]
    assert Material.parse(f"utia:{path},angles=2").kind == "table"


def test_what_is_wrong_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "a.bin", isotropic())
    whole = path.read_bytes()
    for data, words in (
        (whole[:-1], "got 1990655"),
        (whole + b"\0", "got 1990657"),
        (whole[:8], "got 8"),
        (np.float64(np.nan).tobytes() + whole[8:], "1 numbers are NaN"),
        (np.float64(1e300).tobytes() + whole[8:], "1 numbers are NaN, infinite or huge"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=re.escape(words)) as caught:
            read_utia(path)
        assert str(caught.value).startswith(str(path))


def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    path, rng = tmp_path / "fuzz.bin", np.random.default_rng(0)
    whole = written(path, isotropic()).read_bytes()
    outcomes = set()
    for turn in range(60):
        data = bytearray(whole)
        if turn % 3 == 0:
            data = data[: int(rng.integers(1, len(data)))]
        else:
            at = int(rng.integers(0, len(data) - 8))
            data[at : at + 8] = rng.bytes(8)
        path.write_bytes(data)
        try:
            turned = Turned(read_utia(path), str(path))
        except InputError as error:
            assert str(path) in str(error)
            outcomes.add("refused")
        else:
            assert np.isfinite(turned.table).all() and np.isfinite(turned.loss)
            outcomes.add("read")
    assert outcomes == {"read", "refused"}
