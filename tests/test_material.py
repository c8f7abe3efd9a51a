"""Materials by name and number: every form, every message, tables good and bad."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl import reference
from prtcl.errors import InputError
from prtcl.factors.material import FORMS, KINDS, Material, from_table, pack
from prtcl.factors.measured import Measured

Array = NDArray[np.float64]

# --- SPECs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spec,kind,numbers",
    [
        ("lambert", "lambert", {"albedo": (0.5, 0.5, 0.5)}),
        ("lambert:albedo=0.25", "lambert", {"albedo": (0.25, 0.25, 0.25)}),
        ("lambert:albedo=0.8/0.2/0.1", "lambert", {"albedo": (0.8, 0.2, 0.1)}),
        (
            "ggx:alpha=0.3,eta=0.2,k=3.0",
            "ggx-conductor",
            {"alpha": 0.3, "eta": (0.2,) * 3, "k": (3.0,) * 3, "kd": (0.0,) * 3},
        ),
        (
            "ggx:k=3.4/2.35/1.77,alpha=0.25,eta=0.18/0.42/1.37",
            "ggx-conductor",
            {"alpha": 0.25, "eta": (0.18, 0.42, 1.37), "k": (3.4, 2.35, 1.77), "kd": (0.0,) * 3},
        ),
        ("ggx:alpha=0.3,f0=0.04", "ggx-schlick", {"alpha": 0.3, "f0": (0.04,) * 3, "kd": (0.0,) * 3}),
        (
            "ggx: alpha = 0.3, f0=0.04 ,kd=0.5/0.4/0.3",
            "ggx-schlick",
            {"alpha": 0.3, "f0": (0.04,) * 3, "kd": (0.5, 0.4, 0.3)},
        ),
        (
            "blinn:exponent=200,ks=0.5",
            "blinn",
            {"exponent": 200.0, "ks": (0.5,) * 3, "kd": (0.0,) * 3},
        ),
        (
            "blinn:exponent=2e2,ks=.5,kd=0.1/0.2/0.3",
            "blinn",
            {"exponent": 200.0, "ks": (0.5,) * 3, "kd": (0.1, 0.2, 0.3)},
        ),
    ],
)
def test_every_form_is_read(spec: str, kind: str, numbers: dict[str, Any]) -> None:
    material = Material.parse(spec)
    assert (material.kind, material.numbers, material.spec) == (kind, numbers, spec)
    assert material.table is None and material.notes == ()
    assert Material.parse(material) is material
    assert material.reference() == {"kind": kind.split("-")[0], **numbers}


@pytest.mark.parametrize(
    ("spec", "tints", "black"),
    [
        ("lambert:albedo=mesh", {"albedo": (1, 1, 1)}, True),
        ("lambert:albedo=0.8/0.7/0.6*mesh", {"albedo": (1, 1, 1)}, True),
        ("ggx:alpha=0.3,f0=0.04,kd=0.5*mesh", {"kd": (1, 1, 1)}, False),
        ("ggx:alpha=0.3,f0=0.9*mesh", {"f0": (1, 1, 1)}, False),
        ("blinn:exponent=9,ks=0.1*mesh,kd=mesh", {"ks": (1, 1, 1), "kd": (1, 1, 1)}, True),
        ("gltf:base=mesh,roughness=0.4", {"kd": (1, 1, 1), "f0": (0, 0, 0)}, False),
        ("gltf:base=mesh,roughness=0.4,metallic=1", {"kd": (1, 1, 1), "f0": (1, 1, 1)}, False),
    ],
)
def test_a_meshs_colour_multiplies_what_is_linear(spec: str, tints: dict[str, Any], black: bool) -> None:
    """f(c) = f(0) + c (f(1) - f(0)), for the material that `reference` evaluates at each colour."""
    material = Material.parse(spec)
    assert material.tints == tints
    assert (material.spec, material.untinted.black, material.black) == (spec, black, False)
    rng = np.random.default_rng(4)
    incident, outgoing = (reference.directions(3)[rng.integers(0, 64, 50)] for _ in range(2))
    colour = np.array([0.9, 0.3, 0.05])
    direct = Material.parse(
        re.sub(r"(\w+)=([\d./]*)\*?mesh", lambda m: f"{m[1]}=" + _times(m[2] or "1", colour), spec)
    )
    dark, white, want = (
        np.stack([reference.brdf(m.reference(), incident[i : i + 1], outgoing[i])[0] for i in range(50)])
        for m in (material.untinted, material, direct)
    )
    np.testing.assert_allclose(dark + colour * (white - dark), want, rtol=1e-9, atol=1e-12)


def _times(number: str, colour: Any) -> str:
    value = np.array([float(v) for v in number.split("/")]) * colour
    return "/".join(f"{v:.17g}" for v in value)


@pytest.mark.parametrize(
    "spec", ["ggx:alpha=mesh,f0=0.4", "ggx:alpha=0.3,eta=mesh,k=3", "lambert:albedo=x*mesh"]
)
def test_the_mesh_is_no_number_elsewhere(spec: str) -> None:
    with pytest.raises(InputError, match="expected a number or r/g/b"):
        Material.parse(spec)


def test_the_forms_of_the_help_text_are_read() -> None:
    forms = [re.sub(r"\[(.*?)\]", r"\1", form.strip()) for form in FORMS.split("|")]
    assert len(forms) == 9
    for form in forms:
        if "FILE" not in form:
            assert Material.parse(form).spec == form
            continue
        with pytest.raises(InputError, match=r"FILE\.\w+: no such file"):
            Material.parse(form)


@pytest.mark.parametrize(
    "spec,words",
    [
        ("", ["unknown kind ''", "forms: lambert"]),
        ("phong:exponent=3", ["unknown kind 'phong'", "forms: lambert"]),
        ("Lambert:albedo=0.5", ["unknown kind 'Lambert'"]),
        ("ggx-schlick:alpha=0.3,f0=0.04", ["unknown kind 'ggx-schlick'"]),
        ("ggx-conductor:alpha=0.3,eta=1,k=1", ["unknown kind 'ggx-conductor'"]),
        ("lambert:0.5", ["expected name=number", "'0.5'"]),
        ("lambert:albedo=", ["expected name=number", "'albedo='"]),
        ("lambert:albedo=0.5,albedo=0.6", ["albedo is given twice"]),
        ("lambert:albedo=grey", ["albedo expected a number or r/g/b", "'grey'"]),
        ("lambert:albedo=0.1/0.2", ["albedo expected a number or r/g/b", "'0.1/0.2'"]),
        ("lambert:albedo=0.1/0.2/0.3/0.4", ["albedo expected a number or r/g/b"]),
        ("lambert:albedo=1.5", ["albedo expected from 0 to 1, got 1.5"]),
        ("lambert:albedo=-0.1", ["albedo expected from 0 to 1, got -0.1"]),
        ("lambert:albedo=0.5/0.5/2", ["albedo expected from 0 to 1, got 0.5/0.5/2"]),
        ("lambert:albedo=nan", ["albedo expected from 0 to 1, got nan"]),
        ("lambert:albedo=0.5,shine=3", ["unknown parameter 'shine'", "lambert knows albedo"]),
        ("ggx:f0=0.04", ["alpha is missing", "forms:"]),
        ("ggx:alpha=0.3", ["expected f0, or both eta and k"]),
        ("ggx:alpha=0.3,eta=1.5", ["k is missing"]),
        ("ggx:alpha=0.3,k=3", ["eta is missing"]),
        ("ggx:alpha=0.3,f0=0.04,k=3", ["expected f0, or both eta and k"]),
        ("ggx:alpha=0,f0=0.04", ["alpha expected from 0.001 to 1, got 0"]),
        ("ggx:alpha=0.1/0.2/0.3,f0=0.04", ["alpha expected one number, got 0.1/0.2/0.3"]),
        ("ggx:alpha=inf,f0=0.04", ["alpha expected from 0.001 to 1, got inf"]),
        ("ggx:alpha=0.3,f0=0.04,ks=1", ["unknown parameter 'ks'", "ggx knows alpha, f0, kd"]),
        (
            "ggx:alhpa=0.3,f0=0.04",
            ["unknown parameter 'alhpa'", "did you mean alpha?", "ggx knows alpha, f0, kd"],
        ),
        ("ggx:alpha=0.3,fo=0.04", ["unknown parameter 'fo'", "did you mean f0?"]),
        ("ggx:alpha=0.3,ETA=1.5,k=3", ["unknown parameter 'ETA'", "did you mean eta?"]),
        ("ggx:roughness=0.3,ior=1.5", ["unknown parameter 'roughness'; ggx knows alpha, eta, k, kd, f0"]),
        ("blinn:exponant=3", ["unknown parameter 'exponant'", "did you mean exponent?"]),
        ("blinn:ks=0.5", ["exponent is missing"]),
        ("blinn:exponent=-1,ks=0.5", ["exponent expected from 0 to 100000, got -1"]),
        ("blinn:exponent=1/2/3,ks=0.5", ["exponent expected one number"]),
        ("table:", ["expected table:FILE.npz"]),
        ("table:no/such.npz", ["no/such.npz: no such file"]),
    ],
)
def test_every_message_names_the_problem(spec: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        Material.parse(spec)
    message = str(caught.value)
    for word in words:
        assert word in message
    if not spec.startswith("table:no"):
        assert message.startswith(f"brdf {spec}:")
    assert len(message.splitlines()) <= 2


@pytest.mark.parametrize("spec", [None, 3, ["lambert"]])
def test_something_that_is_no_text_is_refused(spec: Any) -> None:
    with pytest.raises(InputError, match="brdf: expected a text such as"):
        Material.parse(spec)


# --- tables ----------------------------------------------------------------------------------------------------

THETA_H = np.linspace(0, np.pi / 2, 5) ** 2 / (np.pi / 2)
THETA_D = np.linspace(0, np.pi / 2, 4)


def values(seed: int = 0, channels: int = 3) -> Array:
    return np.random.default_rng(seed).uniform(0, 2, (5, 4, channels))


def arrays(**change: Any) -> dict[str, Any]:
    found: dict[str, Any] = {"values": values(), "theta_h": THETA_H, "theta_d": THETA_D, **change}
    return {key: value for key, value in found.items() if value is not None}


def written(folder: Path, **change: Any) -> Path:
    path = folder / "brdf.npz"
    np.savez(path, **arrays(**change))
    return path


def test_a_table_is_read_from_its_file(tmp_path: Path) -> None:
    path = written(tmp_path, extra=np.zeros(3))
    material = Material.parse(f"table:{path}")
    assert material.kind == "table" and material.spec == f"table:{path}" and material.notes == ()
    assert material.table is not None
    for key, expected in arrays().items():
        assert (material.table[key] == expected).all() and material.table[key].dtype == np.float64
    assert material.reference()["kind"] == "table"
    assert not material.grey


def test_a_table_without_channels_is_grey() -> None:
    material = from_table(values()[..., 0], THETA_H, THETA_D)
    assert material.grey and material.table is not None and material.table["values"].shape == (5, 4, 3)


def with_one(value: float) -> Array:
    out = values()
    out[3, 1, 2] = value
    return out


@pytest.mark.parametrize(
    "change,words",
    [
        ({"values": None}, ["expected arrays values, theta_h and theta_d, found theta_h, theta_d"]),
        ({"theta_h": None}, ["found values, theta_d"]),
        ({"values": None, "theta_h": None, "theta_d": None}, ["found nothing"]),
        ({"values": values(channels=4)}, ["expected values[nh, nd, 3]", "(5, 4, 4)"]),
        ({"values": np.zeros(20)}, ["expected values[nh, nd, 3]", "(20,)"]),
        ({"values": np.zeros((0, 4, 3)), "theta_h": np.zeros(0)}, ["expected values[nh, nd, 3]"]),
        ({"values": values().transpose(1, 0, 2)}, ["(4, 5, 3) do not fit theta_h[5] and theta_d[4]"]),
        ({"theta_h": THETA_H[:, None]}, ["two node lists"]),
        ({"values": with_one(np.nan)}, ["1 values are NaN or infinite, the first at (3, 1, 2)"]),
        ({"values": with_one(np.inf)}, ["1 values are NaN or infinite"]),
        ({"theta_h": np.degrees(THETA_H)}, ["theta_h", "0 to pi/2 radians, got 0 to 90", "degrees?"]),
        ({"theta_d": np.degrees(THETA_D)}, ["theta_d", "degrees?"]),
        ({"theta_h": THETA_H[::-1]}, ["theta_h expected finite, strictly ascending"]),
        ({"theta_d": np.array([0, 0.5, 0.5, 1])}, ["theta_d expected finite, strictly ascending"]),
        ({"theta_d": np.array([0, 0.5, np.nan, 1])}, ["theta_d expected finite"]),
        ({"theta_h": np.array([-0.1, 0.1, 0.2, 0.3, 0.4])}, ["got -0.1 to 0.4"]),
        ({"values": np.full((5, 4, 3), "a")}, ["expected arrays of real numbers"]),
        ({"values": values() + 1j}, ["expected arrays of real numbers"]),
    ],
)
def test_bad_tables_are_refused_with_the_file_and_the_reason(
    tmp_path: Path, change: dict[str, Any], words: list[str]
) -> None:
    path = written(tmp_path, **change)
    with pytest.raises(InputError) as caught:
        Material.parse(f"table:{path}")
    assert str(caught.value).startswith(f"{path}:")
    for word in words:
        assert word in str(caught.value)


def test_negative_entries_are_noted_and_become_zero() -> None:
    table = values()
    table[0, 0] = [-1.0, -2.0, 0.5]
    material = from_table(table, THETA_H, THETA_D, name="measured")
    assert material.notes == ("measured: 2 of 60 table values are negative; they are taken as 0",)
    assert material.table is not None
    assert (material.table["values"][0, 0] == [0.0, 0.0, 0.5]).all()
    assert (material.table["values"][1:] == table[1:]).all()
    assert table[0, 0, 0] == -1.0  # the caller's array is the caller's


def test_every_truncation_and_other_files_are_refused(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    path = tmp_path / "cut.npz"
    for length in [*range(0, len(whole), 97), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=re.escape(str(path))) as caught:
            Material.parse(f"table:{path}")
        assert len(str(caught.value).splitlines()) <= 2
    for other in (b"hello", b"\x93NUMPY\x01\x00", b"\x80\x04}\x94."):
        path.write_bytes(other)
        with pytest.raises(InputError, match=re.escape(str(path))):
            Material.parse(f"table:{path}")
    with pytest.raises(InputError, match=re.escape(str(tmp_path))):
        Material.parse(f"table:{tmp_path}")
    np.save(tmp_path / "single.npy", values())
    with pytest.raises(InputError, match=re.escape("single.npy")):
        Material.parse(f"table:{tmp_path / 'single.npy'}")


def test_every_damaged_byte_is_refused_or_harmless(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    path = tmp_path / "flipped.npz"
    refused = 0
    for at in range(0, len(whole), 5):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            material = Material.parse(f"table:{path}")
        except InputError as error:
            assert str(path) in str(error) and len(str(error).splitlines()) <= 2
            refused += 1
        else:
            assert material.table is not None
            for key, expected in arrays().items():
                assert (material.table[key] == expected).all()
    assert refused > 100


class Bomb:
    """Unpickling it would raise."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (exec, ("raise AssertionError('unpickled')",))


def test_pickled_objects_are_refused_and_not_loaded(tmp_path: Path) -> None:
    path = written(tmp_path, values=np.array([Bomb()], dtype=object))
    with pytest.raises(InputError, match="Object arrays cannot be loaded"):
        Material.parse(f"table:{path}")


# --- what is derived -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spec,grey",
    [
        ("lambert:albedo=0.5", True),
        ("lambert:albedo=0.5/0.5/0.5", True),
        ("lambert:albedo=0.5/0.5/0.4", False),
        ("ggx:alpha=0.3,f0=0.04", True),
        ("ggx:alpha=0.3,f0=0.04,kd=0.1/0.2/0.3", False),
        ("ggx:alpha=0.3,eta=1,k=1/2/3", False),
        ("blinn:exponent=10,ks=0.1/0.1/0.2", False),
        ("blinn:exponent=10,ks=0.1", True),
    ],
)
def test_grey_is_three_equal_channels(spec: str, grey: bool) -> None:
    assert Material.parse(spec).grey is grey


def test_a_grey_table_is_noticed() -> None:
    grey = np.repeat(values()[..., :1], 3, axis=2)
    assert from_table(grey, THETA_H, THETA_D).grey
    grey[4, 3, 1] += 1e-9
    assert not from_table(grey, THETA_H, THETA_D).grey


def test_roughness_says_how_wide_the_sharpest_lobe_is() -> None:
    assert Material.parse("lambert").roughness == 1.0
    assert Material.parse("ggx:alpha=0.07,f0=0.04,kd=0.9").roughness == 0.07
    assert Material.parse("ggx:alpha=0.2,eta=1,k=1").roughness == 0.2
    assert Material.parse("blinn:exponent=198,ks=0.5").roughness == pytest.approx(0.1)
    assert Material.parse("blinn:exponent=0,ks=0.5").roughness == 1.0


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.3, 0.6])
def test_a_table_of_a_ggx_lobe_has_its_roughness(alpha: float) -> None:
    """From where D has fallen to half its peak; found to within a node, 0.2 degrees here."""
    nodes = np.radians(np.linspace(0, 90, 451))
    c2 = np.cos(nodes) ** 2
    lobe = alpha**2 / (np.pi * (c2 * (alpha**2 - 1) + 1) ** 2)
    table = np.repeat(np.repeat(lobe[:, None, None], 4, 1), 3, 2)
    found = from_table(table, nodes, THETA_D).roughness
    half = nodes[lobe < 0.5 * lobe[0]][0]
    exact = [t / np.sqrt(np.sqrt(2) - 1 + np.sqrt(2) * t**2) for t in np.tan([half - np.radians(0.2), half])]
    assert exact[0] <= alpha <= exact[1] == pytest.approx(found)
    assert found == pytest.approx(alpha, rel=0.12)


def test_a_flat_or_black_table_is_diffuse() -> None:
    assert from_table(np.full((5, 4, 3), 0.3), THETA_H, THETA_D).roughness == 1.0
    assert from_table(np.zeros((5, 4, 3)), THETA_H, THETA_D).roughness == 1.0
    assert from_table(np.full((1, 1, 3), 0.3), [0.0], [0.0]).roughness == 1.0


def test_metallic_roughness_follows_gltf() -> None:
    base = (0.8, 0.5, 0.2)
    plastic = Material.from_metallic_roughness(base, 0.0, 0.5)
    assert plastic.kind == "ggx-schlick"
    assert plastic.numbers == {"alpha": 0.25, "f0": (0.04,) * 3, "kd": base}
    metal = Material.from_metallic_roughness(base, 1.0, 0.5)
    assert metal.numbers == {"alpha": 0.25, "f0": base, "kd": (0.0,) * 3}
    half = Material.from_metallic_roughness(base, 0.5, 0.5)
    assert half.numbers["f0"] == pytest.approx([0.02 + 0.5 * c for c in base])
    assert half.numbers["kd"] == pytest.approx([0.5 * c for c in base])
    mirror = Material.from_metallic_roughness((2.0, 1.0, 0.0), 1.0, 0.0)
    assert mirror.numbers["alpha"] == 1e-3 and mirror.numbers["f0"] == (1.0, 1.0, 0.0)


def test_the_spec_of_a_gltf_material_reads_as_the_same_material() -> None:
    """To the four digits that it is written with."""
    made = Material.from_metallic_roughness((0.81234, 0.5, 0.2), 0.3, 0.61)
    again = Material.parse(made.spec)
    assert again.kind == made.kind
    for name, value in made.numbers.items():
        assert again.numbers[name] == pytest.approx(value, rel=5e-4)


def test_packing_keeps_measured_tables_among_others() -> None:
    """Nodes, then m·f and m of every sample, at the offset that the row says."""
    rng = np.random.default_rng(4)
    valid = rng.random((5, 4, 6)) > 0.2
    h, d = np.linspace(0.1, 1.5, 5), np.linspace(0.2, 1.4, 4)
    own = Measured.make(rng.random((5, 4, 6, 3)), h, d, valid)
    list_ = [from_table(values(), THETA_H, THETA_D), own.material(), from_table(values(1), THETA_H, THETA_D)]
    ints, reals, tables = pack(list_)
    assert [KINDS[i] for i in ints[:, 0]] == ["table", "measured", "table"]
    _, offset, nh, nd = ints[1]
    assert (nh, nd, reals[1, 3]) == (5, 4, 6) and offset == 5 + 4 + 60
    assert (tables[offset : offset + nh] == np.sqrt(h)).all()
    assert (tables[offset + nh : offset + nh + nd] == d).all()
    at = offset + nh + nd
    entries = tables[at : at + 4 * nh * nd * 6].reshape(nh, nd, 6, 4)
    weight = np.where(valid, 1.0, 2.0**-20)
    assert (entries[..., 3] == weight).all()
    assert (entries[..., :3] == own.values * weight[..., None]).all()
    assert ints[2, 1] == at + entries.size
    assert tables.size == ints[2, 1] + 5 + 4 + 60
    again = pack(list_)
    assert all((a == b).all() for a, b in zip(again, (ints, reals, tables), strict=True))


def test_packing_keeps_the_numbers_and_the_tables() -> None:
    table = from_table(values(), THETA_H, THETA_D)
    other = from_table(values(1)[:2], THETA_H[:2], THETA_D)
    list_ = [
        Material.parse("lambert:albedo=0.1/0.2/0.3"),
        table,
        Material.parse("ggx:alpha=0.3,eta=1,k=2"),
        other,
    ]
    ints, reals, tables = pack(list_)
    assert [KINDS[i] for i in ints[:, 0]] == ["lambert", "table", "ggx-conductor", "table"]
    assert (reals[0, :3] == [0.1, 0.2, 0.3]).all()
    assert reals[2, 3] == 0.3 and (reals[2, 4:7] == 1).all() and (reals[2, 7:10] == 2).all()
    for row, material in ((1, table), (3, other)):
        _, offset, nh, nd = ints[row]
        parts = tables[offset : offset + nh + nd + 3 * nh * nd]
        assert material.table is not None
        assert (parts[:nh] == material.table["theta_h"]).all()
        assert (parts[nh : nh + nd] == material.table["theta_d"]).all()
        assert (parts[nh + nd :] == material.table["values"].ravel()).all()
    assert len(pack([list_[0]])[2]) == 1  # OpenCL has no empty buffers
