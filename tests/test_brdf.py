"""Reflectance on the device against the float64 reference, f_v slices, and the table of views."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tolerances
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import quadtree, reference
from prtcl.apps.stress.oracle import brdf_bound
from prtcl.apps.stress.oracle import ggx_albedo as albedo
from prtcl.compute.device import Device
from prtcl.errors import DeviceError, InputError
from prtcl.factors import hemisphere, material
from prtcl.factors.material import Material
from prtcl.factors.measured import Measured
from prtcl.factors.slices import BLOCK, Materials, ViewTable, block_directions, subsamples
from prtcl.factors.stored import SliceStore

TABLE = material.from_table(
    np.random.default_rng(6).uniform(0.1, 1, (7, 5, 3)),
    np.array([0.0, 0.05, 0.2, 0.5, 0.9, 1.3, np.pi / 2]),
    np.array([0.1, 0.4, 0.8, 1.2, 1.5]),
)
ROW = material.from_table(np.random.default_rng(7).uniform(0.1, 1, (1, 4)), [0.3], np.linspace(0, 1.5, 4))
COLUMN = material.from_table(np.random.default_rng(8).uniform(0.1, 1, (4, 1)), np.linspace(0, 1.5, 4), [0.3])


def three_angles(gaps: bool) -> Measured:
    """A small table of three angles; with gaps a third of its samples are missing."""
    rng = np.random.default_rng(9)
    h, d = np.linspace(0.1, 1.2, 6) ** 2, np.linspace(0.05, 1.5, 5)
    valid = rng.random((6, 5, 7)) > (1 / 3 if gaps else 0)
    return Measured.make(rng.uniform(0.1, 1, (6, 5, 7, 3)), h, d, valid)


MEASURED = {name: three_angles(name == "gaps") for name in ("whole", "gaps")}
MEASURED_MATERIALS = [m.material(name) for name, m in MEASURED.items()]

SPECS = [
    "lambert:albedo=0.8/0.2/0.1",
    "ggx:alpha=0.3,eta=0.18/0.42/1.37,k=3.42/2.35/1.77",
    "ggx:alpha=0.05,eta=1.5,k=0",
    "ggx:alpha=0.001,eta=0.2,k=3",
    "ggx:alpha=1,eta=0.5,k=0.1,kd=0.3",
    "ggx:alpha=0.3,f0=0.04,kd=0.5/0.3/0.1",
    "ggx:alpha=0.001,f0=1",
    "ggx:alpha=0.01,f0=0.9/0.6/0.2",
    "blinn:exponent=1,ks=0.5",
    "blinn:exponent=200,ks=0.5/0.4/0.3,kd=0.1",
    "blinn:exponent=100000,ks=1",
]
MATERIALS = [*map(Material.parse, SPECS), TABLE, ROW, COLUMN, *MEASURED_MATERIALS]
NAMES = [*SPECS, "table", "table of one theta_h", "table of one theta_d", "measured", "measured with gaps"]


def sphere(z: NDArray[np.float64], phi: NDArray[np.float64]) -> NDArray[np.float64]:
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def direction_pairs(where: str, count: int = 997) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pairs over the hemisphere; both grazing; or outgoing within some α of the mirror direction."""
    rng = np.random.default_rng(len(where))
    turn = rng.uniform(0, 2 * np.pi, (2, count))
    if where == "random":
        return tuple(sphere(rng.uniform(0.001, 1, count), phi) for phi in turn)  # type: ignore[return-value]
    if where == "grazing":
        return tuple(sphere(10 ** rng.uniform(-5, -1, count), phi) for phi in turn)  # type: ignore[return-value]
    i = sphere(rng.uniform(0.05, 1, count), turn[0])
    o = i * [-1, -1, 1] + rng.normal(size=(count, 3)) * 10 ** rng.uniform(-5, -1, (count, 1))
    o[:, 2] = np.abs(o[:, 2])
    return i, o / np.linalg.norm(o, axis=1, keepdims=True)


def bound_of(m: Material, i: NDArray[np.float64], o: NDArray[np.float64], u: float) -> NDArray[np.float64]:
    """`brdf_bound` of the device; of measured materials, whose tables it does not know, the table's own."""
    if m.kind != "measured":
        return brdf_bound(m, i, o, u)
    own = MEASURED[m.spec]
    h, d, turn = reference.difference_angles(*np.broadcast_arrays(i, o))
    share = own.weighted(h, d, turn)[..., 3]
    return tolerances.measured_lookup(own.values, own.theta_h, own.theta_d, u, (h, d), share)[:, None]


@pytest.mark.parametrize("where", ["random", "grazing", "near the mirror"])
@pytest.mark.parametrize("m", MATERIALS, ids=NAMES)
def test_evaluation_against_the_reference(any_device: Device, m: Material, where: str) -> None:
    """In float32 in a program of the one kind, in the other precisions in one that knows all kinds."""
    device = any_device
    i, o = (d.astype(device.dtype).astype(np.float64) for d in direction_pairs(where))
    alone = device.precision == "float32"
    with guard_bands(device):
        materials = Materials(device, [m] if alone else MATERIALS)
        got = materials.evaluate(0 if alone else MATERIALS.index(m), i, o)
    u = tolerances.STORED[device.precision]
    # A mirror-like Blinn lobe is zero nearly everywhere; the pairs near the mirror are the ones that test it.
    sharp = m.numbers.get("exponent", 0) > 1e4 and where != "near the mirror"
    assert_close(got, reference.brdf(m.reference(), i, o), bound_of(m, i, o, u), zeros=1.0 if sharp else 0.5)


def test_many_materials_in_one_program(device: Device) -> None:
    """Indices, packing and tables that lie one after another."""
    materials = Materials(device, MATERIALS)
    assert materials.channels == 3
    i, o = (d.astype(np.float32).astype(np.float64) for d in direction_pairs("near the mirror", 65))
    for index, m in enumerate(MATERIALS):
        with guard_bands(device):
            got = materials.evaluate(index, i, o)
        assert_close(got, reference.brdf(m.reference(), i, o), bound_of(m, i, o, 2.0**-24))


@pytest.mark.parametrize("m", MATERIALS, ids=NAMES)
def test_nothing_below_the_horizon(device: Device, m: Material) -> None:
    up, down, level = [0.6, 0.0, 0.8], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]
    got = Materials(device, [m]).evaluate(0, [up, down, down, level, up], [down, up, down, up, level])
    assert (got == 0).all()
    assert Materials(device, [m]).evaluate(0, up, up).shape == (1, 3)


def test_mirror_peak_of_the_sharpest_lobe(device: Device) -> None:
    """At the mirror direction D = 1/(π α²): closed form, where 1 − cos² would have cancelled."""
    m = Material.parse("ggx:alpha=0.001,f0=1")
    got = Materials(device, [m]).evaluate(0, [0.0, 0, 1], [0.0, 0, 1])
    assert_close(got, np.full((1, 3), 1e6 / np.pi / 4), 64 * 2.0**-24 * 1e6 / np.pi / 4)


# --- slices -------------------------------------------------------------------------------------------------


COLOURED = [MATERIALS[0], MATERIALS[1], MATERIALS[5], MATERIALS[9], TABLE, MEASURED_MATERIALS[0]]
GREY = [MATERIALS[2]]


@pytest.mark.parametrize(
    ("levels", "sub", "materials"), [(1, 2, COLOURED), (3, 2, COLOURED), (5, 1, COLOURED), (3, 2, GREY)]
)
def test_slices_are_cell_averages(device: Device, levels: int, sub: int, materials: list[Material]) -> None:
    views = np.array([[0, 0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.96, 0.28]])
    with guard_bands(device):
        got = Materials(device, materials).slices(views, levels, sub).get()
    channels = 1 if materials == GREY else 3
    assert got.shape == (len(materials), 3, channels, 4**levels)
    fine = hemisphere.directions(levels + sub).astype(np.float64)
    incident, cosine = fine[:, :3], fine[:, 3:]
    exact = reference.directions(levels + sub)
    pairs = [(m, view, own[v]) for m, own in zip(materials, got, strict=True) for v, view in enumerate(views)]
    for m, view64, slices in pairs:
        view = view64.astype(np.float32).astype(np.float64)
        f = reference.brdf(m.reference(), incident, view)[:, :channels]
        bound = np.broadcast_to(bound_of(m, incident, view[None], 2.0**-24), (len(fine), 3))[:, :channels]

        def cells(x: NDArray[np.float64]) -> NDArray[np.float64]:
            return x.reshape(4**levels, 4**sub, channels).mean(axis=1).T

        expected = cells(f * cosine)
        # The kernel's own sum of 4^sub positive terms, then the transform.
        limit = tolerances.norms(cells(bound) + (4**sub + 3) * 2.0**-24 * expected)
        limit = limit + tolerances.haar(levels, 2.0**-24, expected)
        error = tolerances.norms(slices - reference.haar(expected))
        assert_close(error, np.zeros((channels, 1)), limit, zeros=1)
        # The reference takes the cosine of each direction, the kernel the mean over its subcell.
        plain = reference.slice_samples(m.reference(), view, levels, sub)[:, :channels].T
        shift = cells(f * np.abs(cosine - exact[:, 2:])) + 1e-5 * plain.max()
        assert_close(reference.ihaar(slices), plain, shift + limit)


def test_slices_of_several_materials_and_row_counts(device: Device) -> None:
    """65 views and two materials: the second's rows follow the first's, each equal to its own launch."""
    rng = np.random.default_rng(1)
    views = sphere(rng.uniform(0.05, 1, 65), rng.uniform(0, 6, 65))
    pair = [MATERIALS[1], MATERIALS[9]]
    with guard_bands(device):
        both = Materials(device, pair).slices(views, 2, 1).get()
    for index, m in enumerate(pair):
        alone = Materials(device, [m, m]).slices(views, 2, 1).get()[1]
        bound = 64 * 2.0**-24 * np.abs(alone).max()  # another KINDS mask may round in another order
        assert_close(both[index], alone, bound)


def test_grazing_and_lower_views_are_finite(device: Device) -> None:
    got = Materials(device, MATERIALS).slices([[1.0, 0, 0], [1.0, 0, 1e-9], [0.8, 0, -0.6]], 3).get()
    assert np.isfinite(got).all()
    assert (np.abs(got).max(axis=(1, 2, 3)) > 0).all()


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    first, second = (Materials(device, [MATERIALS[1]]).slices([[0.6, 0, 0.8]], 4).get() for _ in range(2))
    assert (first == second).all()


def test_sharper_lobes_take_more_subsamples() -> None:
    def depth(alpha: float, levels: int) -> int:
        return subsamples(Material.parse(f"ggx:alpha={alpha},f0=1"), levels)

    assert [depth(a, 5) for a in (1.0, 0.3, 0.1, 0.03, 0.001)] == sorted(
        depth(a, 5) for a in (1.0, 0.3, 0.1, 0.03, 0.001)
    )
    assert depth(0.001, 3) == 4
    assert depth(1.0, 7) == 1
    assert depth(0.1, 3) >= depth(0.1, 6)


@pytest.mark.parametrize("colour", ["f0=1", "f0=1/1/1,kd=0/0/0.1"])
def test_the_sharpest_lobe_reflects_its_albedo(device: Device, colour: str) -> None:
    """Within 1 % at views up to 75 degrees, whichever way the frame is turned: cells lie otherwise under the lobe."""
    theta = np.radians([0, 0.05, 5, 20, 37.3, 40, 60, 61.9, 70, 75] * 2)
    turn = np.where(np.arange(20) < 10, 0.0, np.random.default_rng(2).uniform(0, 2 * np.pi, 20))
    views = sphere(np.cos(theta), turn)
    materials = Materials(device, [MATERIALS[0], Material.parse(f"ggx:alpha=0.001,{colour}")])
    with guard_bands(device):
        got = materials.slices(views, 7).get()[1, :, 0, 0].astype(np.float64) / 2**7 * 2 * np.pi
    expected = np.array([albedo(0.001, view) for view in views])
    assert expected.min() > 0.99  # it loses nearly nothing below the horizon
    assert_close(got, expected, 0.01 * expected)


def test_albedo_by_half_vectors_is_that_by_directions() -> None:
    view = np.array([0.6, 0.0, 0.8])
    f = reference.slice_samples({"kind": "ggx", "alpha": 0.5, "f0": 1.0}, view, 4, 5)[:, 0]
    assert_close(albedo(0.5, view), f.mean() * 2 * np.pi, 1e-3)


@pytest.mark.parametrize("block", [0, 1, 6, 15])
def test_block_directions_are_some_of_all(block: int) -> None:
    levels, finest = 2 + BLOCK, 7
    each = quadtree.n_samples(finest - levels + BLOCK)
    every = hemisphere.directions(finest)[block * each : (block + 1) * each]
    assert (block_directions(levels, finest, block) == every).all()


def test_slices_of_one_material_are_the_same_bits(device: Device) -> None:
    """Of a sharp one as well, whose views are refined in blocks and runs."""
    theta = np.linspace(0, 1.3, 7)
    views = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    materials = Materials(device, [MATERIALS[1], Material.parse("ggx:alpha=0.001,f0=0.9/0.6/0.2")])
    for levels in (3, 7):
        every = materials.slices(views, levels).get()
        for index in (0, 1):
            with guard_bands(device):
                assert (materials.slices_of(index, views, levels).get() == every[index]).all()
                assert (materials.slices_of(index, views[4:], levels).get() == every[index, 4:]).all()


# --- slices made when they are needed -----------------------------------------------------------------------


class Store(SliceStore):
    """A store of small slices that remembers what it made."""

    def __init__(self, device: Device, capacity: int, polar: bool = True) -> None:
        materials = Materials(device, [MATERIALS[1], MATERIALS[9], MATERIALS[5]])
        table = ViewTable.make(polar, 9)
        super().__init__(device, materials, table, 2, capacity * 3 * 16 * 4)
        self.every = materials.slices(table.views, 2).get().reshape(-1, 3, 16)
        self.made: list[int] = []

    def _make(self, index: int, keys: NDArray[np.int64]) -> None:
        self.made += keys.tolist()
        super()._make(index, keys)


@given(seed=st.integers(0, 2**31), capacity=st.integers(4, 30), polar=st.booleans())
def test_stored_slices_are_those_of_the_materials(
    device: Device, seed: int, capacity: int, polar: bool
) -> None:
    """However few fit: bit for bit, in parts that cover all points once."""
    store = Store(device, capacity, polar)
    rng = np.random.default_rng(seed)
    for count in (1, 40, 7):
        phi = np.zeros(count) if polar else rng.uniform(0, 6, count)
        nodes, _ = store.table.locate(sphere(rng.uniform(0.001, 1, count), phi))
        keys = store.keys(rng.integers(0, 3, count), nodes)
        done = []
        for part in store.parts(keys, 16):
            assert 0 < len(part) <= 16
            array, index = store.take(keys[part])
            assert array.shape[0] <= capacity
            assert (array.get()[index] == store.every[keys[part]]).all()
            done += part.tolist()
        assert sorted(done) == list(range(count))


def test_a_slice_is_made_once_and_only_if_it_is_wanted(device: Device) -> None:
    store = Store(device, 27)
    assert not store.made
    keys = store.keys(np.array([0, 2, 2]), np.array([[1, 2], [7, 8], [1, 2]]))
    device.profile.reset()
    with guard_bands(device):
        for part in store.parts(keys, 2):
            store.take(keys[part])
        # Their transforms too: haar_forward is the points' own, of which the report gives so many a second.
        assert set(device.profile.device_seconds()) == {"brdf_slices"}
        assert sorted(store.made) == [1, 2, 19, 20, 25, 26]
        store.take(store.keys(np.array([0, 1]), np.array([[2, 3], [0, 1]])))
        assert store.made[6:] == [3, 9, 10]
        array, index = store.take(keys)
    assert len(store.made) == 9 and (array.get()[index] == store.every[keys]).all()


def test_a_store_that_is_too_small_makes_hardly_any_slice_twice(device: Device) -> None:
    """Points in random order, of 27 slices of which 8 fit."""
    store = Store(device, 8)
    rng = np.random.default_rng(3)
    nodes = rng.integers(0, 8, 500)
    keys = store.keys(rng.integers(0, 3, 500), np.stack([nodes, nodes + 1], axis=1))
    for part in store.parts(keys, 100):
        store.take(keys[part])
    assert set(store.made) == set(range(27)) and len(store.made) < 2 * 27


def test_a_point_whose_slices_do_not_fit_is_refused(device: Device) -> None:
    store = Store(device, 1)
    keys = store.keys(np.array([0]), np.array([[0, 1]]))
    with pytest.raises(
        DeviceError, match="the 2 slices of one point need 384 bytes in one buffer, of which 1 fit"
    ):
        list(store.parts(keys, 5))


def test_no_materials_are_refused(device: Device) -> None:
    with pytest.raises(InputError, match="materials: expected at least one"):
        Materials(device, [])


# --- views --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("polar", "nodes"), [(True, 2), (True, 33), (False, 3), (False, 9)])
def test_nodes_are_exact(polar: bool, nodes: int) -> None:
    table = ViewTable.make(polar, nodes)
    assert_close(np.linalg.norm(table.views, axis=1), np.ones(len(table.views)), 1e-15)
    above = np.nonzero(table.views[:, 2] > 1e-12)[0]
    index, weight = table.locate(table.views[above])
    own = np.where(index == above[:, None], weight, 0).sum(axis=1)
    # √(1 − z) near the pole turns 2⁻⁵³ into 1e-8 of the square.
    assert_close(own, np.ones(len(above)), 2e-8 * nodes)


@given(seed=st.integers(0, 2**31), polar=st.booleans(), nodes=st.integers(2, 40))
def test_weights_are_an_interpolation(seed: int, polar: bool, nodes: int) -> None:
    table = ViewTable.make(polar, nodes)
    rng = np.random.default_rng(seed)
    phi = np.zeros(100) if polar else rng.uniform(0, 2 * np.pi, 100)
    views = sphere(rng.uniform(1e-6, 1, 100), phi)
    index, weight = table.locate(views)
    assert index.shape == weight.shape == (100, 2 if polar else 4)
    assert (index >= 0).all()
    assert (index < len(table.views)).all()
    assert (weight >= 0).all()
    assert_close(weight.sum(axis=1), np.ones(100), 4 * 2.0**-24)
    # The coordinate that the nodes are equally spaced in is met exactly: linear interpolation of it is
    # itself.
    if polar:
        angles = np.arctan2(table.views[:, 0], table.views[:, 2])
        assert_close((angles[index] * weight).sum(axis=1), np.arctan2(views[:, 0], views[:, 2]), 1e-6)
    else:
        u, v = (np.tile(np.linspace(0, 1, nodes), nodes), np.repeat(np.linspace(0, 1, nodes), nodes))
        got = np.stack([(u[index] * weight).sum(axis=1), (v[index] * weight).sum(axis=1)])
        assert_close(got, np.stack(reference.hemisphere_to_square(views)), 1e-6)


@pytest.mark.parametrize("polar", [True, False])
def test_views_below_the_horizon_have_no_weight(polar: bool) -> None:
    _, weight = ViewTable.make(polar, 5).locate([[0.6, 0.0, -0.8], [1.0, 0.0, 0.0]])
    assert not weight.any()


def test_one_node_is_refused() -> None:
    with pytest.raises(InputError, match="views: expected at least 2, got 1"):
        ViewTable.make(True, 1)


# --- materials by name --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("wood:albedo=1", "unknown kind 'wood'"),
        ("lambert:albedo=1.5", "albedo expected from 0 to 1, got 1.5"),
        ("lambert:albedo=nan", "albedo expected from 0 to 1"),
        ("lambert:albedo=1/2", "albedo expected a number or r/g/b"),
        ("lambert:albedo=x", "albedo expected a number or r/g/b"),
        ("lambert:shine=1", "unknown parameter 'shine'; lambert knows albedo"),
        ("lambert:albedo=0.1,albedo=0.2", "albedo is given twice"),
        ("lambert:albedo", "expected name=number, got 'albedo'"),
        ("ggx:alpha=0.3", "expected f0, or both eta and k"),
        ("ggx:alpha=0.3,eta=1", "k is missing"),
        ("ggx:alpha=0.3,f0=0.1,eta=1,k=1", "expected f0, or both eta and k"),
        ("ggx:alpha=0.3/0.2/0.1,f0=0.1", "alpha expected one number"),
        ("ggx:alpha=0,f0=0.1", "alpha expected from 0.001 to 1"),
        ("blinn:exponent=-1,ks=0.5", "exponent expected from 0 to 100000"),
        ("table:", "expected table:FILE.npz"),
        ("table:/no/such.npz", "/no/such.npz: no such file"),
        ("merl:", "expected merl:FILE.binary[,angles=2]"),
        ("rgl:,angles=2", "expected rgl:FILE.bsdf[,angles=2]"),
        ("utia:", "expected utia:FILE.bin[,angles=2]"),
        ("merl:a.binary,angles=4", "angles expected 2 or 3, got 4"),
        ("merl:/no/such.binary,angles=2", "/no/such.binary: no such file"),
        ("merl:/no/such.npz", "/no/such.npz: no such file"),
    ],
)
def test_bad_specs_say_what_is_wrong(spec: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        Material.parse(spec)
    assert message in str(caught.value)


def test_table_file(tmp_path: Path) -> None:
    path = tmp_path / "a,b=c.npz"
    np.savez(
        path, values=TABLE.table["values"], theta_h=TABLE.table["theta_h"], theta_d=TABLE.table["theta_d"]
    )  # type: ignore[index]
    read = Material.parse(f"table:{path}")
    assert read.kind == "table"
    for key, value in TABLE.table.items():  # type: ignore[union-attr]
        assert (read.table[key] == value).all()  # type: ignore[index]
    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"not a zip")
    with pytest.raises(InputError, match=r"no \.npz"):
        Material.parse(f"table:{bad}")
    np.savez(bad, values=np.ones((2, 2)))
    with pytest.raises(InputError, match="found values"):
        Material.parse(f"table:{bad}")


@pytest.mark.parametrize(
    ("values", "theta_h", "theta_d", "message"),
    [
        (np.ones((2, 2)), [0.0, 0.5, 1.0], [0.0, 1.0], "do not fit"),
        (np.ones((2, 2)), [0.5, 0.5], [0.0, 1.0], "strictly ascending"),
        (np.ones((2, 2)), [0.0, 80.0], [0.0, 1.0], "are they degrees"),
        (np.ones((2, 2, 4)), [0.0, 1.0], [0.0, 1.0], r"expected values\[nh, nd, 3\]"),
        (np.array([[1, np.inf], [1, 1]]), [0.0, 1.0], [0.0, 1.0], "NaN or infinite"),
    ],
)
def test_bad_tables_are_refused(
    values: NDArray[np.float64], theta_h: list[float], theta_d: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        material.from_table(values, theta_h, theta_d, name="measured.npz")


def test_negative_table_entries_become_zero_and_are_noted() -> None:
    m = material.from_table([[1.0, -2.0], [3.0, 4.0]], [0.0, 1.0], [0.0, 1.0])
    assert m.table is not None
    assert (m.table["values"][0, 1] == 0).all()
    assert "3 of 12 table values are negative" in m.notes[0]
