"""`prtcl brdf`: figures, plots, conversions, refusals."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from prtcl.apps import brdf, brdf_plots
from prtcl.apps.cli import main
from prtcl.factors.bivariate import Bivariate, merl_nodes
from prtcl.factors.measured import merl_layout, turns
from prtcl.factors.reduction import reduction_error
from prtcl.files.merl import read_merl, write_merl

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A diffuse base with a lobe that depends on φ_d, red, in MERL's layout; bins below the horizon are missing."""
    out = tmp_path_factory.mktemp("brdf")
    h, _ = merl_nodes()
    lobe = np.exp(-((h / 0.2) ** 2))[:, None, None] * (1 + 0.3 * np.cos(2 * turns(180)))
    f = 0.2 / np.pi + np.broadcast_to(lobe, (90, 90, 180))
    own = merl_layout(np.stack([f, 0.5 * f, 0.25 * f], axis=-1))
    write_merl(out / "made.binary", own.values, own.above)
    return out


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = main(["brdf", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


def summary(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    status, out, err = run(capsys, *arguments, "--json")
    assert status == 0 and err == ""
    found: dict[str, Any] = json.loads(out)
    return found


def test_figures_of_a_measured_file(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    found = summary(capsys, folder / "made.binary")
    assert (found["kind"], found["nodes"], found["valid_share"]) == ("merl", [90, 90, 180], 1.0)
    values, valid = read_merl(folder / "made.binary")
    own = merl_layout(values, valid)
    assert found["invalid_samples"] == int((~valid).sum())
    assert (found["two_angles"]["norm"], found["two_angles"]["rmse"]) == reduction_error(own)
    # The lobe is most of f² and changes by 0.3 cos 2φ_d, of which the mean square is half.
    assert found["two_angles"]["norm"] == pytest.approx(0.3 / np.sqrt(2 + 0.09), rel=0.2)
    assert found["largest"] == pytest.approx(values[valid].max())
    for angle in ("0", "45", "75"):
        red, green, blue = found["albedo"][angle]
        assert (
            red > 0.2
            and green == pytest.approx(red / 2, rel=1e-6)
            and blue == pytest.approx(red / 4, rel=1e-6)
        )
    assert found["conserves_energy"] and found["largest_albedo"] < 1
    assert any("angles=2 makes it editable" in note for note in found["notes"])


def test_a_summary_for_people(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    status, out, _ = run(capsys, f"merl:{folder / 'made.binary'},angles=2")
    assert status == 0
    for words in (
        "merl, two angles",
        "nodes 90 x 90, ",
        "albedo at 45 degrees",
        "conserves energy",
        "largest value",
    ):
        assert words in out
    assert run(capsys, folder / "made.binary", "--quiet")[1] == ""


def test_conversions_there_and_back(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    table, three, again = folder / "two.npz", folder / "two.binary", folder / "again.binary"
    assert run(capsys, folder / "made.binary", "--write", table, "--quiet")[0] == 0
    assert run(capsys, table, "--write", three, "--quiet")[0] == 0
    found = summary(capsys, three)
    assert found["two_angles"]["norm"] < 1e-12
    kept, back = Bivariate.load(table), merl_layout(*read_merl(three)).bivariate()
    np.testing.assert_allclose(back.values[back.valid], kept.values[back.valid], rtol=1e-12)
    # What is in MERL's layout is copied, not sampled anew.
    assert run(capsys, folder / "made.binary", "--write", again, "--quiet")[0] == 0
    (one, valid), (other, mask) = read_merl(folder / "made.binary"), read_merl(again)
    assert (valid == mask).all()
    np.testing.assert_allclose(one[valid], other[valid], rtol=1e-15)


def test_an_analytic_material_is_one_too(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    spec = "lambert:albedo=0.6/0.5/0.4"
    found = summary(capsys, spec, "--write", folder / "lambert.npz")
    for row in found["albedo"].values():
        np.testing.assert_allclose(row, [0.6, 0.5, 0.4], rtol=1e-3)
    assert found["kind"] == "lambert" and found["largest"] == pytest.approx(0.6 / np.pi, rel=1e-6)
    np.testing.assert_allclose(
        Bivariate.load(folder / "lambert.npz").values[5, 5] * np.pi, [0.6, 0.5, 0.4], rtol=1e-6
    )


def test_too_bright_a_table_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    Bivariate.make(np.full((2, 2, 3), 0.5), [0.0, 1.5], [0.0, 1.5]).save(tmp_path / "bright.npz")
    found = summary(capsys, tmp_path / "bright.npz")
    assert not found["conserves_energy"] and found["largest_albedo"] == pytest.approx(0.5 * np.pi, rel=5e-3)
    assert "reflects more than it receives" in run(capsys, tmp_path / "bright.npz")[1]


# --- plots --------------------------------------------------------------------------------------------------


def test_plots_are_written(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    pytest.importorskip("matplotlib")
    found = summary(capsys, folder / "made.binary", "-o", folder / "plots")
    assert [Path(p).name for p in found["plots"]] == ["image.png", "lobes.png", "albedo.png"]
    for path in found["plots"]:
        pixels = np.asarray(Image.open(path).convert("RGB"))
        assert min(pixels.shape[:2]) > 300 and pixels.std() > 10  # something is drawn


def test_the_image_has_theta_d_up_and_theta_h_to_the_right() -> None:
    h, d = merl_nodes()
    f = np.broadcast_to(np.where((h[:, None] < 0.1) & (d > 1.2), 5.0, 0.1)[..., None, None], (90, 90, 2, 3))
    table = merl_layout(np.repeat(f, 90, axis=2))
    image = brdf_plots.slice_image(table.evaluate, side=90)
    bright = image[..., 0] > 2
    assert bright[0, 0] and not bright[-1, 0] and not bright[0, -1]
    np.testing.assert_allclose(
        image[::-1].transpose(1, 0, 2), f[:, :, 0], rtol=1e-6
    )  # the pixels are MERL's bins
    mapped = brdf_plots.tone_mapped(image)
    assert mapped.min() > 0 and mapped.max() < 1 and (np.diff(mapped[[-1, 0], 0, 0]) > 0).all()


def test_a_lobe_is_on_the_other_side_of_its_light() -> None:
    def f(i: Array, o: Array) -> Array:
        h = (i + o) / np.linalg.norm(i + o, axis=1, keepdims=True)
        return np.repeat(h[:, 2:] ** 200, 3, axis=1)

    angles = np.linspace(-1.5, 1.5, 3001)
    assert angles[np.argmax(brdf_plots.lobe(f, 0.5, angles))] == pytest.approx(0.5, abs=2e-3)


# --- refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no.binary"], "no.binary: no such file"),
        (["merl:no.binary,angles=5"], "angles expected 2 or 3, got 5"),
        (["wood"], "unknown kind 'wood'"),
        (["lambert", "--write", "a.exr"], "--write a.exr: expected a name that ends in .npz or .binary"),
        (["lambert", "--write", "no/such/a.npz"], "there is no folder no/such"),
    ],
)
def test_what_is_wrong_is_named(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    status, out, err = run(capsys, *arguments)
    assert status == 2 and out == "" and err.startswith("prtcl brdf: ") and words in err


def test_a_file_is_not_written_over_itself(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    path = folder / "made.binary"
    status, _, err = run(capsys, path, "--write", path)
    assert status == 2 and "would be overwritten" in err


def test_without_matplotlib_its_extra_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, _, err = run(capsys, "lambert", "-o", tmp_path / "plots")
    assert status == 2 and "pip install 'prtcl[plots]'" in err and not (tmp_path / "plots").exists()


def test_a_file_whose_path_has_a_colon(tmp_path: Path) -> None:
    path = tmp_path / "a:b.npz"
    Bivariate.make(np.full((2, 2, 3), 0.1), [0.0, 1.5], [0.0, 1.5]).save(path)
    assert brdf.load(str(path)).kind == "table"


def test_a_sharp_lobe_is_written_on_nodes_that_hold_it_or_with_a_note(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    spec = "ggx:alpha=0.002,f0=0.9"
    table = summary(capsys, spec, "--write", tmp_path / "sharp.npz")
    assert not any("too coarse" in note for note in table["notes"])
    assert Bivariate.load(tmp_path / "sharp.npz").theta_h.size > 90
    merl = summary(capsys, spec, "--write", tmp_path / "sharp.binary")
    assert any("too coarse for this lobe" in note for note in merl["notes"])


def test_what_a_table_was_not_told_is_invalid_in_merls_layout(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    valid = np.ones((3, 3), np.bool_)
    valid[2, 0] = False
    Bivariate.make(np.full((3, 3), 0.2), [0.0, 0.7, 1.5], [0.0, 0.7, 1.5], valid).save(tmp_path / "t.npz")
    run(capsys, tmp_path / "t.npz", "--write", tmp_path / "t.binary")
    _, kept = read_merl(tmp_path / "t.binary")
    assert not kept[89, 0].any() and kept[0, 0].any() and kept[0, 60].any()


def test_values_that_no_device_holds_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    write_merl(tmp_path / "huge.binary", np.full((90, 90, 180, 3), 1e36))
    np.savez(tmp_path / "huge.npz", values=np.full((2, 2, 3), 1e36), theta_h=[0.0, 1.5], theta_d=[0.0, 1.5])
    for name in ("huge.binary", "huge.npz"):
        status, _, told = run(capsys, tmp_path / name)
        assert status == 2 and f"{name}: values expected below 1e+30 1/sr, got up to 1e+36" in told


def test_a_file_of_another_kind_is_told_what_is_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "x.txt").write_text("no BRDF")
    status, _, told = run(capsys, tmp_path / "x.txt")
    assert status == 2 and "expected a BRDF whose name ends in .npz, .binary, .bsdf, .bin" in told
